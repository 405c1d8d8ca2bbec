"""Progress reports of long-running work, independent of how they are displayed."""

from typing import Protocol


class Observer(Protocol):
    """Receiver of progress reports and warnings."""

    def warn(self, message: str) -> None:
        """Report a condition the user should know about; the work continues."""
        return None

    def start(self, total: int, completed: int) -> None:
        """Report the number of items, and how many of them an earlier run completed."""
        return None

    def advance(self, line: str, *, ok: bool = True) -> None:
        """Report one processed item, described by `line`; `ok`: whether it counts as completed."""
        return None
