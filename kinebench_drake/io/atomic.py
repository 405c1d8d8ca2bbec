"""Atomic writes of files and folders, output folders, and disk errors as one-line messages."""

import errno
import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from kinebench_drake.errors import SetupError, UsageError, cause


@contextmanager
def disk_errors(name: str) -> Iterator[None]:
    """Turn an OSError into a one-line message that names the fix.

    Raises:
        SetupError: writing failed (disk full, no permission, ...).
    """
    try:
        yield
    except OSError as error:
        fix = "free some space" if error.errno in (errno.ENOSPC, errno.EDQUOT) else "make the folder writable"
        raise SetupError(
            f"cannot write {name} ({error.strerror or error}): {fix} and run the same command again, "
            "finished files are kept (unless by $overwrite=True)"
        ) from None


def unfinished(path: Path) -> Path:
    """Return the path to which this process writes a file until it is complete; leftovers have such names."""
    return path.with_name(f".{os.getpid()}.part.{path.name}")


def remove(path: Path) -> None:
    """Remove a file, or a folder with its content, if it exists; of a link only the link."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def make_folder(out: Path) -> None:
    """Create an output folder.

    Raises:
        UsageError: it cannot be created.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"$out {out}: cannot be made a folder ({cause(error)}); name another one") from None


def lock_folder(out: Path) -> int:
    """Create an output folder and lock it for this process; return the descriptor that holds the lock until closed.

    Raises:
        UsageError: it cannot be created or opened, or another process holds the lock.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        lock = os.open(out, os.O_RDONLY)
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(lock)
        raise UsageError(f"$out {out}: another run writes to it; wait for it, or give each its own folder") from None
    except OSError as error:
        raise UsageError(f"$out {out}: cannot be written ({error.strerror or error})") from None
    return lock


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a path beside `path` to write to; it replaces `path` when the context ends without an error."""
    part = unfinished(path)
    try:
        with disk_errors(path.name):
            path.parent.mkdir(parents=True, exist_ok=True)
            yield part
            with part.open("rb") as file:
                os.fsync(file.fileno())
            os.replace(part, path)
    finally:
        with suppress(OSError):  # the parent may be no folder, which the error being raised reports
            part.unlink()


@contextmanager
def atomic_folder(folder: Path) -> Iterator[Path]:
    """Yield a folder to fill, which becomes `folder` when the context ends without an error.

    Several processes may write the same content at once.

    Raises:
        OSError: writing failed.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    work = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        yield work
        try:
            os.replace(work, folder)
        except OSError:
            if not folder.is_dir():  # else another process was first
                raise
    finally:
        shutil.rmtree(work, ignore_errors=True)


def write_atomically(path: Path, data: bytes) -> None:
    """Write a file completely or not at all, even if the program is killed."""
    with atomic_path(path) as part:
        part.write_bytes(data)
