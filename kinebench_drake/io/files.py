"""Files named by the user: regular files only, read whole within a size limit, and the suffixes of videos."""

import errno
import json
import os
import stat
from contextlib import suppress
from io import BufferedReader
from pathlib import Path

from kinebench_drake.errors import InputError, cause

MOST_BYTES = 2**28
"""Largest text that is read."""
_DIGITS = 20


def reach(path: Path, what: str) -> Path:
    """`path`, which need not be there, once it is known that the disk can be asked about it.

    Args:
        path: where some file of the user says that another one is.
        what: how to name it in a message.

    Raises:
        InputError: its name is too long or no text, a folder above it is locked, or links go round in a circle.
    """
    try:
        with suppress(FileNotFoundError, NotADirectoryError):
            os.stat(path)
    except (OSError, ValueError) as error:
        raise InputError(f"{what} cannot be followed ({cause(error)})") from None
    return path


def open_file(path: Path) -> BufferedReader:
    """A regular file, open.

    Raises:
        OSError: there is none, or it cannot be read.
    """
    if not stat.S_ISREG(os.stat(path).st_mode):
        raise OSError(errno.EINVAL, "Not a regular file", str(path))
    return path.open("rb")


def read_bytes(path: Path, most: int = MOST_BYTES) -> bytes:
    """All of a regular file.

    Raises:
        OSError: there is none, it cannot be read, or holds more than `most` bytes.
    """
    with open_file(path) as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, f"Larger than {most / 2**20:g} MiB", str(path))
    return data


def read_text(path: Path, encoding: str = "utf-8-sig") -> str:
    """All of a regular file as text.

    Raises:
        OSError: as `read_bytes`.
        ValueError: it is no text in this encoding.
    """
    return read_bytes(path).decode(encoding)


def read_json(path: Path) -> object:
    """What a JSON file holds.

    Raises:
        OSError: as `read_bytes`.
        ValueError: it is not JSON.
    """
    return parse_json(read_bytes(path))


def _number(text: str) -> int | float:
    """A whole number; one that fits into no machine's word comes as a float, as arithmetic would have it."""
    if len(text) > _DIGITS:
        return float(text)
    value = int(text)
    return value if abs(value) < 2**63 else float(value)


def parse_json(text: str | bytes) -> object:
    """What a JSON text says.

    Raises:
        ValueError: it is not JSON, or nested more deeply than anything sensible.
    """
    try:
        value: object = json.loads(text, parse_int=_number)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    return value


FILM_SUFFIXES = frozenset({".mp4", ".mov", ".avi", ".gif", ".webm", ".mkv"})
"""Films."""
FRAME_SUFFIXES = frozenset({".png", ".jpg", ".jpeg"})
"""Pictures that make a folder of frames."""
