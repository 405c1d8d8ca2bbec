"""The self-contained html report of an output folder."""

from pathlib import Path

from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.report.page import build_page
from kinebench_drake.results.store import REPORT


def write_report(out: Path) -> Path:
    """Write `report.html` from the rows and files of an output folder; the same folder gives the same bytes.

    Raises:
        InputError: the folder's files are broken.
        SetupError: writing failed.
    """
    path = out / REPORT
    write_atomically(path, build_page(out).encode())
    return path
