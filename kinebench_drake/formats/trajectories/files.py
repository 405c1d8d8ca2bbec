"""Tables in files of one trajectory: npz, npy, csv and other delimited text, json, parquet."""

import csv
import io
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError, cause
from kinebench_drake.formats.trajectories.column_table import ColumnTable, NumberColumn
from kinebench_drake.formats.trajectories.trajectory import MAX_BYTES, MAX_FRAMES, TrajectorySample, parse_number
from kinebench_drake.io.files import read_text
from kinebench_drake.io.jsonl import read_object
from kinebench_drake.io.npz import open_npz, read_npy

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
    """Open an npy file: joint angles (T, 7) to (T, 9), or poses (T, 4, 4)."""
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
