"""The one family of errors this package raises on purpose.

Every message is one line and names what was found, what was expected and what to do about it.
"""

from enum import Enum
from typing import TypeVar

Member = TypeVar("Member", bound=Enum)

_MOST_SIGNS = 1000


def one_line(text: str) -> str:
    """Text as one line that a terminal can be shown: no control signs, which names in files may hold, not too long."""
    line = " ".join(text.split())
    if not line.isprintable():
        line = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)
    return line if len(line) <= _MOST_SIGNS else f"{line[: _MOST_SIGNS - 4]} ..."


class KinebenchError(Exception):
    """Base of all expected failures; its text is fit to show to a user as it is."""

    def __init__(self, message: str = "") -> None:
        super().__init__(one_line(message))


class UsageError(KinebenchError):
    """The command line or a function's arguments cannot be used (exit status 2)."""


class InputError(KinebenchError):
    """One sample's input is broken: a row with status `error`."""


class UnmeasurableError(KinebenchError):
    """One sample's input is sound but cannot be measured: a row with status `unmeasurable`."""


class SetupError(KinebenchError):
    """Something is missing on this machine (driver, library, weights, disk space)."""


def cause(error: Exception) -> str:
    """What went wrong in one line, without the paths of this machine that an OSError names."""
    if isinstance(error, OSError):
        return error.strerror or "of an unknown kind, or damaged"
    return str(error).split("\n")[0]


def member_of(kind: type[Member], value: Member | str, option: str) -> Member:
    """Return the member of an enumeration for an option's value.

    Raises:
        UsageError: the value is invalid; the message lists the valid ones.
    """
    try:
        return kind(value)
    except ValueError:
        raise UsageError(f"{option} is {value!r}, expected {', '.join(repr(m.value) for m in kind)}") from None
