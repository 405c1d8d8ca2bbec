"""Expected errors. Every message is one line: the value, what was expected, and the fix.

Messages and warnings mark arguments, as in "$table_height_m is 7": the command line words them by `name_options`, the
Python interface by `name_arguments`.
"""

import re
from collections.abc import Iterable
from difflib import get_close_matches
from enum import Enum
from typing import TypeVar

Member = TypeVar("Member", bound=Enum)

_MAX_CHARACTERS = 1000
_ARGUMENT = re.compile(r"\$([a-z][a-z_]*)(=True)?")
_UNIT = re.compile(r"_(s|m|hz|px|kg)$")
_OPTIONS = {"tags": "--tag"}
"""Options that are not called after their arguments."""


def option_of(argument: str) -> str:
    """Return the option of an argument: dashes for underscores, without the unit, `--table-height`."""
    return _OPTIONS.get(argument) or f"--{_UNIT.sub('', argument).replace('_', '-')}"


def name_options(text: str) -> str:
    """Return a message with command line options in place of marked arguments."""
    return _ARGUMENT.sub(lambda match: option_of(match[1]), text)


def name_arguments(text: str) -> str:
    """Return a message with the bare names of marked arguments."""
    return _ARGUMENT.sub(lambda match: match[0][1:], text)


def printable(text: str) -> str:
    """Return text as one line that is safe on a terminal: control characters escaped, length limited."""
    line = text[: _MAX_CHARACTERS + 1]
    if not line.isprintable():
        line = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)
    return line if len(line) <= _MAX_CHARACTERS else f"{line[: _MAX_CHARACTERS - 4]} ..."


def one_line(text: str) -> str:
    """Return text as one line with single spaces, like `printable`."""
    return printable(" ".join(text.split()))


def count_noun(n: int, noun: str) -> str:
    """Return a number with its noun, in the plural (-s) unless it is one."""
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


class KinebenchError(Exception):
    """Base of all expected errors."""

    def __init__(self, message: str = "") -> None:
        super().__init__(one_line(message))


class UsageError(KinebenchError):
    """Unusable command line or arguments (exit status 2)."""


class InputError(KinebenchError):
    """Broken input of one sample: a row with status `error`."""


class UnmeasurableError(KinebenchError):
    """Valid input of one sample that cannot be measured: a row with status `unmeasurable`."""


class SetupError(KinebenchError):
    """Missing resource on this machine (driver, library, weights, disk space)."""


def cause(error: Exception) -> str:
    """Return the cause of an error in one line, without the paths that an OSError contains, and memory addresses."""
    if isinstance(error, OSError):
        return error.strerror or "of an unknown kind, or damaged"
    return re.sub(" at 0x[0-9a-f]+", "", str(error).split("\n")[0])


def suggestion(word: str, choices: Iterable[str]) -> str:
    """Return " (did you mean X?)" with the choice that is most like an unknown word; empty if none is."""
    near = get_close_matches(word, list(choices), n=1)
    return f" (did you mean {near[0]}?)" if near else ""


def member_of(kind: type[Member], value: Member | str, argument: str) -> Member:
    """Return the member of an enumeration for an argument's value.

    Raises:
        UsageError: the value is invalid; the message lists the valid ones.
    """
    try:
        return kind(value)
    except ValueError:
        raise UsageError(f"${argument} is {value!r}, expected {', '.join(repr(m.value) for m in kind)}") from None
