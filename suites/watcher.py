"""Who is told how work on many episodes goes on."""

from typing import Protocol


class Watcher(Protocol):
    """Is told how the work goes on."""

    def started(self, total: int, kept: int) -> None:
        """So many things there are to do, of which so many are done already."""

    def advanced(self, line: str, *, good: bool = True) -> None:
        """One more is done."""
