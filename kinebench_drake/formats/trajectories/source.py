"""Search for trajectories in files, datasets, folders and output folders, and reading of one of them."""

import csv
import io
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError, UsageError, cause
from kinebench_drake.formats.folders import describe_ignored, list_suffixes, require_apart, require_present, walk
from kinebench_drake.formats.hdf5 import list_hdf5_trajectories, open_hdf5_table
from kinebench_drake.formats.kinebench import is_summary, open_executed_table
from kinebench_drake.formats.lerobot.reader import (
    is_lerobot,
    list_lerobot_trajectories,
    open_lerobot_table,
    open_parquet_table,
)
from kinebench_drake.formats.samples import finish_samples
from kinebench_drake.formats.trajectories.check import check
from kinebench_drake.formats.trajectories.columns import complete
from kinebench_drake.formats.trajectories.reading import Reading, TrajectoryOptions
from kinebench_drake.formats.trajectories.trajectory import (
    MAX_BYTES,
    MAX_FRAMES,
    PANDA_JOINTS,
    ColumnTable,
    NumberColumn,
    Trajectory,
    TrajectoryFormat,
    TrajectorySample,
    parse_number,
    require_numbers,
)
from kinebench_drake.io.files import absence, read_text
from kinebench_drake.io.hdf5 import HDF5_SUFFIXES
from kinebench_drake.io.jsonl import read_object
from kinebench_drake.io.npz import open_npz, read_npy
from kinebench_drake.results.aggregate import group_by
from kinebench_drake.results.store import SAMPLES, read_rows
from kinebench_drake.segments import evenly

_MOST_COLUMNS = 1000
_DELIMITERS = (",", ";", "\t")
FRAME_NUMBERS = 1024
"""Most numbers of a frame; more are images."""


@contextmanager
def open_npz_table(sample: TrajectorySample) -> Iterator[ColumnTable]:
    """Open an npz file. The angles of a track file (it has `ik_ok`) were computed from its poses."""
    with open_npz(sample.path, MAX_BYTES) as archive:
        shapes = {name: archive.shape(name) for name in archive.files}
        optional = frozenset({"q", "camera_from_hand"} if "ik_ok" in shapes else ())
        yield ColumnTable(columns=_columns(shapes), load=archive.__getitem__, optional=optional)


@contextmanager
def open_npy_table(sample: TrajectorySample) -> Iterator[ColumnTable]:
    """Open an npy file: joint angles (T, J) to (T, J + 2), or poses (T, 4, 4)."""
    array = read_npy(sample.path, MAX_BYTES)
    name = "base_from_tcp" if array.ndim == 3 else "q"
    yield ColumnTable(columns=_columns({name: array.shape}), load={name: array}.__getitem__)


@contextmanager
def open_json_table(sample: TrajectorySample) -> Iterator[ColumnTable]:
    """Open a json file: an object of lists, one of numbers per frame."""
    arrays: dict[str, NDArray[np.generic]] = {}
    for name, value in read_object(sample.path).items():
        if isinstance(value, list):
            try:
                arrays[name] = np.array(value, dtype=np.float64)
            except (TypeError, ValueError):
                continue  # texts, or rows of different lengths
    yield ColumnTable(columns=_columns({name: array.shape for name, array in arrays.items()}), load=arrays.__getitem__)


def _columns(shapes: Mapping[str, tuple[int, ...]]) -> tuple[NumberColumn, ...]:
    """Return the arrays with a row per frame."""
    sizes = {name: int(np.prod(shape[1:])) for name, shape in shapes.items() if 1 <= len(shape) <= 3}
    return tuple(NumberColumn(name=name, size=size) for name, size in sizes.items() if size <= FRAME_NUMBERS)


