"""Arguments of the Python interface, and warnings to its callers."""

import warnings
from os import PathLike
from pathlib import Path
from typing import TypeAlias

from kinebench_drake.errors import UsageError
from kinebench_drake.evaluation.runner import NullRunObserver

PathName: TypeAlias = str | PathLike[str]


def path_of(name: PathName | None) -> Path | None:
    """Return the path of a name, or None."""
    return None if name is None else Path(name)


def refuse_with(what: str, **arguments: object) -> None:
    """Check that arguments which do not apply to a kind of input are absent.

    Raises:
        UsageError: one is present.
    """
    present = [name for name, value in arguments.items() if value is not None]
    if present:
        raise UsageError(f"{', '.join(present)}: has no effect with {what}, leave it out")


def warn(*messages: str) -> None:
    """Warn the caller of the interface function that calls this."""
    for message in messages:
        warnings.warn(message, stacklevel=3)


class Warner(NullRunObserver):
    """An observer that turns warnings into Python warnings."""

    def warn(self, message: str) -> None:
        """Warn the caller of the interface function."""
        warnings.warn(message, stacklevel=4)
