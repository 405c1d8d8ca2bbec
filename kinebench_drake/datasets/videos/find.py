"""The registry of video formats: from a path to its samples."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from kinebench_drake.datasets import lerobot, manifest
from kinebench_drake.datasets.folders import require_apart, walk
from kinebench_drake.datasets.ids import unique_ids
from kinebench_drake.datasets.videos import ewmbench, hdf5_videos, videofolder, worldarena
from kinebench_drake.datasets.videos.folder import FolderLayout, is_frame_folder, list_folder
from kinebench_drake.datasets.videos.sample import VideoSample, VideoSamples
from kinebench_drake.datasets.videos.search import CameraLookup, Search, plain
from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.io.files import VIDEO_SUFFIXES
from kinebench_drake.io.hdf5 import HDF5_SUFFIXES
from kinebench_drake.io.reader import ARRAY_SUFFIXES
from kinebench_drake.io.video import VideoPart


def list_film(path: Path, search: Search) -> list[VideoSample]:
    """A film."""
    return [plain(path, search)]


def list_array(path: Path, search: Search) -> list[VideoSample]:
    """An npy file, or an array of an npz file: the one that the camera's key names, else the one that is read."""
    sample = plain(path, search)
    if path.suffix.lower() != ".npz" or search.camera_key is None:
        return [sample]
    return [replace(sample, part=VideoPart(key=search.camera_key), camera_key=search.camera_key)]


FILES: Mapping[str, Callable[[Path, Search], Sequence[VideoSample]]] = {
    ".jsonl": manifest.list_manifest,
    **dict.fromkeys(HDF5_SUFFIXES, hdf5_videos.list_hdf5),
    **dict.fromkeys(VIDEO_SUFFIXES, list_film),
    **dict.fromkeys(ARRAY_SUFFIXES, list_array),
}
"""What lists the videos of a file that was named, by its suffix in lower case."""

NAMES = dict.fromkeys(videofolder.NAMES, videofolder.list_metadata)
"""The same by whole names, which go before suffixes."""

LAYOUTS = (
    FolderLayout(claims=lerobot.is_lerobot, list=lerobot.list_lerobot_videos),
    FolderLayout(claims=ewmbench.is_ewmbench, list=ewmbench.list_ewmbench),
    FolderLayout(claims=worldarena.is_worldarena, list=worldarena.list_worldarena),
)
"""Folders that are more than videos in a tree; the first that claims a folder has it."""


def find_samples(
    source: Path,
    *,
    out: Path | None = None,
    model: str | None = None,
    task: str | None = None,
    others: Sequence[Path] = (),
    camera_key: str | None = None,
) -> VideoSamples:
    """List the videos of a file, a frame folder, a dataset, a folder of these or a manifest.

    Args:
        source: what the user named.
        out: a folder whose content is never taken for input (the run's own output).
        model: name of the world model, for samples that name none.
        task: name of the task, for samples that name none.
        others: folders that are read beside the videos (masks, depth, poses), whose pictures are no videos.
        camera_key: the camera to take of datasets that have several.

    Raises:
        UsageError: there is nothing to read, it is not said which camera to take, a `camera.json` is unusable, or a
            run into `out` would harm what it reads.
    """
    if not source.exists():
        raise UsageError(f"{source}: there is no such file or folder")
    if out is not None:
        require_apart(out, source, *others)
    top = source if source.is_dir() else source.parent
    search = Search(top=top, cameras=CameraLookup(_beside(source)), camera_key=camera_key)
    try:
        found = _list(source, search, [p for p in (out, *others) if p is not None])
    except InputError as error:
        raise UsageError(f"{source}: {error}") from None
    if camera_key is not None and not any(sample.camera_key or sample.problem for sample in found):
        raise UsageError(
            f"--camera-key {camera_key}: {source} has nothing to choose from; it is for LeRobot datasets, HDF5 and npz "
            "files with several cameras"
        )
    samples = [replace(s, model=s.model or model, task=s.task or task) for s in found]
    return VideoSamples(samples=_with_unique_ids(samples), warnings=tuple(search.warnings))


def _beside(source: Path) -> Path:
    """The folder that a video lies in, be it a file or a folder of frames; a folder of videos itself."""
    if not source.is_dir():
        return source.parent
    _, folders, files = next(walk(source))
    return source.parent if not folders and is_frame_folder(files) else source


def _list(source: Path, search: Search, skipped: Sequence[Path]) -> Sequence[VideoSample]:
    if source.is_dir():
        samples = list_folder(source, search, skipped, LAYOUTS)
        if not samples:
            held = Counter(p.suffix.lower() or "no suffix" for p in source.iterdir() if p.is_file())
            told = ", ".join(f"{n} x {suffix}" for suffix, n in held.most_common(4)) or "nothing"
            raise InputError(f"holds no video (found {told}), expected {_expected()}")
        return samples
    reader = NAMES.get(source.name) or FILES.get(source.suffix.lower())
    if reader is None:
        raise InputError(f"found a {source.suffix or 'nameless'} file, expected {_expected()}")
    return reader(source, search)


def _expected() -> str:
    films = ", ".join(sorted(s[1:] for s in VIDEO_SUFFIXES))
    return (
        f"a video ({films}), a folder of videos or frame folders, a npy/npz or HDF5 file, a LeRobot dataset or a "
        f"{manifest.NAME}"
    )


def _with_unique_ids(samples: Sequence[VideoSample]) -> tuple[VideoSample, ...]:
    """Give every sample an id of its own; of those that share a stem, the ones named by it take folders along."""
    ids = unique_ids([(s.id, _folders(s)) for s in samples])
    return tuple(replace(sample, id=id) for sample, id in zip(samples, ids, strict=True))


def _folders(sample: VideoSample) -> tuple[str, ...]:
    video = Path(sample.video)
    return video.parent.parts if sample.problem is None and sample.id in (video.stem, video.name) else ()
