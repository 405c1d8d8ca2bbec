"""Search for videos: from a path to its samples, by the format of the file or folder."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from pathlib import Path

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.formats import dream_exe, hdf5, kinebench, manifest, worldarena
from kinebench_drake.formats.camerafile import CAMERA_NAME, CameraLookup
from kinebench_drake.formats.folders import (
    describe_ignored,
    is_output,
    list_suffixes,
    require_apart,
    require_present,
    run_of,
    walk,
)
from kinebench_drake.formats.lerobot import reader as lerobot
from kinebench_drake.formats.samples import finish_samples
from kinebench_drake.formats.videos.sample import Search, VideoSample, VideoSamples
from kinebench_drake.io.files import IMAGE_SUFFIXES, VIDEO_SUFFIXES
from kinebench_drake.io.hdf5 import HDF5_SUFFIXES
from kinebench_drake.io.reader import ARRAY_SUFFIXES, is_video_array
from kinebench_drake.io.video import VideoPart


def list_file(path: Path, search: Search) -> list[VideoSample]:
    """List a video or npy file, or an array of an npz file: the one that the camera key names, else the default one.

    Of a file of a LeRobot dataset that holds several episodes these are listed.
    """
    if path.suffix.lower() in VIDEO_SUFFIXES:
        with suppress(InputError):  # a file of a dataset that cannot be used still is a video
            if episodes := lerobot.list_lerobot_file(path, search):
                search.warnings.append(
                    f"{path.name} holds {len(episodes)} episodes of a LeRobot dataset: each is a sample"
                )
                return episodes
    sample = search.sample(path)
    if path.suffix.lower() != ".npz" or search.camera_key is None:
        return [sample]
    return [replace(sample, part=VideoPart(key=search.camera_key), camera_key=search.camera_key)]


_SIDECARS = (CAMERA_NAME, manifest.NAME)
"""Files that describe the videos of a folder."""
Lister = Callable[[Path, Search], list[VideoSample]]
"""Function that lists the videos of a file or folder; raises InputError if it cannot be used."""

FILES: Mapping[str, Lister] = {
    ".jsonl": manifest.list_manifest,
    **dict.fromkeys(HDF5_SUFFIXES, hdf5.list_hdf5),
    **dict.fromkeys(VIDEO_SUFFIXES | ARRAY_SUFFIXES, list_file),
}
"""Functions that list the videos of a named file, by its suffix in lower case."""

LAYOUTS: Mapping[Callable[[Path], bool], Lister] = {
    lerobot.is_lerobot: lerobot.list_lerobot_videos,
    dream_exe.is_dream_exe: dream_exe.list_dream_exe,
    kinebench.is_kinebench: kinebench.list_kinebench,
    worldarena.is_submission: worldarena.list_submission,
}
"""Functions that list the videos of a dataset that is a folder, by the test of its format; the first that is true."""


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
        out: output folder of the run, whose content is never used as input.
        model: name of the world model, for samples without one.
        task: name of the task, for samples without one.
        others: folders of masks, depth or poses, whose images are no videos.

    Raises:
        UsageError: there is nothing to read, the choice of the camera is ambiguous, a `camera.json` is unusable, or a
            run into `out` would change its inputs.
    """
    require_present(source)
    if (run := run_of(source)) is not None:
        raise UsageError(f"{source}: was written by a run (output folder {run.name}); name the videos that it scored")
    if out is not None:
        require_apart(out, source, *others)
    top = source if source.is_dir() else source.parent
    search = Search(top=top, cameras=CameraLookup(_camera_folder(source)), camera_key=camera_key)
    try:
        samples = _list(source, search, [p for p in (out, *others) if p is not None])
    except InputError as error:
        raise UsageError(f"{source}: {error}") from None
    if camera_key is not None and not any(sample.camera_key or sample.problem for sample in samples):
        raise UsageError(
            f"$camera_key {camera_key}: {source} has nothing to choose from; it is for LeRobot datasets, HDF5 and npz "
            "files with several cameras"
        )
    return VideoSamples(samples=finish_samples(samples, _folders, model, task), warnings=tuple(search.warnings))


