"""A part of a list of samples, for several machines that share a job."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from kinebench_drake.errors import UsageError

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True, kw_only=True)
class Shard:
    """One of `count` equal parts of a list: part k has items k, k + count, k + 2 count, ..., counted from 1."""

    index: int
    """Number of the part, 1..count."""
    count: int
    """Number of parts."""

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            UsageError: there is no such part.
        """
        if not 1 <= self.index <= self.count:
            raise UsageError(f"--shard is '{self}', expected I/N with I from 1 to N, such as 1/4")

    def __str__(self) -> str:
        return f"{self.index}/{self.count}"

    @classmethod
    def parse(cls, text: str) -> "Shard":
        """Read "I/N", parts counted 1 .. N.

        Raises:
            UsageError: it is not of that form.
        """
        match = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text.strip())
        if not match:
            raise UsageError(f"--shard is {text!r:.60}, expected I/N with I from 1 to N, such as 1/4")
        return cls(index=int(match[1]), count=int(match[2]))

    def take(self, items: Sequence[Item]) -> list[Item]:
        """This part of `items`."""
        return list(items[self.index - 1 :: self.count])
