"""Search for trajectories in files, datasets, folders and output folders, and reading of one of them."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.formats.folders import list_suffixes, require_apart, walk
from kinebench_drake.formats.lerobot.reader import is_lerobot, list_lerobot_trajectories, read_lerobot
from kinebench_drake.formats.maniskill import list_maniskill, read_maniskill
from kinebench_drake.formats.samples import finish_samples
from kinebench_drake.formats.trajectories.check import check
from kinebench_drake.formats.trajectories.csv_npz import read_csv, read_npz
from kinebench_drake.formats.trajectories.trajectory import (
    RawTrajectory,
    Trajectory,
    TrajectoryFormat,
    TrajectoryOptions,
    TrajectorySample,
)
from kinebench_drake.io.files import absence
from kinebench_drake.io.hdf5 import HDF5_SUFFIXES
from kinebench_drake.io.jsonl import as_type
from kinebench_drake.results.store import SAMPLES, read_rows

EXPECTED = (
    "a trajectory (npz, csv, ManiSkill h5), a LeRobot dataset, an output folder or its tracks, or a folder of these"
)
_READERS: Mapping[TrajectoryFormat, Callable[[TrajectorySample, TrajectoryOptions], RawTrajectory]] = {
    TrajectoryFormat.NPZ: read_npz,
    TrajectoryFormat.CSV: read_csv,
    TrajectoryFormat.MANISKILL: read_maniskill,
    TrajectoryFormat.LEROBOT: read_lerobot,
}
_FORMATS = {
    ".npz": TrajectoryFormat.NPZ,
    ".csv": TrajectoryFormat.CSV,
    **dict.fromkeys(HDF5_SUFFIXES, TrajectoryFormat.MANISKILL),
}
"""Format of a file by its suffix in lower case."""


def find_trajectories(
    source: Path,
    choice: TrajectoryOptions,
    *,
    out: Path | None = None,
    model: str | None = None,
    task: str | None = None,
) -> tuple[TrajectorySample, ...]:
    """List the trajectories of a file, a LeRobot dataset, an output folder or a folder of these, in a fixed order.

    None of them is read.

    Args:
        source: path named by the user.
        choice: options of the user.
        out: output folder of the run, whose content is never used as input.
        model: name of the model, for trajectories without one.
        task: name of the task, for trajectories without one.

    Raises:
        UsageError: there is nothing to read, a dataset has no suitable column, or a run into `out` would change its
            inputs.
    """
    if not source.exists():
        raise UsageError(f"{source}: {absence(source)}")
    if out is not None:
        require_apart(out, source)
    if not source.is_dir():
        if source.suffix.lower() not in _FORMATS:
            raise UsageError(f"{source}: found a {source.suffix or 'nameless'} file, expected {EXPECTED}")
        samples = _list_file(source, source.name)
    elif is_lerobot(source):
        try:
            samples = list_lerobot_trajectories(source, source.resolve().name, choice)
        except InputError as error:
            raise UsageError(f"{source}: {error}") from None
    elif (source / SAMPLES).is_file():
        samples = _list_output(source)
    elif source.resolve().name == "tracks" and (source.resolve().parent / SAMPLES).is_file():
        samples = _list_output(source.resolve().parent)
    else:
        samples = list(_list_folder(source, choice, out))
    if not samples:
        raise UsageError(f"{source}: holds no trajectory (found {list_suffixes(source)}), expected {EXPECTED}")
    return finish_samples(samples, lambda sample: Path(sample.video).parent.parts, model, task)


def read_trajectory(sample: TrajectorySample, choice: TrajectoryOptions) -> Trajectory:
    """Read and check one trajectory.

    Raises:
        InputError: it cannot be read, or is invalid.
        UnmeasurableError: it is too short.
    """
    if sample.problem is not None:
        raise InputError(sample.problem)
    if not sample.path.is_file():
        raise InputError(f"{sample.path.name}: {absence(sample.path)}")
    raw = _READERS[sample.format](sample, choice)
    return check(replace(raw, warnings=(*sample.warnings, *raw.warnings)), choice.rate_hz)


def _list_file(path: Path, video: str) -> list[TrajectorySample]:
    format = _FORMATS[path.suffix.lower()]
    if format is TrajectoryFormat.MANISKILL:
        return list_maniskill(path, video)
    return [TrajectorySample(id=path.stem, path=path, video=video, format=format)]


def _list_output(folder: Path) -> list[TrajectorySample]:
    """List the tracks of an output folder, with the labels of their rows."""
    try:
        rows = read_rows(folder)
    except InputError as error:
        raise UsageError(str(error)) from None
    samples = []
    for path in sorted(p for p in (folder / "tracks").glob("*.npz") if not p.name.startswith(".")):
        row = rows.get(path.stem)
        extra = row.extra if row else {}
        samples.append(
            TrajectorySample(
                id=path.stem,
                path=path,
                video=f"tracks/{path.name}",
                format=TrajectoryFormat.NPZ,
                task=row.task if row else None,
                model=row.model if row else None,
                seed=as_type(extra.get("seed"), int),
                prompt=as_type(extra.get("prompt"), str),
            )
        )
    return samples


def _list_folder(folder: Path, choice: TrajectoryOptions, out: Path | None) -> Iterator[TrajectorySample]:
    """List trajectory files and datasets at any depth, sorted."""
    for here, folders, files in walk(folder, [] if out is None else [out]):
        if is_lerobot(here):
            folders.clear()
            name = here.relative_to(folder).as_posix()
            try:
                yield from list_lerobot_trajectories(here, name, choice)
            except InputError as error:  # a dataset that cannot be used becomes a sample with a problem
                format = TrajectoryFormat.LEROBOT
                yield TrajectorySample(id=here.name, path=here, video=name, format=format, problem=str(error))
            continue
        for name in (f for f in files if Path(f).suffix.lower() in _FORMATS):
            yield from _list_file(here / name, (here / name).relative_to(folder).as_posix())
