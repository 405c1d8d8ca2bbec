"""Workers in processes of their own, interrupted and ended amid what they do."""

import os
import signal
import subprocess
from contextlib import closing, suppress

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from kinebench_drake.executors import local
from kinebench_drake.executors.base import ItemResult
from kinebench_drake.executors.local import LocalExecutor
from kinebench_drake.io.progress import count_steps, listen, tell


def make_doubling():
    return lambda item: 2 * item


def make_busy():
    """Work that starts a program, writes its number into the pipe that it is given, and waits; or answers, or dies."""

    def work(item):
        if item == "idle":
            return
        if item == "terminated":
            os.kill(os.getpid(), signal.SIGTERM)
        program = subprocess.Popen(["cat"], stdin=subprocess.PIPE, start_new_session=True)  # waits for input
        try:
            item.write_text(str(program.pid))
            program.wait()
        finally:
            program.kill()
            program.wait()

    return work


def make_counting():
    """Work that returns the largest number of threads of the BLAS libraries of its process."""
    np.linalg.inv(np.eye(2))
    return lambda item: blas_threads()


def blas_threads():
    return max(library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas")


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_worker_computes_with_one_thread(jobs):
    with threadpool_limits(2, user_api="blas"):
        before = blas_threads()
        outcomes = list(LocalExecutor(jobs=jobs).run(make_counting, ["a", "b"]))
        assert blas_threads() == before == 2
    assert [outcome.result for outcome in outcomes] == [1, 1]


def test_a_terminated_worker_terminates_its_child_processes(tmp_path):
    note = tmp_path / "note"
    os.mkfifo(note)
    with closing(LocalExecutor(jobs=2).run(make_busy, [note, "idle"])) as outcomes:
        next(outcomes)
        program = int(note.read_text())
    with pytest.raises(ProcessLookupError):
        os.kill(program, 0)


def test_a_worker_that_ignores_sigterm_is_killed(monkeypatch):
    monkeypatch.setattr(local, "GRACE_S", 0.5)
    with closing(LocalExecutor(jobs=2).run(make_stubborn, ["deaf", "well"])) as outcomes:
        assert next(outcomes).item == "well"


def make_stubborn():
    def work(item):
        while item == "deaf":
            with suppress(SystemExit):
                signal.pause()
        return item

    return work


def test_the_reason_of_a_worker_crash_names_the_signal():
    (outcome,) = LocalExecutor(jobs=2).run(make_busy, ["terminated"])
    assert outcome.reason == "the worker process was ended by SIGTERM"


def make_telling():
    def work(item):
        for _ in count_steps([item], "step done"):
            tell(f"half of {item}")
        return item

    return work


@pytest.mark.parametrize("jobs", [1, 2])
def test_progress_within_an_item_reaches_the_listener_and_is_no_result(jobs):
    lines = []
    with listen(lines.append):
        outcomes = list(LocalExecutor(jobs=jobs).run(make_telling, ["a", "b"]))
    assert sorted(outcome.result for outcome in outcomes) == ["a", "b"]
    assert sorted(lines) == ["half of a", "half of b"]


def test_every_item_has_a_result():
    outcomes = list(LocalExecutor(jobs=2).run(make_doubling, [1, 2, 3]))
    assert {o.item: o.result for o in outcomes if isinstance(o, ItemResult)} == {1: 2, 2: 4, 3: 6}


@pytest.mark.parametrize("started", [1, 2])
def test_an_interrupt_during_the_start_of_a_worker_leaves_it_without_an_item(monkeypatch, started):
    """It is held back till the process is there, and delivered at once then."""
    engine = LocalExecutor(jobs=2)
    unblocked = []

    def mask(how, signals, before=signal.pthread_sigmask):
        blocked = before(how, signals)
        if how == signal.SIG_SETMASK:
            unblocked.append(how)
            if len(unblocked) == started:
                engine.drain()
        return blocked

    monkeypatch.setattr(local.signal, "pthread_sigmask", mask)
    outcomes = list(engine.run(make_doubling, [1, 2, 3]))
    assert [(o.item, o.result) for o in outcomes] == [(1, 2)][: started - 1]
