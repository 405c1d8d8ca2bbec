"""From what the user named (a video, a folder, a manifest) to the list of samples to work on."""

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path

import numpy as np

from kinebench_drake import manifest
from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.geometry import checked_pose
from kinebench_drake.grounding.array_file import ARRAY_SUFFIXES
from kinebench_drake.grounding.film import FILM_SUFFIXES
from kinebench_drake.grounding.frame_folder import FRAME_SUFFIXES
from kinebench_drake.grounding.known import FirstFrame
from kinebench_drake.identity import shorten, unique_ids

CAMERA_NAME = "camera.json"


class CameraSource(Enum):
    """Where a sample's camera comes from, in order of precedence."""

    MANIFEST = "manifest"
    FOLDER = "folder"
    BENCHMARK = "benchmark"


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """One video to work on and what its owner says about it."""

    id: str
    """Unique, safe as a file name, contains the video's stem."""
    path: Path
    """Where the video lies."""
    video: str
    """The video as results name it: relative to the named folder or manifest."""
    camera: Camera
    """The camera before it is scaled to the video's size."""
    camera_source: CameraSource
    task: str | None
    model: str | None
    seed: int | None
    prompt: str | None
    fps: float | None
    """Frames per second, over what the file says [1/s]; None leaves it to the file."""
    frame_period_s: float | None
    """Task time between two frames [s] given by the manifest; None leaves it to the command line or the file."""
    first: FirstFrame | None
    """The robot in the first frame as the manifest tells it; None where it does not."""
    problem: str | None
    """Why the sample cannot be read at all (a broken manifest line); None when it can be tried."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Inputs:
    """All samples found, in a fixed order, and what the user should know about them."""

    samples: tuple[Sample, ...]
    warnings: tuple[str, ...]


def find_samples(
    source: Path,
    *,
    out: Path | None = None,
    model: str | None = None,
    task: str | None = None,
    others: Sequence[Path] = (),
) -> Inputs:
    """List the samples of a video, frame folder, npy/npz file, folder of videos or manifest.

    Args:
        source: what the user named.
        out: a folder whose content is never taken for input (the run's own output).
        model: name of the world model, for samples that name none.
        task: name of the task, for samples that name none.
        others: folders whose pictures are no videos (masks, depth), where they lie below a folder named.

    Raises:
        UsageError: there is nothing to read, or a `camera.json` is unusable.
    """
    if not source.exists():
        raise UsageError(f"{source}: there is no such file or folder")
    if source.is_dir():
        inputs = _from_folder(source, out, others)
    elif source.suffix.lower() == ".jsonl":
        inputs = _from_manifest(source)
    elif source.suffix.lower() in FILM_SUFFIXES | ARRAY_SUFFIXES:
        inputs = Inputs(samples=(_plain(source, source.name, _Cameras(source.parent)),), warnings=())
    else:
        raise UsageError(f"{source}: found a {source.suffix or 'nameless'} file, expected {_expected()}")
    samples = [replace(s, model=s.model or model, task=s.task or task) for s in inputs.samples]
    return replace(inputs, samples=_with_unique_ids(samples))


def _expected() -> str:
    films = ", ".join(sorted(s[1:] for s in FILM_SUFFIXES))
    return f"a video ({films}), a folder of videos or frame folders, a npy/npz file or a {manifest.NAME}"


class _Cameras:
    """The `camera.json` that holds for a folder: its own or the nearest above, up to the named folder."""

    def __init__(self, top: Path) -> None:
        self._top = top
        self._known: dict[Path, Camera | None] = {}
        self.of(top)  # an unusable file is told at once, even if no sample needs it

    def of(self, folder: Path) -> Camera | None:
        if folder not in self._known:
            file = folder / CAMERA_NAME
            if file.exists():
                self._known[folder] = Camera.load(file)
            else:
                within = folder != self._top and folder.is_relative_to(self._top)
                self._known[folder] = self.of(folder.parent) if within else None
        return self._known[folder]


def _plain(path: Path, video: str, cameras: _Cameras) -> Sample:
    """A sample about which nothing is known but its file."""
    found = cameras.of(path if path.is_dir() else path.parent)
    return Sample(
        id=path.name if path.is_dir() else path.stem,
        path=path,
        video=video,
        camera=found or benchmark_camera(),
        camera_source=CameraSource.FOLDER if found else CameraSource.BENCHMARK,
        task=None,
        model=None,
        seed=None,
        prompt=None,
        fps=None,
        frame_period_s=None,
        first=None,
        problem=None,
    )


def _from_folder(folder: Path, out: Path | None, others: Sequence[Path]) -> Inputs:
    if out is not None and out.resolve() == folder.resolve():
        raise UsageError("--out is the input folder itself; name another folder")
    cameras = _Cameras(folder)
    name = folder.resolve().name
    skipped = [p for p in (out, *others) if p is not None]
    samples = [
        _plain(p, name if p == folder else p.relative_to(folder).as_posix(), cameras) for p in _videos(folder, skipped)
    ]
    if folder in (s.path for s in samples):
        samples = [replace(s, id=name) if s.path == folder else s for s in samples]
    if not samples:
        if (folder / "meta" / "info.json").is_file():
            raise UsageError(
                f"{folder}: found a LeRobot dataset, whose videos this version does not read (`audit` reads its "
                f"trajectories); expected {_expected()}"
            )
        held = Counter(p.suffix.lower() or "no suffix" for p in folder.iterdir() if p.is_file())
        found = ", ".join(f"{n} x {suffix}" for suffix, n in held.most_common(4)) or "nothing"
        raise UsageError(f"{folder}: holds no video (found {found}), expected {_expected()}")
    warnings: tuple[str, ...] = ()
    if (folder / manifest.NAME).is_file():
        warnings = (f"{folder / manifest.NAME} is not read, as the folder was named; name the file itself to use it",)
    return Inputs(samples=tuple(samples), warnings=warnings)


def _videos(folder: Path, others: Sequence[Path]) -> Iterator[Path]:
    """Films and frame folders at any depth, sorted; hidden entries, `others` and output folders are passed over."""
    skipped = {p.resolve() for p in others} - {folder.resolve()}
    seen: set[Path] = set()
    for root, folders, files in os.walk(folder, followlinks=True):
        here = Path(root)
        real = here.resolve()
        output = here != folder and {"samples.jsonl", "results.json"} <= set(files)
        if real in seen or real in skipped or output:
            folders.clear()
            continue
        seen.add(real)
        folders[:] = sorted(f for f in folders if not f.startswith("."))
        shown = sorted(f for f in files if not f.startswith("."))
        films = [f for f in shown if Path(f).suffix.lower() in FILM_SUFFIXES]
        if films:
            yield from (here / f for f in films)
        elif any(Path(f).suffix.lower() in FRAME_SUFFIXES for f in shown):
            yield here


def _from_manifest(path: Path) -> Inputs:
    cameras = _Cameras(path.parent)
    samples, unknown = [], Counter[str]()
    for line in manifest.read_manifest(path):
        unknown.update(line.unknown)
        samples.append(_from_line(line, path.parent, cameras))
    warnings = []
    if unknown:
        told = ", ".join(f"{key!r} ({n} x)" for key, n in sorted(unknown.items()))
        warnings.append(
            f"{path.name}: unknown keys {told} are not read; known are {', '.join(manifest.Entry.model_fields)}"
        )
    return Inputs(samples=tuple(samples), warnings=tuple(warnings))


def _from_line(line: manifest.Line, folder: Path, cameras: _Cameras) -> Sample:
    name = line.video or f"line-{line.number}"
    stem = Path(name).name if (folder / name).is_dir() else Path(name).stem
    given = None if line.id is None else shorten(line.id)
    given = given if given is None or stem in given else f"{given}-{stem}"
    entry, problem, camera, path = line.entry, line.problem, None, folder
    if entry is not None:
        try:
            path = manifest.inside(folder, entry.video, "video")
            camera = manifest.entry_camera(entry, folder)
        except InputError as error:
            problem = f"line {line.number}: {error}"
    found = cameras.of(path if path.is_dir() else path.parent) if problem is None else None
    source = CameraSource.MANIFEST if camera else CameraSource.FOLDER if found else CameraSource.BENCHMARK
    return Sample(
        id=given or stem,
        path=path,
        video=line.video,
        camera=camera or found or benchmark_camera(),
        camera_source=source,
        task=entry.task if entry else None,
        model=entry.model if entry else None,
        seed=entry.seed if entry else None,
        prompt=entry.prompt if entry else None,
        fps=entry.fps if entry else None,
        frame_period_s=entry.frame_period_s if entry else None,
        first=_first(entry) if entry else None,
        problem=problem,
    )


def _first(entry: manifest.Entry) -> FirstFrame | None:
    if entry.first_base_from_tcp is None:
        return None
    X_BG, width = checked_pose(entry.first_base_from_tcp), entry.first_finger_width_m
    if width is None:
        return FirstFrame(X_BG=X_BG)
    return FirstFrame(X_BG=X_BG, finger_width_m=float(np.clip(width, 0.0, manifest.WIDEST_M)))


def _with_unique_ids(samples: Sequence[Sample]) -> tuple[Sample, ...]:
    """Give every sample an id of its own; of those that share a stem, the ones named by it take folders along."""
    ids = unique_ids([(s.id, _folders(s)) for s in samples])
    return tuple(replace(sample, id=id) for sample, id in zip(samples, ids, strict=True))


def _folders(sample: Sample) -> tuple[str, ...]:
    video = Path(sample.video)
    return video.parent.parts if sample.problem is None and sample.id in (video.stem, video.name) else ()
