"""Workers on this machine: in this process, or several of one thread each.

Every worker computes with one thread, also a single one: sums then come in one order, so that the number of jobs does
not change a byte of the results.
"""

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from types import FrameType
from typing import Generic, cast

from kinebench_drake.errors import KinebenchError
from kinebench_drake.executors.base import Crashed, Done, Item, Result, hired

THREAD_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
"""Environment variables that tell numeric libraries how many threads to take."""
_GRACE_S = 10.0
"""How long workers that are ended may take to end what they have started, such as the program of a world model [s]."""
_TERMINATED = 128 + signal.SIGTERM
"""Exit status, as shells have it, of a worker that was ended and has cleaned up."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalEngine:
    """An `Engine` on this machine."""

    jobs: int
    """Number of processes; 1 works in this very process."""
    _drained: threading.Event = field(default_factory=threading.Event, init=False, repr=False, compare=False)

    def drain(self) -> None:
        """See `Draining`."""
        self._drained.set()

    def run(
        self, make_worker: Callable[[], Callable[[Item], Result]], items: Sequence[Item]
    ) -> Generator[Done[Item, Result] | Crashed[Item], None, None]:
        """See `Engine.run`."""
        if not items:
            return
        if self.jobs == 1:
            with one_thread(), hired(make_worker) as work:
                for item in items:
                    if self._drained.is_set():
                        return
                    yield Done(item=item, result=work(item))
        else:
            yield from _Pool(make_worker, items, min(self.jobs, len(items)), self._drained).outcomes()


@contextmanager
def one_thread() -> Iterator[None]:
    """One thread for numeric libraries: those not loaded yet read the environment, torch also listens later."""
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    torch = sys.modules.get("torch")
    threads = torch.get_num_threads() if torch else 0
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    if torch:
        torch.set_num_threads(1)
    try:
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
class _Slot(Generic[Item]):
    """One worker process and what it is busy with."""

    process: BaseProcess
    pipe: Connection
    item: Item | None = None


class _Pool(Generic[Item, Result]):
    """Processes fed one item at a time over a pipe each: when one dies, only its item is lost."""

    def __init__(
        self,
        make_worker: Callable[[], Callable[[Item], Result]],
        items: Sequence[Item],
        size: int,
        drained: threading.Event,
    ) -> None:
        self._drained = drained
        self._make_worker = make_worker
        self._waiting = deque(items)
        self._size = size
        self._slots: list[_Slot[Item]] = []

    def outcomes(self) -> Generator[Done[Item, Result] | Crashed[Item], None, None]:
        try:
            while self._has_more() or self._slots:
                while self._has_more() and len(self._slots) < self._size:
                    self._start()
                ready = wait([slot.pipe for slot in self._slots]) if self._slots else []
                for slot in [slot for slot in self._slots if slot.pipe in ready]:
                    outcome = self._receive(slot)
                    if outcome is not None:
                        yield outcome
        finally:
            for slot in self._slots:
                slot.process.terminate()
            give_up = time.monotonic() + _GRACE_S
            for slot in self._slots:
                slot.process.join(max(0.0, give_up - time.monotonic()))
                slot.process.kill()
                slot.process.join()
                slot.pipe.close()

    def _has_more(self) -> bool:
        """Whether there is an item to be begun."""
        return bool(self._waiting) and not self._drained.is_set()

    def _start(self) -> None:
        """Begin a worker and hand it an item, if an interrupt has not left it without one."""
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(theirs, self._make_worker), daemon=True)
        slot: _Slot[Item] = _Slot(process=process, pipe=ours)
        resource_tracker.ensure_running()  # which unblocks signals, so not amid what follows
        # Children inherit the environment and the blocked signals of this moment: an interrupt finds none unprepared.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            with one_thread():
                process.start()
            self._slots.append(slot)  # whatever comes from here on finds it
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
        self._feed(slot)

    def _feed(self, slot: _Slot[Item]) -> None:
        """Hand the next item to a worker, or send it home."""
        slot.item = self._waiting.popleft() if self._has_more() else None
        with suppress(BrokenPipeError, ConnectionResetError):  # it died; the next receive tells
            slot.pipe.send(slot.item)
        if slot.item is None:
            self._dismiss(slot)

    def _dismiss(self, slot: _Slot[Item]) -> None:
        self._slots.remove(slot)
        slot.process.join()
        slot.pipe.close()

    def _receive(self, slot: _Slot[Item]) -> Done[Item, Result] | Crashed[Item] | None:
        item = cast(Item, slot.item)
        try:
            answer = slot.pipe.recv()
        except (EOFError, OSError):  # OSError: it died amid its answer
            self._dismiss(slot)
            return Crashed(item=item, reason=_cause_of_death(slot.process.exitcode))
        if isinstance(answer, KinebenchError):
            raise answer
        self._feed(slot)
        return Done(item=item, result=answer)


def _cause_of_death(code: int | None) -> str:
    code = -signal.SIGTERM if code == _TERMINATED else code
    if code is not None and code < 0:
        name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
        hint = " (often the system is out of memory: use fewer --jobs)" if -code == signal.SIGKILL else ""
        return f"the worker process was ended by {name}{hint}"
    return f"the worker process ended with status {code}"


def _leave(number: int, frame: FrameType | None) -> None:
    """Unwind a worker that is ended, so that it ends what it has started."""
    raise SystemExit(_TERMINATED)


def _serve(pipe: Connection, make_worker: Callable[[], Callable[[Item], Result]]) -> None:
    """Body of a worker process: items in, results out, until None or until the parent is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides what an interrupt means
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    signal.signal(signal.SIGTERM, _leave)
    try:
        with hired(make_worker) as work:
            while (item := pipe.recv()) is not None:
                pipe.send(work(item))
    except KinebenchError as error:
        pipe.send(error)
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return
