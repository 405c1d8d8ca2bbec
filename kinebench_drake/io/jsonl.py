"""JSON and JSON Lines files: strict text, atomic writes, and files of lines that survive a killed process."""

import json
import math
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from kinebench_drake.errors import InputError, UsageError, cause
from kinebench_drake.io.atomic import atomic_path, disk_errors, write_atomically
from kinebench_drake.io.files import parse_json
from kinebench_drake.types import Json

Row = TypeVar("Row")


def make_folder(out: Path) -> None:
    """Create an output folder.

    Raises:
        UsageError: it cannot be created.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"--out {out}: cannot be made a folder ({cause(error)}); name another one") from None


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write one JSON object, indented."""
    write_atomically(path, dump(value, indent=1).encode())


def write_lines(path: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write one JSON object a line."""
    write_atomically(path, "".join(map(dump, rows)).encode())


def read_lines(path: Path, parse: Callable[[object], Row]) -> list[Row]:
    """Read the JSON value of each line; a torn last line is ignored, a missing file has no lines.

    Args:
        path: the file.
        parse: converts the JSON value of a line; a ValueError or InputError says that it is invalid.

    Raises:
        InputError: a line other than the last is invalid.
    """
    lines = path.read_bytes().split(b"\n") if path.is_file() else [b""]
    rows = []
    for number, line in enumerate(lines[:-1], 1):  # what follows the last line feed is torn
        try:
            rows.append(parse(parse_json(line)))
        except (ValueError, InputError) as error:
            if number == len(lines) - 1:
                break
            raise InputError(f"{path}: line {number} is broken ({error})") from None
    return rows


def append_line(path: Path, row: Mapping[str, Any]) -> None:
    """Append one JSON object as a line: on disk when this returns, and not at all if it fails.

    Raises:
        SetupError: writing failed; the file is unchanged.
    """
    data = dump(row).encode()
    with disk_errors(path.name), path.open("ab", buffering=0) as file:
        before = file.seek(0, os.SEEK_END)
        try:
            while data:
                data = data[file.write(data) or 0 :]
            os.fsync(file.fileno())
        except OSError:
            file.truncate(before)
            raise


def drop_torn_line(path: Path) -> None:
    """Cut off what follows the last line feed, so that lines can be appended.

    Raises:
        SetupError: writing failed.
    """
    if path.is_file():
        data = path.read_bytes()
        whole = data[: data.rfind(b"\n") + 1]
        if len(whole) < len(data):
            write_atomically(path, whole)


def write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write an npz file, the same bytes for the same arrays."""
    with atomic_path(path) as part, part.open("wb") as file:
        np.savez_compressed(file, **arrays)


def dump(value: Json, *, indent: int | None = None) -> str:
    """Return strict JSON text in ASCII, ending with a line feed."""
    return json.dumps(value, allow_nan=False, indent=indent) + "\n"


def finite(value: Json) -> Json:
    """Return `value` with null in place of every NaN and infinity, which strict JSON does not have."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {k: finite(v) for k, v in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [finite(v) for v in value]
    return value


def intern_text(value: Any) -> Any:
    """Return `value` with valid Unicode text, equal strings being one object.

    Thousands of rows repeat the same names and words. Characters that are not Unicode, from names of files and escapes
    in JSON, become question marks.
    """
    if isinstance(value, str):
        return sys.intern(value.encode(errors="replace").decode())
    if isinstance(value, Mapping):
        return {intern_text(k): intern_text(v) for k, v in value.items()}
    if isinstance(value, tuple):
        return tuple(map(intern_text, value))
    return list(map(intern_text, value)) if isinstance(value, list) else value