@contextmanager
def open_text_table(sample: TrajectorySample) -> Iterator[ColumnTable]:
    """Open a table of text: commas, semicolons, tabs or blanks between the fields, names in the first line.

    The first line may be a comment (#); without names the columns are `column_0`, `column_1`, ...

    Raises:
        InputError: the file is not such a table; the message names the line.
    """
    if not sample.path.stat().st_size:
        raise InputError("the file is empty (0 bytes)")
    header, rows = _read_text(sample.path)
    repeated = sorted(name for name, count in Counter(header).items() if count > 1)
    if repeated:
        raise InputError(f"the header names {', '.join(repeated)} more than once")

    def load(name: str) -> NDArray[np.generic]:
        k = header.index(name)
        return np.array([_number(fields[k], name, line) for line, fields in rows], dtype=np.float64)

    yield ColumnTable(columns=tuple(NumberColumn(name=name, size=1) for name in header), load=load)


def _read_text(path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Return the names of the columns, and the fields of each line with its number."""
    rows: list[tuple[int, list[str]]] = []
    header: list[str] = []
    try:
        lines = ((number, line.strip()) for number, line in enumerate(io.StringIO(read_text(path)), 1))
        split: Callable[[str], list[str]] | None = None
        for number, line in lines:
            if not line or (line.startswith("#") and split):
                continue
            if split is None:
                line = line.lstrip("# ")
                split = _splitter(line)
                header = split(line)
                if len(header) > _MOST_COLUMNS:
                    raise InputError(f"has {len(header)} columns, at most {_MOST_COLUMNS} are accepted")
                if not all(map(_is_number, header)):
                    continue
                header = [f"column_{k}" for k in range(len(header))]
            fields = split(line)
            if len(fields) != len(header):
                raise InputError(f"line {number} has {len(fields)} fields, the header {len(header)}")
            rows.append((number, fields))
            if len(rows) > MAX_FRAMES:
                raise InputError(f"has more than {MAX_FRAMES} frames: cut it into parts")
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"cannot be read as a comma-separated text ({cause(error)})") from None
    return header, rows


def _splitter(line: str) -> Callable[[str], list[str]]:
    """Return the function that splits lines like the first one into fields."""
    delimiter = max(_DELIMITERS, key=line.count)
    if not line.count(delimiter):
        return lambda text: re.split(r"\s+", text.strip())
    return lambda text: [field.strip() for field in next(csv.reader([text], delimiter=delimiter), [])]


def _is_number(text: str) -> bool:
    try:
        parse_number(text)
    except ValueError:
        return False
    return True


def _number(text: str, name: str, line: int) -> float:
    if not text and "width" in name:
        return np.nan
    try:
        return parse_number(text)
    except ValueError:
        raise InputError(f"line {line}: {name} is {text!r:.40}, expected a number") from None


EXPECTED = (
    "a trajectory (npz, npy, csv, txt, h5, json, parquet), a LeRobot dataset, an output folder or its tracks/, "
    "or a folder of these"
)
_TABLES: Mapping[TrajectoryFormat, Callable[[TrajectorySample], AbstractContextManager[ColumnTable]]] = {
    TrajectoryFormat.NPZ: open_npz_table,
    TrajectoryFormat.NPY: open_npy_table,
    TrajectoryFormat.CSV: open_text_table,
    TrajectoryFormat.JSON: open_json_table,
    TrajectoryFormat.PARQUET: open_parquet_table,
    TrajectoryFormat.HDF5: open_hdf5_table,
    TrajectoryFormat.MANISKILL: open_hdf5_table,
    TrajectoryFormat.KINEBENCH: open_executed_table,
    TrajectoryFormat.LEROBOT: open_lerobot_table,
}
_FORMATS = {
    ".npz": TrajectoryFormat.NPZ,
    ".csv": TrajectoryFormat.CSV,
    **dict.fromkeys(HDF5_SUFFIXES, TrajectoryFormat.HDF5),
}
"""Format of a file by its suffix in lower case."""
_NAMED = {
    ".npy": TrajectoryFormat.NPY,
    ".json": TrajectoryFormat.JSON,
    ".parquet": TrajectoryFormat.PARQUET,
    **dict.fromkeys((".txt", ".tsv"), TrajectoryFormat.CSV),
}
"""The same of files that count only if they are named: in a folder they may be anything."""
ALIKE = 8
"""Trajectories of a file that show how all are to be read."""


def find_trajectories(
    source: Path,
    choice: TrajectoryOptions,
    *,
    out: Path | None = None,
    model: str | None = None,
    task: str | None = None,
    warnings: list[str] | None = None,
) -> tuple[TrajectorySample, ...]:
    """List the trajectories of a file, a LeRobot dataset, an output folder or a folder of these, in a fixed order.

    None of them is read, but for what divides a file into episodes.

    Args:
        out: output folder of the run, whose content is never used as input.
        model: name of the model, for trajectories without one.
        task: name of the task, for trajectories without one.
        warnings: is extended by files of a folder that are no trajectories.

    Raises:
        UsageError: there is nothing to read, a dataset has no suitable column, or a run into `out` would change its
            inputs.
    """
    require_present(source)
    if out is not None:
        require_apart(out, source)
    if not source.is_dir():
        if source.suffix.lower() not in _FORMATS | _NAMED:
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
        ignored: list[Path] = []
        samples = list(_list_folder(source, choice, out, ignored))
        if warnings is not None:
            warnings += describe_ignored(ignored)
    if not samples:
        raise UsageError(f"{source}: holds no trajectory (found {list_suffixes(source)}), expected {EXPECTED}")
    return finish_samples(_with_alike(samples), lambda sample: Path(sample.video).parent.parts, model, task)


def read_trajectory(sample: TrajectorySample, choice: TrajectoryOptions) -> Trajectory:
    """Read and check one trajectory."""
    with open_table(sample, choice.joints) as table:
        reading = complete(table, choice.reading or Reading())
        trajectory = apply_reading(sample, table, reading, choice.rate_hz)
        actions = table.actions(reading.columns or ())
        if actions is None or len(actions) != len(trajectory.t_s):
            return trajectory
        return replace(trajectory, commands=(table.numbers(reading.columns or ()), actions))


@contextmanager
def open_table(sample: TrajectorySample, joints: tuple[str, ...] = PANDA_JOINTS) -> Iterator[ColumnTable]:
    """Open the numbers of a trajectory of an arm with `joints`.

    Raises:
        InputError: it cannot be read.
    """
    if sample.problem is not None:
        raise InputError(sample.problem)
    if not sample.path.is_file():
        raise InputError(f"{sample.path.name}: {absence(sample.path)}")
    rows = slice(*sample.rows) if sample.rows else slice(None)
    with _TABLES[sample.format](sample) as table:
        t_s = None if table.t_s is None else table.t_s[rows]
        # read several times by several readings
        yield replace(table, load=cache(lambda name: table.load(name)[rows]), t_s=t_s, joints=joints)


def apply_reading(sample: TrajectorySample, table: ColumnTable, reading: Reading, rate_hz: float | None) -> Trajectory:
    """Return the checked trajectory of a table by a complete reading."""
    raw = reading.apply(table)
    return check(replace(raw, warnings=(*sample.warnings, *raw.warnings)), rate_hz)


def _with_alike(samples: Sequence[TrajectorySample]) -> list[TrajectorySample]:
    """Return samples with some of the others of their file or dataset, which are described together."""
    parts = [s for s in samples if (s.part is not None or s.rows is not None) and s.problem is None]
    groups = group_by(parts, lambda sample: (*sample.about, sample.path)[0])
    chosen = {key: tuple(group[k] for k in evenly(len(group), ALIKE)) for key, group in groups.items()}
    return [replace(sample, alike=chosen.get((*sample.about, sample.path)[0], ())) for sample in samples]


def _list_file(path: Path, video: str) -> list[TrajectorySample]:
    format = (_FORMATS | _NAMED)[path.suffix.lower()]
    samples = [TrajectorySample(id=path.stem, path=path, video=video, format=format)]
    if format is TrajectoryFormat.HDF5:
        samples = list_hdf5_trajectories(path, video)
    return _split_episodes(samples[0]) if len(samples) == 1 else samples


_EPISODE = re.compile(r"(?:.*[./])?(?:episode|(?:episode|demo|traj|trajectory)_(?:index|idx|id))", re.IGNORECASE)
"""Columns with the number of each row's episode."""
_ENDS = re.compile(r"(?:.*[./])?episode_ends", re.IGNORECASE)
"""Arrays with the end of each episode: the row after its last."""
_HEAD = 65536
"""Bytes of a table of text that hold the names of its columns."""


def _split_episodes(whole: TrajectorySample) -> list[TrajectorySample]:
    """Return a sample for each episode of a file whose numbers say where episodes begin; else the sample as it is."""
    if whole.part is not None or whole.problem is not None:
        return [whole]
    try:
        if whole.format is TrajectoryFormat.CSV and not re.search(rb"(?i)episode|demo_|traj", _head(whole.path)):
            return [whole]
        with open_table(whole) as table:
            episodes = _episodes(table)
    except (InputError, OSError):  # said again, in full, when the trajectory is read
        return [whole]
    if len(episodes) < 2:
        return [whole]
    numbers = [number for number, _ in episodes]
    if len(set(numbers)) < len(numbers):
        return [replace(whole, problem="holds several episodes whose rows are not together: sort the rows by episode")]
    return [
        replace(whole, id=f"{whole.id}-episode_{number}", video=f"{whole.video}#episode_{number}", rows=rows)
        for number, rows in episodes
    ]


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(_HEAD)


def _episodes(table: ColumnTable) -> list[tuple[int, tuple[int, int]]]:
    """Return number, first row and end of the episodes of a table; empty if no column tells them."""
    for column in table.columns:
        if column.size != 1 or not (_EPISODE.fullmatch(column.name) or _ENDS.fullmatch(column.name)):
            continue
        values = require_numbers(column.name, table.load(column.name)).ravel()
        if not len(values) or (values != values.round()).any():
            continue
        if _ENDS.fullmatch(column.name):
            cuts = [0, *map(int, values)]
            numbers = list(range(len(values)))
        else:
            starts = [0, *(np.flatnonzero(np.diff(values)) + 1).tolist()]
            cuts = [*starts, len(values)]
            numbers = [int(values[start]) for start in starts]
        return list(zip(numbers, pairwise(cuts), strict=True))
    return []


def _list_output(folder: Path) -> list[TrajectorySample]:
    """List the tracks of an output folder, with the labels of their rows."""
    try:
        rows = read_rows(folder)
    except InputError as error:
        raise UsageError(str(error)) from None
    samples = []
    for path in sorted(p for p in (folder / "tracks").glob("*.npz") if not p.name.startswith(".")):
        row = rows.get(path.stem)
        samples.append(
            TrajectorySample(
                id=path.stem,
                path=path,
                video=f"tracks/{path.name}",
                format=TrajectoryFormat.NPZ,
                task=row.task if row else None,
                model=row.model if row else None,
                seed=row.seed if row else None,
                prompt=row.prompt if row else None,
            )
        )
    return samples


def _list_folder(
    folder: Path, choice: TrajectoryOptions, out: Path | None, ignored: list[Path]
) -> Iterator[TrajectorySample]:
    """List trajectory files and datasets at any depth, sorted; append other files to `ignored`."""
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
        read = [f for f in files if Path(f).suffix.lower() in _FORMATS and not is_summary(here / f)]
        about = {Path(f).with_suffix(".json").name for f in read}
        ignored += [here / f for f in files if f not in about.union(read)]
        for name in read:
            yield from _list_file(here / name, (here / name).relative_to(folder).as_posix())
