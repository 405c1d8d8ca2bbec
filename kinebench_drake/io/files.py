"""Files named by the user: regular files only, read whole within a size limit; suffixes of videos; cache folder."""

import errno
import os
import re
import stat
from contextlib import suppress
from io import BufferedReader
from pathlib import Path

from kinebench_drake.errors import InputError, cause

MOST_BYTES = 2**26
"""Largest text file that is read [bytes]."""
VIDEO_SUFFIXES = frozenset({".mp4", ".mov", ".avi", ".gif", ".webm", ".mkv"})
"""Video containers."""
IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg"})
"""Images of a frame folder."""


class Budget:
    """Bytes that one input may still take while it is received, read or decoded."""

    def __init__(self, most: int, exceeded: InputError) -> None:
        """Allow `most` bytes; `exceeded` is raised beyond them."""
        self._left = most
        self.exceeded = exceeded

    def require(self, size: int) -> None:
        """Raise `exceeded` unless `size` more bytes are left."""
        if size > self._left:
            raise self.exceeded

    def take(self, size: int) -> None:
        """Take `size` bytes, like `require`."""
        self.require(size)
        self._left -= size


def cache_folder() -> Path:
    """Return the folder of converted models: $XDG_CACHE_HOME/kinebench_drake, else ~/.cache/kinebench_drake."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "kinebench_drake"


def require_accessible(path: Path, what: str) -> Path:
    """Return `path`, called `what` in messages, if the file system can answer whether it exists.

    Raises:
        InputError: the name is too long or not text, a folder above it is locked, or links form a circle.
    """
    try:
        with suppress(FileNotFoundError, NotADirectoryError):
            os.stat(path)
    except (OSError, ValueError) as error:
        raise InputError(f"{what} cannot be followed ({cause(error)})") from None
    return path


def absence(path: Path) -> str:
    """Return why a path that the user named does not exist, for a message after its name."""
    if re.match(r"\w+:/", str(path)):  # a Path keeps one slash of the two
        return "URLs are not read: download it first"
    if path.is_symlink() and not path.exists():
        return f"is a symlink to {os.readlink(path)}, which does not exist"
    return "is not a regular file" if path.exists() else "there is no such file or folder"


def open_file(path: Path) -> BufferedReader:
    """Open a regular file for reading.

    Raises:
        OSError: it does not exist, is no regular file or cannot be read.
    """
    if not stat.S_ISREG(os.stat(path).st_mode):
        raise OSError(errno.EINVAL, "Not a regular file", str(path))
    return path.open("rb")


def read_bytes(path: Path, most: int = MOST_BYTES) -> bytes:
    """Return the content of a regular file.

    Raises:
        OSError: it does not exist, cannot be read, or holds more than `most` bytes.
    """
    with open_file(path) as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, f"Larger than {most / 2**20:g} MiB", str(path))
    return data


def read_text(path: Path, encoding: str = "utf-8-sig") -> str:
    """Return the content of a regular file as text."""
    return read_bytes(path).decode(encoding)
