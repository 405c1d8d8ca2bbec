"""Signal handling: a first interrupt lets running samples finish; critical sections are not interrupted."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

_MESSAGE = "interrupted: running samples are being finished, no more are started; press Ctrl-C again to stop at once"


def ignore_interrupts() -> None:
    """Ignore Ctrl-C from now on: the program is ending anyway."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def graceful_interrupt(stop: Callable[[], None], report: Callable[[str], None]) -> Iterator[threading.Event]:
    """Call `stop` on the first interrupt (Ctrl-C) within this context; a second one raises KeyboardInterrupt.

    Nothing is changed if the program has its own handler of interrupts or this is not the main thread.

    Args:
        stop: requests an early end; called while the main thread does anything at all.

    Yields:
        An event that is set once there was an interrupt.
    """
    interrupted = threading.Event()
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or before is not signal.default_int_handler:
        yield interrupted
        return

    def stop_at_once(number: int, frame: FrameType | None) -> None:
        ignore_interrupts()  # further ones would break off the cleaning up
        raise KeyboardInterrupt

    def handle(number: int, frame: FrameType | None) -> None:
        signal.signal(signal.SIGINT, stop_at_once)
        interrupted.set()
        stop()
        # In a separate thread: the main thread may have been interrupted while writing to the terminal.
        threading.Thread(target=report, args=(_MESSAGE,), daemon=True).start()

    signal.signal(signal.SIGINT, handle)
    try:
        yield interrupted
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def defer_interrupts() -> Iterator[None]:
    """Delay the program's own handlers of SIGINT and SIGTERM until this context ends.

    Handlers run in the main thread only: in any other thread there is nothing to delay.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    pending: list[int] = []
    before = {n: handler for n in (signal.SIGINT, signal.SIGTERM) if callable(handler := signal.getsignal(n))}
    for number in before:
        signal.signal(number, lambda n, _: pending.append(n))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for late in pending:
            signal.raise_signal(late)
