"""Worker processes that take items as they come: each is answered once, also if processes die over it."""

import multiprocessing
import os
import queue
import signal
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from typing import Any, Generic, cast

from kinebench_drake.errors import KinebenchError, cause
from kinebench_drake.executors.base import Item, MakeWorker, Result
from kinebench_drake.executors.local import one_thread

ATTEMPTS = 3
"""Processes that may die over an item before it is given up."""
STARTS = 10
"""Processes that may die before they are ready: not because of the item."""


class JobQueue(Generic[Item, Result]):
    """Queue of a limited length before processes that stay. Methods may be called from any thread."""

    def __init__(
        self, make_worker: MakeWorker[Item, Result], *, workers: int, most: float = 64, timeout_s: float = 600.0
    ) -> None:
        """Start the threads, of which each starts its process with its first item.

        Args:
            make_worker: called once per process; returns the function called for each item. Must be picklable.
            workers: number of processes.
            most: greatest number of items that wait or are processed.
            timeout_s: time that a process has for an item [s].
        """
        self._make_worker = make_worker
        self._most = most
        self._timeout_s = timeout_s
        self._waiting: queue.SimpleQueue[tuple[Item, Future[Result]] | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._pools: dict[int, tuple[ProcessPoolExecutor, int]] = {}  # of one process each, with its id
        self._workers = workers
        self._is_closed = False
        self.open = 0
        """Items that wait or are processed."""
        self.counts = Counter[str](answered=0, failed=0, deaths=0)
        """Items with a result, items without one, processes that died."""
        for place in range(workers):
            threading.Thread(target=self._attend, args=(place,), daemon=True).start()

    @property
    def pids(self) -> list[int]:
        """Process ids of the workers that run."""
        return [pid for _, pid in list(self._pools.values())]

    def submit(self, items: Sequence[Item]) -> list[Future[Result]] | None:
        """Queue items, all or none; None if there is no room for them.

        A result that there is none of raises a KinebenchError with the reason.
        """
        with self._lock:
            if self.open + len(items) > self._most:
                return None
            self.open += len(items)
        futures: list[Future[Result]] = [Future() for _ in items]
        for pair in zip(items, futures, strict=True):
            self._waiting.put(pair)
        return futures

    def close(self) -> None:
        """End the processes, also those at work; no other is started."""
        self._is_closed = True
        for _ in range(self._workers):
            self._waiting.put(None)
        for place in list(self._pools):
            self._end(place)

    def _attend(self, place: int) -> None:
        """Process items in one process after another, until None arrives."""
        while (pair := self._waiting.get()) is not None:
            item, future = pair
            result: Result | None = None
            error: KinebenchError | None = None
            try:
                result = self._process(place, item)
            except KinebenchError as failure:
                error = failure
            except Exception as failure:  # the item's own: the queue goes on
                error = KinebenchError(cause(failure))
            with self._lock:
                self.open -= 1
                self.counts["failed" if error else "answered"] += 1
            future.set_exception(error) if error else future.set_result(cast(Result, result))
            del pair, item, future, result

    def _process(self, place: int, item: Item) -> Result:
        """Return the result of an item.

        Raises:
            KinebenchError: there is none.
        """
        lost = Counter[bool]()  # processes, by whether they were ready
        while lost[True] < ATTEMPTS and lost[False] < STARTS and not self._is_closed:
            try:
                pool = self._ready(place)
                result: Result = pool.submit(_work, item).result(self._timeout_s)
                return result
            except TimeoutError:
                self._end(place)
                raise KinebenchError(f"took more than {self._timeout_s:g} s") from None
            except (BrokenProcessPool, RuntimeError):
                lost[place in self._pools] += 1
                self._end(place)
        raise KinebenchError(f"{lost.total()} processes ended over this item (often the system is out of memory)")

    def _ready(self, place: int) -> ProcessPoolExecutor:
        """Return the process of a place, started if there is none."""
        if place not in self._pools:
            pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"))
            with self._lock, one_thread():
                start = pool.submit(_start, self._make_worker)
            self._pools[place] = pool, start.result()
        return self._pools[place][0]

    def _end(self, place: int) -> None:
        """End the process of a place."""
        self.counts["deaths"] += 1
        pool, pid = self._pools.pop(place, (None, 0))
        if pool is not None:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
            pool.shutdown(wait=False)


_own: list[Callable[[Any], Any]] = []
"""Worker of this process."""


def _start(make_worker: MakeWorker[Any, Any]) -> int:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles interrupts
    _own.append(make_worker())
    return os.getpid()


def _work(item: object) -> Any:
    return _own[0](item)
