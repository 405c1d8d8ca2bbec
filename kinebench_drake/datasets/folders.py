"""Input folders, kept apart from the output folders of runs."""

import os
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

from kinebench_drake.errors import UsageError
from kinebench_drake.results.store import ARTIFACTS, RESULTS, RUN, SAMPLES


def is_output(files: Collection[str]) -> bool:
    """Whether a folder that holds these files is a run's: one that has ended, was stopped or is on."""
    return SAMPLES in files and (RESULTS in files or RUN in files)


def require_apart(out: Path, *inputs: Path) -> None:
    """Check that a run into `out` leaves its own inputs alone: it removes and writes files in the folders it fills.

    Raises:
        UsageError: one of them is `out`, or is or lies in a folder that the run fills.
    """
    home = out.resolve()
    for named in inputs:
        real = named.resolve()
        if real == home:
            raise UsageError(f"--out is the input folder itself ({named}); name another folder")
        filled = next((part for part in ARTIFACTS if real.is_relative_to(home / part)), None)
        if filled is not None:
            raise UsageError(f"--out {out}: {named} is read, but the run fills {out / filled}; name another folder")


def walk(top: Path, skipped: Sequence[Path] = ()) -> Iterator[tuple[Path, list[str], list[str]]]:
    """Every folder from `top` down once, in a fixed order, links followed.

    Hidden entries, `skipped` folders and the output folders of runs are passed over, but `top` never is.

    Yields:
        A folder, the names of the folders in it, which may be cleared to go no deeper, and those of its files.

    Raises:
        UsageError: a folder cannot be read; what it holds would be absent from the results without a word.
    """
    passed = {p.resolve() for p in skipped} - {top.resolve()}
    seen: set[Path] = set()
    for root, folders, files in os.walk(top, onerror=_refuse, followlinks=True):
        here = Path(root)
        real = here.resolve()
        if real in seen or real in passed or (here != top and is_output(files)):
            folders.clear()
            continue
        seen.add(real)
        folders[:] = sorted(f for f in folders if not f.startswith("."))
        yield here, folders, sorted(f for f in files if not f.startswith("."))


def _refuse(error: OSError) -> None:
    raise UsageError(f"{error.filename}: cannot be read ({error.strerror}); make it readable, or move it elsewhere")
