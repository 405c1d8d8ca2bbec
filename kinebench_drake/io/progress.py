"""Progress within one item of a run, such as a long video: a line now and then to whoever listens."""

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

T = TypeVar("T")

EVERY_S = 10.0
"""Time between two lines [s]; shorter steps are passed over in silence."""
_listener: ContextVar[Callable[[str], None]] = ContextVar("listener", default=lambda _: None)


@contextmanager
def listen(listener: Callable[[str], None]) -> Iterator[None]:
    """Return a context in which `listener` receives the lines."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


@contextmanager
def named(item: str) -> Iterator[None]:
    """Return a context in which the lines begin with the name of an item."""
    outer = _listener.get()
    with listen(lambda line: outer(f"{item}: {line}")):
        yield


def tell(line: str) -> None:
    """Pass a line on, such as one from another process."""
    _listener.get()(line)


def count_steps(steps: Iterable[T], done: str, total: int | None = None) -> Iterator[T]:
    """Yield the steps of some work, and tell how many are `done`.

    As in "1200 of 2000 frames decoded, about 8 s left", the time by the mean of the steps before.
    """
    start_s = last_s = time.monotonic()
    for number, step in enumerate(steps, 1):
        yield step
        now_s = time.monotonic()
        if now_s - last_s >= EVERY_S:
            last_s = now_s
            left_s = None if total is None else (now_s - start_s) / number * (total - number)
            tell(f"{number} {done}" if left_s is None else f"{number} of {total} {done}, about {left_s:.0f} s left")
