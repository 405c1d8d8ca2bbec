"""Interrupts: the first lets running samples finish, the second stops."""

import signal
import time

import pytest

from kinebench_drake.executors.base import ItemResult
from kinebench_drake.executors.interrupt import graceful_interrupt
from kinebench_drake.executors.local import LocalExecutor


def make_slow():
    def work(item):
        if item == 0:
            signal.raise_signal(signal.SIGINT)
            time.sleep(0.05)
        return item

    return work


def test_the_first_interrupt_finishes_running_items_and_the_second_stops():
    engine = LocalExecutor(jobs=1)
    told = []
    before = signal.getsignal(signal.SIGINT)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with graceful_interrupt(engine.drain, told.append) as asked:
            found = [outcome.result for outcome in engine.run(make_slow, [0, 1, 2]) if isinstance(outcome, ItemResult)]
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGINT)  # a third one is ignored
        assert asked.is_set()
        assert found == [0]
        give_up = time.monotonic() + 10
        while not told and time.monotonic() < give_up:
            time.sleep(0.01)
        assert "press Ctrl-C again to stop at once" in told[0]
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_signal_handler_of_the_calling_program_is_kept():
    mine = lambda *_: None  # noqa: E731
    before = signal.signal(signal.SIGINT, mine)
    try:
        with graceful_interrupt(lambda: None, print):
            assert signal.getsignal(signal.SIGINT) is mine
    finally:
        signal.signal(signal.SIGINT, before)
