"""Execution on this machine: in this process, or in several worker processes.

Every worker computes with one thread, even if there is only one worker: floating point sums then have one order, so
the number of jobs does not change a byte of the results.
"""

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from types import FrameType
from typing import Generic, cast

from threadpoolctl import threadpool_limits

from kinebench_drake.errors import KinebenchError
from kinebench_drake.executors.base import (
    Item,
    ItemProgress,
    ItemResult,
    MakeWorker,
    Outcomes,
    Result,
    WorkerCrash,
    open_worker,
)
from kinebench_drake.io.progress import listen, tell

THREAD_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "LP_NUM_THREADS")
"""Environment variables that set the number of threads of numeric libraries, and of the renderer on the CPU."""
GRACE_S = 10.0
"""Time that terminated workers have to end their own child processes, such as a world model's program [s]."""
_TERMINATED = 128 + signal.SIGTERM
"""Exit status, by shell convention, of a worker that was terminated and has cleaned up."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalExecutor:
    """`Executor` on this machine."""

    jobs: int
    """Number of worker processes; with 1, items are processed in the calling process."""
    _draining: threading.Event = field(default_factory=threading.Event, init=False, repr=False, compare=False)

    def drain(self) -> None:
        """Start no further items and let running ones finish."""
        self._draining.set()

    def run(self, make_worker: MakeWorker[Item, Result], items: Sequence[Item]) -> Outcomes[Item, Result]:
        """Yield the outcome of each item as soon as it is available, in any order."""
        if not items:
            return
        if self.jobs == 1:
            with one_thread(), open_worker(make_worker) as work:
                for item in items:
                    if self._draining.is_set():
                        return
                    yield ItemResult(item=item, result=work(item))
        else:
            yield from _ProcessPool(make_worker, items, min(self.jobs, len(items)), self._draining).outcomes()


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit numeric libraries to one thread: by environment those not loaded yet, by call BLAS and torch."""
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    torch = sys.modules.get("torch")
    threads = torch.get_num_threads() if torch else 0
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    if torch:
        torch.set_num_threads(1)
    try:
        with threadpool_limits(1, user_api="blas"):
            yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
        if torch:
            torch.set_num_threads(threads)


@dataclass(slots=True)
class _WorkerProcess(Generic[Item]):
    """One worker process and the item that it is processing."""

    process: BaseProcess
    pipe: Connection
    item: Item | None = None


class _ProcessPool(Generic[Item, Result]):
    """Processes that receive one item at a time over a pipe each: when one dies, only its item is lost."""

    def __init__(
        self, make_worker: MakeWorker[Item, Result], items: Sequence[Item], size: int, draining: threading.Event
    ) -> None:
        self._draining = draining
        self._make_worker = make_worker
        self._queue = deque(items)
        self._size = size
        self._workers: list[_WorkerProcess[Item]] = []

    def outcomes(self) -> Outcomes[Item, Result]:
        try:
            while self._has_more() or self._workers:
                while self._has_more() and len(self._workers) < self._size:
                    self._start()
                ready = wait([worker.pipe for worker in self._workers]) if self._workers else []
                for worker in [worker for worker in self._workers if worker.pipe in ready]:
                    outcome = self._receive(worker)
                    if outcome is not None:
                        yield outcome
        finally:
            for worker in self._workers:
                worker.process.terminate()
            deadline = time.monotonic() + GRACE_S
            for worker in self._workers:
                worker.process.join(max(0.0, deadline - time.monotonic()))
                worker.process.kill()
                worker.process.join()
                worker.pipe.close()

    def _has_more(self) -> bool:
        """Return whether there is an item to start."""
        return bool(self._queue) and not self._draining.is_set()

    def _start(self) -> None:
        """Start a worker and send it an item, unless an interrupt has come meanwhile."""
        context = multiprocessing.get_context("spawn")
        own_end, worker_end = context.Pipe()
        process = context.Process(target=_serve, args=(worker_end, self._make_worker), daemon=True)
        worker: _WorkerProcess[Item] = _WorkerProcess(process=process, pipe=own_end)
        resource_tracker.ensure_running()  # unblocks signals, so it must come before they are blocked
        # The child inherits the environment and the blocked signals: no interrupt reaches it before it ignores them.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            with one_thread():
                process.start()
            self._workers.append(worker)  # registered before signals are unblocked, so that it is always terminated
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        worker_end.close()
        self._feed(worker)

    def _feed(self, worker: _WorkerProcess[Item]) -> None:
        """Send the next item to a worker, or end the worker if there is none."""
        worker.item = self._queue.popleft() if self._has_more() else None
        with suppress(BrokenPipeError, ConnectionResetError):  # it died, which the next receive reports
            worker.pipe.send(worker.item)
        if worker.item is None:
            self._dismiss(worker)

    def _dismiss(self, worker: _WorkerProcess[Item]) -> None:
        self._workers.remove(worker)
        worker.process.join()
        worker.pipe.close()

    def _receive(self, worker: _WorkerProcess[Item]) -> ItemResult[Item, Result] | WorkerCrash[Item] | None:
        item = cast(Item, worker.item)
        try:
            message = worker.pipe.recv()
        except (EOFError, OSError):  # OSError: it died while sending
            self._dismiss(worker)
            return WorkerCrash(item=item, reason=_describe_exit(worker.process.exitcode))
        if isinstance(message, KinebenchError):
            raise message
        if isinstance(message, ItemProgress):
            tell(message.line)
            return None
        self._feed(worker)
        return ItemResult(item=item, result=message)


def _describe_exit(code: int | None) -> str:
    """Describe why a worker process ended, from its exit status."""
    code = -signal.SIGTERM if code == _TERMINATED else code
    if code is not None and code < 0:
        name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
        hint = " (often the system is out of memory: use fewer jobs)" if -code == signal.SIGKILL else ""
        return f"the worker process was ended by {name}{hint}"
    return f"the worker process ended with status {code}"


def _terminate(number: int, frame: FrameType | None) -> None:
    """Unwind a terminated worker, so that it ends its own child processes."""
    raise SystemExit(_TERMINATED)


def _serve(pipe: Connection, make_worker: MakeWorker[Item, Result]) -> None:
    """Run a worker process: receive items and send results, until None arrives or the parent is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles interrupts
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    signal.signal(signal.SIGTERM, _terminate)
    try:
        with open_worker(make_worker) as work, listen(lambda line: pipe.send(ItemProgress(line))):
            while (item := pipe.recv()) is not None:
                pipe.send(work(item))
    except KinebenchError as error:
        pipe.send(error)
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return
