"""Workers on a Ray cluster (https://docs.ray.io): one actor a slot, which loads its models once.

Ray itself is imported only when a run begins. Workers compute with one thread, as local ones do, so that where a sample
is worked on does not change a byte of its results.
"""

import logging
import math
import os
import platform
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic

from kinebench_drake.errors import KinebenchError, SetupError
from kinebench_drake.executors.base import Crashed, Done, Item, Result
from kinebench_drake.executors.local import THREAD_VARIABLES
from kinebench_drake.results.provenance import code_hash

TRIES = 2
"""How often an item is tried whose worker is lost: the first loss may be the machine's fault, not the item's."""
MOST_FAILED_STARTS = 3
"""So many workers in a row that die while they load their models end the run."""
_GLANCE_S = 1.0
"""How long to wait for outcomes before looking whether anybody interrupts [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RayEngine:
    """An `Engine` on a Ray cluster whose nodes share the file system with this machine."""

    jobs: int
    """Number of workers, one CPU each; those for which there is no CPU yet begin when there is one."""
    address: str | None = None
    """Address of the cluster; None: what RAY_ADDRESS names, or the one this machine is part of, else a new one here."""

    def run(
        self, make_worker: Callable[[], Callable[[Item], Result]], items: Sequence[Item]
    ) -> Generator[Done[Item, Result] | Crashed[Item], None, None]:
        """See `Engine.run`.

        Raises:
            SetupError: the cluster cannot be reached or has no CPU, a node holds other code or does not see this
                folder, or workers die again and again before they begin.
        """
        if items:
            with _connected(self.address):
                yield from _Crew(make_worker, items, min(self.jobs, len(items))).outcomes()


def gpu_share(gpus: int, workers: int) -> float:
    """Share of a GPU that a worker asks for, so that all find room; Ray hides GPUs from those that ask for none."""
    return 1.0 / math.ceil(workers / gpus) if gpus else 0.0


@contextmanager
def _connected(address: str | None) -> Iterator[None]:
    """Be part of the cluster; whoever is already, stays."""
    import ray

    if ray.is_initialized():
        yield
        return
    on_termination = signal.getsignal(signal.SIGTERM)
    try:
        ray.init(address=address, logging_level=logging.ERROR, log_to_driver=False)
    except (ConnectionError, RuntimeError, ValueError) as error:
        told = " ".join(str(error).split())
        raise SetupError(
            f"no Ray cluster can be used at {address or 'this machine'} ({told:.200}); `ray start --head` begins one, "
            "`ray status` tells of it"
        ) from None
    finally:
        if (
            on_termination is not None and threading.current_thread() is threading.main_thread()
        ):  # Ray takes the signal for itself
            signal.signal(signal.SIGTERM, on_termination)
    try:
        if ray.cluster_resources().get("CPU", 0.0) < 1.0:
            raise SetupError("the Ray cluster has no CPU for workers: add a node with `ray start --address HOST:PORT`")
        yield
    finally:
        ray.shutdown()


class _Servant(Generic[Item, Result]):
    """What an actor is: one worker process on some node."""

    def __init__(self) -> None:
        os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))  # before `equip`'s arguments load numeric libraries

    def equip(
        self, folder: str, code: str, make_worker: Callable[[], Callable[[Item], Result]]
    ) -> KinebenchError | None:
        """Load what work takes; returns why it cannot be done."""
        node = platform.node()
        if code_hash() != code:
            return SetupError(f"node {node} has another version of kinebench-drake: install the same on all nodes")
        try:
            os.chdir(folder)
        except OSError as error:
            return SetupError(
                f"node {node} does not see the folder {folder} ({error.strerror}): nodes must share the file system"
            )
        try:
            self._work = make_worker()
        except KinebenchError as error:
            return error
        return None

    def work(self, item: Item) -> Result | KinebenchError:
        """Result of an item, or why the run cannot go on."""
        try:
            return self._work(item)
        except KinebenchError as error:
            return error


@dataclass(slots=True)
class _Task(Generic[Item]):
    """An item and how often it was begun."""

    item: Item
    tries: int = 0


@dataclass(slots=True)
class _Slot(Generic[Item]):
    """One worker, what it is busy with, and where the answer will be."""

    actor: Any
    answer: Any
    task: _Task[Item] | None = None
    """None while it loads its models."""


class _Crew(Generic[Item, Result]):
    """Actors fed one item at a time: when one is lost, only its item is, and another actor takes its place."""

    def __init__(self, make_worker: Callable[[], Callable[[Item], Result]], items: Sequence[Item], size: int) -> None:
        import ray

        self._ray = ray
        gpus = gpu_share(int(ray.cluster_resources().get("GPU", 0.0)), size)
        self._servant = ray.remote(num_cpus=1, num_gpus=gpus, scheduling_strategy="SPREAD")(_Servant)
        self._make_worker = ray.put(make_worker)
        self._waiting = deque(_Task(item) for item in items)
        self._size = size
        self._slots: list[_Slot[Item]] = []
        self._failed_starts = 0

    def outcomes(self) -> Generator[Done[Item, Result] | Crashed[Item], None, None]:
        try:
            while busy := len(self._waiting) + sum(slot.task is not None for slot in self._slots):
                while len(self._slots) < min(self._size, busy):
                    self._slots.append(self._start())
                answers, _ = self._ray.wait([slot.answer for slot in self._slots], timeout=_GLANCE_S)
                for slot in [slot for slot in self._slots if slot.answer in answers]:
                    outcome = self._receive(slot)
                    if outcome is not None:
                        yield outcome
        finally:
            for slot in list(self._slots):
                self._dismiss(slot)

    def _start(self) -> _Slot[Item]:
        actor = self._servant.remote()
        return _Slot(actor=actor, answer=actor.equip.remote(os.getcwd(), code_hash(), self._make_worker))

    def _dismiss(self, slot: _Slot[Item]) -> None:
        self._slots.remove(slot)
        self._ray.kill(slot.actor)

    def _feed(self, slot: _Slot[Item]) -> None:
        """Hand the next item to a worker, or send it home."""
        if not self._waiting:
            self._dismiss(slot)
            return
        slot.task = self._waiting.popleft()
        slot.task.tries += 1
        slot.answer = slot.actor.work.remote(slot.task.item)

    def _receive(self, slot: _Slot[Item]) -> Done[Item, Result] | Crashed[Item] | None:
        task = slot.task
        try:
            answer = self._ray.get(slot.answer)
        except self._ray.exceptions.RayError as error:
            self._dismiss(slot)
            if task is not None:
                return self._lost(task, error)
            self._failed_start(error)
            return None
        if isinstance(answer, KinebenchError):
            raise answer
        self._feed(slot)
        if task is None:
            self._failed_starts = 0
            return None
        return Done(item=task.item, result=answer)

    def _failed_start(self, error: Exception) -> None:
        """Bear with a worker that was lost before it could work, unless that goes on.

        Raises:
            SetupError: it goes on.
        """
        self._failed_starts += 1
        if self._failed_starts >= MOST_FAILED_STARTS or isinstance(error, self._ray.exceptions.RayTaskError):
            told = " ".join(str(error).split())
            raise SetupError(
                f"workers on the Ray cluster die before they begin: is kinebench-drake installed on every node, is "
                f"there memory enough? Ray says: ...{told[-300:]}"
            )

    def _lost(self, task: _Task[Item], error: Exception) -> Crashed[Item] | None:
        """Put an item back in line, or give it up."""
        if task.tries < TRIES:
            self._waiting.appendleft(task)
            return None
        memory = "memory" in str(error).lower()
        hint = "its node ran out of memory: use fewer --jobs" if memory else "often its node is out of memory"
        return Crashed(item=task.item, reason=f"the worker was lost {task.tries} times over this sample ({hint})")
