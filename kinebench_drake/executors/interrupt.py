"""Signal handling: a first interrupt lets running samples finish; critical sections are not interrupted."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def graceful_interrupt(stop: Callable[[], None], tell: Callable[[str], None]) -> Iterator[threading.Event]:
    """Within this context the first interrupt (Ctrl-C) calls `stop`; a second one raises KeyboardInterrupt.

    Where the program has a handler of its own, or this is not its main thread, nothing is changed.

    Args:
        stop: makes an end of it before long; called amid whatever the main thread does.
        tell: says so to the user.

    Yields:
        Whether there was an interrupt.
    """
    asked = threading.Event()
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or before is not signal.default_int_handler:
        yield asked
        return

    def answer(number: int, frame: FrameType | None) -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        asked.set()
        stop()
        # From a thread of its own: whatever this one was doing, it may have been writing to the terminal.
        threading.Thread(target=tell, args=(_TOLD,), daemon=True).start()

    signal.signal(signal.SIGINT, answer)
    try:
        yield asked
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def without_interrupt() -> Iterator[None]:
    """Within this context the program's own handlers of an interrupt and of SIGTERM wait: they are called as it ends.

    Handlers run in the main thread only: in another there is nothing to wait for.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    before = {n: handler for n in (signal.SIGINT, signal.SIGTERM) if callable(handler := signal.getsignal(n))}
    for number in before:
        signal.signal(number, lambda n, _: came.append(n))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for late in came:
            signal.raise_signal(late)


_TOLD = "interrupted: what is at hand is being finished, no more is begun; press Ctrl-C again to stop at once"
