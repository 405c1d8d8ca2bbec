"""Folders of videos and frame folders at any depth, with the datasets among them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from kinebench_drake.datasets import manifest
from kinebench_drake.datasets.folders import walk
from kinebench_drake.datasets.videos import videofolder
from kinebench_drake.datasets.videos.sample import VideoSample, camera_of
from kinebench_drake.datasets.videos.search import Search, plain
from kinebench_drake.errors import InputError
from kinebench_drake.io.files import IMAGE_SUFFIXES, VIDEO_SUFFIXES


@dataclass(frozen=True, slots=True, kw_only=True)
class FolderLayout:
    """A kind of dataset: how its folder is told, and what lists its videos."""

    claims: Callable[[Path], bool]
    """Whether a folder is such a dataset."""
    list: Callable[[Path, Search], list[VideoSample]]
    """Its videos; raises InputError where it cannot be used."""


def list_folder(
    folder: Path, search: Search, skipped: Sequence[Path], layouts: Sequence[FolderLayout]
) -> list[VideoSample]:
    """Films, frame folders and datasets below a folder, sorted.

    What `walk` passes over is no input. A dataset that cannot be used is one sample with a problem, unless it is
    `folder` itself.

    Raises:
        InputError: `folder` is a dataset that cannot be used.
        UsageError: a camera.json is unusable.
    """
    samples: list[VideoSample] = []
    labelled: list[Path] = []
    for here, folders, files in walk(folder, skipped):
        layout = next((layout for layout in layouts if layout.claims(here)), None)
        if layout is not None:
            folders.clear()
            samples += _dataset(here, search, layout)
            continue
        films = [f for f in files if Path(f).suffix.lower() in VIDEO_SUFFIXES]
        if films:
            samples += [plain(here / f, search) for f in films]
        elif is_frame_folder(files):
            samples.append(plain(here, search))
        labelled += [here / name for name in videofolder.NAMES if name in files]
    if (folder / manifest.NAME).is_file():
        search.warnings.append(
            f"{folder / manifest.NAME} is not read, as the folder was named; name the file itself to use it"
        )
    return videofolder.with_labels(samples, labelled, search)


def is_frame_folder(files: Sequence[str]) -> bool:
    """Whether a folder of these files is one video: it holds pictures, and no films."""
    suffixes = {Path(f).suffix.lower() for f in files}
    return bool(suffixes & IMAGE_SUFFIXES) and not suffixes & VIDEO_SUFFIXES


def _dataset(folder: Path, search: Search, layout: FolderLayout) -> list[VideoSample]:
    try:
        return layout.list(folder, search)
    except InputError as error:
        if folder == search.top:
            raise
        camera, source = camera_of(None)
        name, problem = search.name(folder), str(error)
        return [
            VideoSample(id=folder.name, path=folder, video=name, camera=camera, camera_source=source, problem=problem)
        ]
