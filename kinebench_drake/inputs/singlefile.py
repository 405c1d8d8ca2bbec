"""A file that is one video."""

from dataclasses import replace
from pathlib import Path

from kinebench_drake.grounding.decoded import VideoPart
from kinebench_drake.inputs.sample import Sample
from kinebench_drake.inputs.search import Search, plain


def list_film(path: Path, search: Search) -> list[Sample]:
    """A film."""
    return [plain(path, search)]


def list_array(path: Path, search: Search) -> list[Sample]:
    """An npy file, or an array of an npz file: the one that the camera's key names, else the one that is read."""
    sample = plain(path, search)
    if path.suffix.lower() != ".npz" or search.camera_key is None:
        return [sample]
    return [replace(sample, part=VideoPart(key=search.camera_key), camera_key=search.camera_key)]