def list_folder(folder: Path, search: Search, skipped: Sequence[Path]) -> list[VideoSample]:
    """List the video files, frame folders and datasets below a folder, sorted.

    A dataset that cannot be used becomes one sample with a problem, unless it is `folder` itself.

    Raises:
        InputError: `folder` is a dataset that cannot be used.
        UsageError: a camera.json is unusable.
    """
    samples: list[VideoSample] = []
    arrays: list[Path] = []
    ignored: list[Path] = []
    for here, folders, files in walk(folder, skipped):
        lister = next((lister for matches, lister in LAYOUTS.items() if matches(here)), None)
        if lister is not None:
            folders.clear()
            try:
                samples += lister(here, search)
            except InputError as error:
                if here == search.top:
                    raise
                broken = VideoSample(id=here.name, path=here, video=search.name(here))
                samples.append(replace(broken, problem=str(error)))
            continue
        videos = [f for f in files if Path(f).suffix.lower() in VIDEO_SUFFIXES]
        if videos:
            samples += chain.from_iterable(list_file(here / f, search) for f in videos)
        elif _is_frame_folder(files):
            samples.append(search.sample(here))
        is_video = not videos and _is_frame_folder(files)
        stems = {Path(f).stem for f in videos}
        ignored += [here / f for f in files if not is_video and f not in _SIDECARS and Path(f).stem not in stems]
        arrays += [here / f for f in files if Path(f).suffix.lower() in ARRAY_SUFFIXES and is_video_array(here / f)]
    if (folder / manifest.NAME).is_file():
        search.warnings.append(
            f"{folder / manifest.NAME} ignored, also the frame periods and cameras that it states; score the manifest "
            "itself to use them"
        )
    if arrays:
        search.warnings.append(
            f"videos in npy or npz files ignored ({len(arrays)}, such as {search.name(arrays[0])}): in a folder only "
            f"video files and frame folders count; name the file, or list the files in a {manifest.NAME} and name that"
        )
    search.warnings.extend(describe_ignored(sorted({*ignored} - {*arrays})))
    return samples


def _camera_folder(source: Path) -> Path:
    """Return the top folder whose camera file applies: the parent of a video file or frame folder, else the folder."""
    if not source.is_dir():
        return source.parent
    _, folders, files = next(walk(source))
    return source.parent if not folders and _is_frame_folder(files) else source


def _is_frame_folder(files: Sequence[str]) -> bool:
    """Return whether a folder of these files is one video: it holds images, and no video files."""
    suffixes = {Path(f).suffix.lower() for f in files}
    return bool(suffixes & IMAGE_SUFFIXES) and not suffixes & VIDEO_SUFFIXES


def _list(source: Path, search: Search, skipped: Sequence[Path]) -> Sequence[VideoSample]:
    if source.is_dir():
        samples = list_folder(source, search, skipped)
        if not samples and is_output(source):
            raise InputError("is the output folder of a run and holds no input; name the videos that it scored")
        if not samples:
            raise InputError(f"holds no video (found {list_suffixes(source)}), expected {_expected()}")
        return samples
    lister = FILES.get(source.suffix.lower())
    if lister is None:
        raise InputError(f"found a {source.suffix or 'nameless'} file, expected {_expected()}")
    return lister(source, search)


def _expected() -> str:
    suffixes = ", ".join(sorted(s[1:] for s in VIDEO_SUFFIXES))
    return (
        f"a video ({suffixes}), a folder of videos or frame folders, a npy/npz or HDF5 file, a LeRobot dataset or a "
        f"{manifest.NAME}"
    )


def _folders(sample: VideoSample) -> tuple[str, ...]:
    """Return the folders that may be prepended to the id of a sample named by its file."""
    video = Path(sample.video)
    return video.parent.parts if sample.problem is None and sample.id in (video.stem, video.name) else ()
