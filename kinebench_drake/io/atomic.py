"""Atomic file writes, and disk errors as one-line messages."""

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from kinebench_drake.errors import SetupError


@contextmanager
def disk_errors(name: str) -> Iterator[None]:
    """Turn a failing disk into one line that says what to do.

    Raises:
        SetupError: writing failed (disk full, no permission, ...).
    """
    try:
        yield
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        fix = "free some space" if full else "make the folder writable"
        raise SetupError(
            f"cannot write {name} ({error.strerror or error}): {fix} and run the same command again, "
            "finished files are kept (unless by --overwrite)"
        ) from None


def unfinished(path: Path) -> Path:
    """Where this process writes a file until it is whole; by such names that is known which a killed one leaves."""
    return path.with_name(f".{os.getpid()}.part.{path.name}")


def remove(path: Path) -> None:
    """Remove a file, or a folder with all that is in it, if it is there; of a link the link.

    Raises:
        OSError: it cannot be removed.
    """
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """A path to write to beside `path`, which takes its place when the context ends without an error.

    Raises:
        SetupError: writing failed.
    """
    part = unfinished(path)
    try:
        with disk_errors(path.name):
            path.parent.mkdir(parents=True, exist_ok=True)
            yield part
            with part.open("rb") as file:
                os.fsync(file.fileno())
            os.replace(part, path)
    finally:
        with suppress(OSError):  # the parent may be no folder; the error on its way tells
            part.unlink()


def write_atomically(path: Path, data: bytes) -> None:
    """Write a file that is there whole or not at all, whatever stops the program.

    Raises:
        SetupError: writing failed.
    """
    with atomic_path(path) as part:
        part.write_bytes(data)
