"""Equality of two output folders, e.g. of the same run before and after a change of the code."""

import json
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinebench_drake.errors import InputError
from kinebench_drake.io.jsonl import parse_json

IDENTITY = frozenset({"code_sha256", "content_hash", "versions", "host"})
"""JSON keys that name the code and the machine; their values are not compared."""
MESSAGES = frozenset({"reason", "null_reasons", "warnings", "robot_remarks"})
"""JSON keys whose values are text for people: both are empty, or neither is."""
UNCOMPARED = ("timings.jsonl", "run.json", "report.html", "replays/*", "*.log")
"""Files that hold wall times, or pages for people: only their presence is compared."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FolderComparison:
    """Differences between two output folders."""

    equal: tuple[str, ...]
    """Files that are equal, byte for byte or but for keys of `IDENTITY` and `MESSAGES`."""
    uncompared: tuple[str, ...]
    """Files of `UNCOMPARED` that both folders have."""
    differences: tuple[str, ...]
    """One line for each difference, beginning with the file."""


def compare_folders(before: Path, after: Path) -> FolderComparison:
    """Compare two output folders file by file.

    Raises:
        InputError: `before` holds no file.
    """
    files = {
        path.relative_to(root).as_posix() for root in (before, after) for path in root.rglob("*") if path.is_file()
    }
    if not any(path.is_file() for path in before.rglob("*")):
        raise InputError(f"{before}: holds no file, expected an output folder")
    equal = []
    uncompared = []
    differences = []
    for name in sorted(files):
        missing = [root for root in (before, after) if not (root / name).is_file()]
        if missing:
            differences.append(f"{name}: missing in {missing[0]}")
        elif any(Path(name).match(pattern) for pattern in UNCOMPARED):
            uncompared.append(name)
        elif lines := list(compare_files(before / name, after / name)):
            differences.extend(f"{name}: {line}" for line in lines)
        else:
            equal.append(name)
    return FolderComparison(equal=tuple(equal), uncompared=tuple(uncompared), differences=tuple(differences))


def compare_files(before: Path, after: Path) -> Iterator[str]:
    """Yield the differences between two files; JSON and npz files are compared value by value where bytes differ."""
    data = before.read_bytes()
    other = after.read_bytes()
    if data == other:
        return
    match before.suffix:
        case ".json":
            yield from compare_values(parse_json(data), parse_json(other))
        case ".jsonl":
            yield from _compare_lines(data, other)
        case ".npz":
            yield from _compare_arrays(before, after)
        case _:
            yield f"bytes differ ({len(data)} and {len(other)} bytes)"


def _compare_lines(data: bytes, other: bytes) -> Iterator[str]:
    rows = data.splitlines()
    other_rows = other.splitlines()
    if len(rows) != len(other_rows):
        yield f"{len(rows)} and {len(other_rows)} lines"
        return
    for number, (row, other_row) in enumerate(zip(rows, other_rows, strict=True), 1):
        if row != other_row:
            yield from (f"line {number}: {line}" for line in compare_values(parse_json(row), parse_json(other_row)))


def _compare_arrays(before: Path, after: Path) -> Iterator[str]:
    try:
        with np.load(before) as arrays, np.load(after) as other:
            names = list(arrays), list(other)
            if names[0] != names[1]:
                yield f"arrays {' '.join(names[0])} and {' '.join(names[1])}"
                return
            differing = [name for name in names[0] if _array_bytes(arrays[name]) != _array_bytes(other[name])]
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        yield f"bytes differ, and not an npz file ({error})"
        return
    yield f"arrays differ: {' '.join(differing)}" if differing else "bytes differ, arrays do not"


def _array_bytes(array: np.ndarray) -> tuple[str, tuple[int, ...], bytes]:
    return array.dtype.str, array.shape, array.tobytes()


def compare_values(value: object, other: object, path: str = "") -> Iterator[str]:
    """Yield the differences between two JSON values; numbers are equal only where their text is.

    Args:
        value: the first.
        other: the second.
        path: the keys that lead to them.
    """
    if isinstance(value, dict) and isinstance(other, dict):
        if list(value) != list(other):
            changed = sorted(set(value) ^ set(other))
            yield f"{path or 'object'}: keys {' '.join(changed) if changed else 'in another order'}"
        for key in [key for key in value if key in other and key not in IDENTITY]:
            if key in MESSAGES:
                yield from _compare_messages(value[key], other[key], f"{path}.{key}".lstrip("."))
            else:
                yield from compare_values(value[key], other[key], f"{path}.{key}".lstrip("."))
    elif isinstance(value, list) and isinstance(other, list) and len(value) == len(other):
        for index, (one, another) in enumerate(zip(value, other, strict=True)):
            yield from compare_values(one, another, f"{path}[{index}]")
    elif json.dumps(value) != json.dumps(other):
        yield f"{path}: {_short(value)} and {_short(other)}"


def _compare_messages(value: object, other: object, path: str) -> Iterator[str]:
    """Yield a difference where one value is a message and the other none; an object is compared key by key."""
    if isinstance(value, dict) and isinstance(other, dict) and list(value) == list(other):
        for key in value:
            yield from _compare_messages(value[key], other[key], f"{path}.{key}")
    elif isinstance(value, dict) or isinstance(other, dict) or bool(value) is not bool(other):
        yield f"{path}: {_short(value)} and {_short(other)}"


def _short(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
