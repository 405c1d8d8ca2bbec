"""Input folders: walking them, paths named in them, and their separation from output folders."""

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePosixPath

from kinebench_drake.errors import InputError, UsageError, count_noun
from kinebench_drake.io.files import absence, require_accessible
from kinebench_drake.results.store import ARTIFACTS, REQUESTS, RESULTS, RUN, SAMPLES


def is_output(folder: Path) -> bool:
    """Return whether a folder is the output folder of a run, finished or not."""
    return (folder / SAMPLES).exists() and any((folder / name).exists() for name in (RESULTS, RUN))


def run_of(path: Path) -> Path | None:
    """Return the output folder of the run that wrote `path`, a folder of its artifacts or a file in one; else None."""
    real = path.resolve()
    written = (folder for folder in (real, real.parent) if folder.name in ARTIFACTS and is_output(folder.parent))
    return next((folder.parent for folder in written), None)


def require_present(source: Path) -> None:
    """Check that an input exists.

    Raises:
        UsageError: there is no such file or folder.
    """
    if not source.exists():
        raise UsageError(f"{source}: {absence(source)}")


def require_apart(out: Path, *inputs: Path) -> None:
    """Check that a run into `out` does not touch its inputs: it removes and writes files in the folders that it fills.

    Raises:
        UsageError: an input is `out`, is a file in it, or is or lies in a folder that the run fills.
    """
    home = out.resolve()
    for path in inputs:
        real = path.resolve()
        if real == home:
            raise UsageError(f"$out is the input folder itself ({path}); name another folder")
        if real.parent == home and real.is_file():
            raise UsageError(f"$out is the folder of {path}, whose input would lie among results; name another folder")
        folder = next((kind for kind in ARTIFACTS if real.is_relative_to(home / kind)), None)
        if folder is not None:
            raise UsageError(f"$out {out}: {path} is read, but the run fills {out / folder}; name another folder")


def walk(top: Path, skipped: Sequence[Path] = ()) -> Iterator[tuple[Path, list[str], list[str]]]:
    """Yield every folder from `top` down once, in a fixed order, following links.

    Hidden entries, `skipped` folders and output folders of runs are ignored. If `top` is an output folder itself, the
    folders that the run filled are.

    Yields:
        A folder, the names of its subfolders, which may be cleared to go no deeper, and the names of its files.
    """
    ignored = {p.resolve() for p in skipped} - {top.resolve()}
    visited: set[Path] = set()
    for root, folders, files in os.walk(top, onerror=_raise_unreadable, followlinks=True):
        here = Path(root)
        real = here.resolve()
        output = is_output(here)
        if real in visited or real in ignored or (here != top and output):
            folders.clear()
            continue
        visited.add(real)
        filled = (*ARTIFACTS, REQUESTS) if output else ()
        folders[:] = sorted(f for f in folders if not f.startswith(".") and f not in filled)
        yield here, folders, sorted(f for f in files if not f.startswith("."))


def _raise_unreadable(error: OSError) -> None:
    raise UsageError(f"{error.filename}: cannot be read ({error.strerror}); make it readable, or move it elsewhere")


def list_suffixes(folder: Path) -> str:
    """Return the most frequent suffixes of the files in a folder as text for a message."""
    return count_suffixes([p for p in folder.iterdir() if p.is_file()])


def count_suffixes(files: Sequence[Path]) -> str:
    """Return the most frequent suffixes of some files as text for a message."""
    counts = Counter(p.suffix.lower() or "no suffix" for p in files)
    return ", ".join(f"{n} x {suffix}" for suffix, n in counts.most_common(4)) or "nothing"


def describe_ignored(files: Sequence[Path]) -> list[str]:
    """Return a warning about files of a folder that are no input; none if there are none."""
    noun = count_noun(len(files), "file")
    return [f"{noun} ignored: {count_suffixes(files)}, such as {files[0].name}"] if files else []


def join_relative(folder: Path, relative: str, what: str, *, links_out: bool = True) -> Path:
    """Return the path of `relative`, which a file in `folder` names.

    Args:
        folder: folder that the path must not leave.
        links_out: accept links that lead out of the folder; the cache of the Hugging Face Hub consists of them.

    Raises:
        InputError: it is absolute, climbs out by `..`, cannot be accessed, or is a link out that is not accepted.
    """
    pure = PurePosixPath(relative)
    if pure.is_absolute() or ".." in pure.parts or "\0" in relative:
        raise InputError(f"{what} {relative!r} must be a relative path inside the folder of its file")
    path = require_accessible(folder / pure, f"{what} {relative!r}")
    if not links_out and not path.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"{what} {relative!r} is a link that leads out of the folder of its file")
    return path
