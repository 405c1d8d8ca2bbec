"""JSON, lines of JSON that survive a torn end, and arrays, in files that are there whole or not at all."""

import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from kinebench_drake.errors import UsageError, cause
from kinebench_drake.storage import storage, whole


def make_folder(out: Path) -> None:
    """Make the folder that a user wants things written to.

    Raises:
        UsageError: it cannot be made.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"--out {out}: cannot be made a folder ({cause(error)}); name another one") from None


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write one JSON object, indented."""
    with whole(path) as part:
        part.write_text(json.dumps(value, indent=1, allow_nan=False) + "\n")


def write_lines(path: Path, rows: Iterator[Mapping[str, Any]] | list[dict[str, Any]]) -> None:
    """Write one JSON object a line."""
    with whole(path) as part:
        part.write_text("".join(json.dumps(row, allow_nan=False) + "\n" for row in rows))


def read_lines(path: Path) -> list[dict[str, Any]]:
    """The JSON objects of a file's lines; a torn last line is passed over, as is a file that is not there."""
    rows = []
    for line in path.read_text().split("\n")[:-1] if path.is_file() else []:
        try:
            rows.append(json.loads(line))
        except ValueError:
            break
    return rows


def append_line(path: Path, row: Mapping[str, Any]) -> None:
    """Append one JSON object as a line and see it to the disk.

    Raises:
        SetupError: writing failed.
    """
    with storage(path.name), path.open("ab") as file:
        file.write((json.dumps(row, allow_nan=False) + "\n").encode())
        file.flush()
        os.fsync(file.fileno())


def write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write an npz, the same bytes for the same arrays."""
    with whole(path) as part, part.open("wb") as file:
        np.savez_compressed(file, **arrays)
