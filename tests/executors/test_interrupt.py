"""Interrupts: the first lets running samples finish, the second stops."""

import queue
import signal

import pytest

from kinebench_drake.executors.base import ItemResult
from kinebench_drake.executors.interrupt import graceful_interrupt
from kinebench_drake.executors.local import LocalExecutor


def make_interrupted():
    def work(item):
        signal.raise_signal(signal.SIGINT)
        return item

    return work


def test_the_first_interrupt_finishes_running_items_and_the_second_stops():
    engine = LocalExecutor(jobs=1)
    reports = queue.Queue()
    before = signal.getsignal(signal.SIGINT)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with graceful_interrupt(engine.drain, reports.put) as interrupted:
            outcomes = list(engine.run(make_interrupted, [0, 1, 2]))
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGINT)  # a third one is ignored
        assert interrupted.is_set()
        assert outcomes == [ItemResult(item=0, result=0)]
        assert "press Ctrl-C again to stop at once" in reports.get(timeout=10)
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
