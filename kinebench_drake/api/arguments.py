"""What callers hand over from Python, turned into what the library takes; and how it warns them."""

import warnings
from enum import Enum
from os import PathLike
from pathlib import Path
from typing import TypeAlias, TypeVar

from kinebench_drake.errors import UsageError
from kinebench_drake.evaluation.runner import NullRunObserver

PathName: TypeAlias = str | PathLike[str]
Member = TypeVar("Member", bound=Enum)


def path_of(name: PathName | None) -> Path | None:
    """The path of a name; None where none is given."""
    return None if name is None else Path(name)


def member_of(kind: type[Member], value: Member | str, option: str) -> Member:
    """The member of an enumeration that a value stands for.

    Raises:
        UsageError: there is none; the message lists those there are.
    """
    try:
        return kind(value)
    except ValueError:
        raise UsageError(f"{option} is {value!r}, expected {', '.join(repr(m.value) for m in kind)}") from None


def refuse_with(what: str, **arguments: object) -> None:
    """Hold that arguments that do not go with a kind of input are not given.

    Raises:
        UsageError: one is.
    """
    given = [name for name, value in arguments.items() if value is not None]
    if given:
        raise UsageError(f"{', '.join(given)}: of no use with {what}, leave it out")


def warn(*messages: str) -> None:
    """Warn whoever called the function of the interface that calls this."""
    for message in messages:
        warnings.warn(message, stacklevel=3)


class Warner(NullRunObserver):
    """An `RunObserver` that turns what the user should know into Python warnings."""

    def warn(self, message: str) -> None:
        """Warn, as of whoever called the function of the interface."""
        warnings.warn(message, stacklevel=4)
