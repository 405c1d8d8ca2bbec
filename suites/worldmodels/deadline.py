"""The time that one video may take, everything included."""

import time
from collections.abc import Callable
from typing import TypeVar

from kinebench_drake.suites.worldmodels.worldmodel import WorldModelError

_Found = TypeVar("_Found")


class Deadline:
    """A moment after which nobody waits any more."""

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._end = time.monotonic() + limit_s

    def left(self) -> float:
        """Seconds that are left.

        Raises:
            WorldModelError: none is.
        """
        left = self._end - time.monotonic()
        if left <= 0:
            raise self.passed()
        return left

    def passed(self) -> WorldModelError:
        """The error that says so."""
        return WorldModelError(f"no video within {self._limit_s:g} s; the option timeout= allows more")

    def wait(self, seconds: float) -> None:
        """Wait.

        Raises:
            WorldModelError: so long may not be waited.
        """
        if seconds >= self.left():
            raise self.passed()
        time.sleep(seconds)

    def poll(self, ask: Callable[[], _Found | None], every_s: float) -> _Found:
        """Ask until there is an answer.

        Args:
            ask: returns what is wanted, or None while there is none.
            every_s: pause between two questions [s].

        Raises:
            WorldModelError: there was none in time, or `ask` said that there will be none.
        """
        while (found := ask()) is None:
            self.wait(every_s)
        return found
