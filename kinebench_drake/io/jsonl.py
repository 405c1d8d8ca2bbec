"""JSON and JSON Lines files: strict text, atomic writes, and files of lines that survive a killed process."""

import json
import math
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from kinebench_drake.errors import InputError, cause
from kinebench_drake.io.atomic import atomic_path, disk_errors, write_atomically
from kinebench_drake.io.files import read_bytes

Json: TypeAlias = bool | int | float | str | Sequence["Json"] | Mapping[str, "Json"] | None
"""A JSON value."""
Row = TypeVar("Row")
Kind = TypeVar("Kind")


def parse_json(text: str | bytes) -> object:
    """Parse JSON text; integers that fit no 64-bit word become floats.

    Raises:
        ValueError: it is not JSON, or nested too deeply.
    """
    try:
        value: object = json.loads(text, parse_int=_parse_integer)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    return value


def _parse_integer(text: str) -> int | float:
    if len(text) > 20:  # longest integer that is parsed as an integer
        return float(text)
    value = int(text)
    return value if abs(value) < 2**63 else float(value)


def read_json(path: Path) -> object:
    """Return the value in a JSON file."""
    return parse_json(read_bytes(path))


def read_object(path: Path) -> Mapping[str, object]:
    """Return the object in a JSON file; empty if the file holds another value.

    Raises:
        FileNotFoundError: there is no such file.
        InputError: it cannot be read as JSON.
    """
    try:
        return as_object(read_json(path))
    except FileNotFoundError:
        raise
    except (OSError, ValueError) as error:
        raise InputError(f"{path.name} cannot be read as JSON ({cause(error)})") from None


def as_object(value: object) -> Mapping[str, object]:
    """Return the value if it is a JSON object, else an empty object."""
    return value if isinstance(value, Mapping) else {}


def as_type(value: object, kind: type[Kind]) -> Kind | None:
    """Return the value if it is of a type, else None; booleans are no integers."""
    return value if isinstance(value, kind) and isinstance(value, bool) <= (kind is bool) else None


def as_number(value: object) -> float | None:
    """Return the value if it is a finite number, else None."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write one JSON object, indented."""
    write_atomically(path, dump(value, indent=1).encode())


def write_lines(path: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write one JSON object a line."""
    write_raw_lines(path, (dump(row).encode() for row in rows))


def write_raw_lines(path: Path, lines: Iterable[bytes]) -> None:
    """Write lines that end with a line feed."""
    with atomic_path(path) as part, part.open("wb") as file:
        file.writelines(lines)


def read_lines(path: Path, parse: Callable[[object], Row]) -> list[Row]:
    """Read the JSON value of each line; a torn last line is ignored, a missing file has no lines.

    `parse` converts a value, or raises ValueError or InputError.
    """
    return list(parse_lines(path, lambda value, start, size: parse(value)))


def parse_lines(path: Path, parse: Callable[[object, int, int], Row]) -> Iterator[Row]:
    """Yield the converted JSON value of each line as `read_lines` does, one at a time.

    `parse` is also given the offset and the size of the line [bytes].

    Raises:
        InputError: a line other than the last is invalid.
    """
    if not path.is_file():
        return
    with path.open("rb") as file:
        start = 0
        for number, line in enumerate(file, 1):
            if not line.endswith(b"\n"):  # text after the last line feed is an unfinished line
                break
            try:
                row = parse(parse_json(line), start, len(line))
            except (ValueError, InputError) as error:
                if b"\n" not in file.read():  # the last line
                    break
                raise InputError(f"{path}: line {number} is broken ({error})") from None
            yield row
            start += len(line)


def append_line(path: Path, row: Mapping[str, Any]) -> tuple[int, int]:
    """Append one JSON object as a line: on disk when this returns, and not at all if it fails.

    Returns:
        Offset and size of the line [bytes].

    Raises:
        SetupError: writing failed; the file is unchanged.
    """
    data = dump(row).encode()
    size = len(data)
    with disk_errors(path.name), path.open("ab", buffering=0) as file:
        before = file.seek(0, os.SEEK_END)
        try:
            while data:
                data = data[file.write(data) or 0 :]
            os.fsync(file.fileno())
        except OSError:
            file.truncate(before)
            raise
    return before, size


def dump(value: Json, *, indent: int | None = None) -> str:
    """Return strict JSON text in ASCII, ending with a line feed."""
    return json.dumps(value, allow_nan=False, indent=indent) + "\n"


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
