"""Execution on a Ray cluster (https://docs.ray.io): one actor per worker, which loads its models once.

Ray is imported only when a run starts. Workers compute with one thread, as local ones do, so that the machine on which
a sample is processed does not change a byte of its results.
"""

import logging
import math
import os
import platform
import signal
import threading
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic

from kinebench_drake.errors import KinebenchError, SetupError
from kinebench_drake.executors.base import Item, ItemResult, MakeWorker, Outcomes, Result, WorkerCrash
from kinebench_drake.executors.local import THREAD_VARIABLES
from kinebench_drake.results.provenance import RUNS, code_hash

MOST_FAILED_STARTS = 3
"""Number of consecutive workers lost while loading their models that ends the run."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RayExecutor:
    """`Executor` on a Ray cluster whose nodes share the file system with this machine."""

    jobs: int
    """Number of workers, one CPU each; a worker without a free CPU starts when one becomes free."""
    address: str | None = None
    """Address of the cluster; None: that of RAY_ADDRESS, else the cluster of this machine, else a new local one."""

    def run(self, make_worker: MakeWorker[Item, Result], items: Sequence[Item]) -> Outcomes[Item, Result]:
        """Yield the outcome of each item as soon as it is available, in any order."""
        if items:
            with _connected(self.address):
                yield from ActorPool(make_worker, items, min(self.jobs, len(items))).outcomes()


def gpu_share(gpus: int, workers: int) -> float:
    """Return the share of a GPU to request per worker so that all fit; without a request Ray hides the GPUs."""
    return 1.0 / math.ceil(workers / gpus) if gpus else 0.0


@contextmanager
def _connected(address: str | None) -> Iterator[None]:
    """Connect to the cluster and disconnect on exit; an existing connection is used and kept."""
    import ray

    if ray.is_initialized():
        yield
        return
    on_termination = signal.getsignal(signal.SIGTERM)
    try:
        ray.init(address=address, logging_level=logging.ERROR, log_to_driver=False)
    except (ConnectionError, RuntimeError, ValueError) as error:
        message = " ".join(str(error).split())
        raise SetupError(
            f"no Ray cluster can be used at {address or 'this machine'} ({message:.200}); `ray start --head` starts "
            "one, `ray status` describes it"
        ) from None
    finally:
        # Ray replaces the handler of SIGTERM.
        if on_termination is not None and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, on_termination)
    try:
        if ray.cluster_resources().get("CPU", 0.0) < 1.0:
            raise SetupError("the Ray cluster has no CPU for workers: add a node with `ray start --address HOST:PORT`")
        yield
    finally:
        ray.shutdown()


class RayWorker(Generic[Item, Result]):
    """Class of the actors: one worker process on some node."""

    def __init__(self) -> None:
        os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))  # before `equip`'s arguments load numeric libraries

    def equip(self, folder: str, code: str, make_worker: MakeWorker[Item, Result]) -> KinebenchError | None:
        """Create the worker; return an error if this node cannot run it."""
        node = platform.node()
        if code_hash(*RUNS) != code:
            return SetupError(f"node {node} has another version of kinebench-drake: install the same on all nodes")
        try:
            os.chdir(folder)
        except OSError as error:
            return SetupError(
                f"node {node} has no access to the folder {folder} ({error.strerror}): nodes must share the file system"
            )
        try:
            self._work = make_worker()
        except KinebenchError as error:
            return error
        return None

    def work(self, item: Item) -> Result | KinebenchError:
        """Return the result of an item, or the error that ends the run."""
        try:
            return self._work(item)
        except KinebenchError as error:
            return error


@dataclass(slots=True)
class _QueuedItem(Generic[Item]):
    """Item and the number of attempts at it."""

    item: Item
    tries: int = 0


@dataclass(slots=True)
class WorkerActor(Generic[Item]):
    """One actor, the item that it is processing and the reference to its answer."""

    actor: Any
    answer: Any
    queued: _QueuedItem[Item] | None = None
    """None while the actor loads its models."""


class ActorPool(Generic[Item, Result]):
    """Actors that receive one item at a time: one that is lost loses only its item and is replaced."""

    def __init__(self, make_worker: MakeWorker[Item, Result], items: Sequence[Item], size: int) -> None:
        import ray

        self._ray = ray
        gpus = gpu_share(int(ray.cluster_resources().get("GPU", 0.0)), size)
        self._actor_class = ray.remote(num_cpus=1, num_gpus=gpus, scheduling_strategy="SPREAD")(RayWorker)
        self._make_worker = ray.put(make_worker)
        self._queue = deque(_QueuedItem(item) for item in items)
        self._size = size
        self._workers: list[WorkerActor[Item]] = []
        self._failed_starts = 0

    def outcomes(self) -> Outcomes[Item, Result]:
        """Yield the outcome of each item as soon as it is available, in any order."""
        try:
            while busy := len(self._queue) + sum(worker.queued is not None for worker in self._workers):
                while len(self._workers) < min(self._size, busy):
                    self._workers.append(self._start())
                # An interrupt is noticed within a second.
                answers, _ = self._ray.wait([worker.answer for worker in self._workers], timeout=1.0)
                for worker in [worker for worker in self._workers if worker.answer in answers]:
                    outcome = self._receive(worker)
                    if outcome is not None:
                        yield outcome
        finally:
            for worker in list(self._workers):
                self._dismiss(worker)

    def _start(self) -> WorkerActor[Item]:
        actor = self._actor_class.remote()
        return WorkerActor(actor=actor, answer=self._equip(actor))

    def _equip(self, actor: Any) -> Any:
        """Let an actor load its models; returns the reference to its answer."""
        return actor.equip.remote(os.getcwd(), code_hash(*RUNS), self._make_worker)

    def _dismiss(self, worker: WorkerActor[Item]) -> None:
        self._workers.remove(worker)
        self._ray.kill(worker.actor)

    def _feed(self, worker: WorkerActor[Item]) -> None:
        """Send the next item to a worker, or end the worker if there is none."""
        if not self._queue:
            self._dismiss(worker)
            return
        worker.queued = self._queue.popleft()
        worker.queued.tries += 1
        worker.answer = worker.actor.work.remote(worker.queued.item)

    def _receive(self, worker: WorkerActor[Item]) -> ItemResult[Item, Result] | WorkerCrash[Item] | None:
        queued = worker.queued
        try:
            answer = self._ray.get(worker.answer)
        except self._ray.exceptions.RayError as error:
            self._dismiss(worker)
            if queued is not None:
                return self._lost(queued, error)
            self._failed_start(error)
            return None
        if isinstance(answer, KinebenchError):
            raise answer
        self._feed(worker)
        if queued is None:
            self._failed_starts = 0
            return None
        return ItemResult(item=queued.item, result=answer)

    def _failed_start(self, error: Exception) -> None:
        """Count a worker that was lost before it was ready."""
        self._failed_starts += 1
        if self._failed_starts >= MOST_FAILED_STARTS or isinstance(error, self._ray.exceptions.RayTaskError):
            message = " ".join(str(error).split())
            raise SetupError(
                f"workers on the Ray cluster die before they start: is kinebench-drake installed on every node, is "
                f"there enough memory? Ray says: ...{message[-300:]}"
            )

    def _lost(self, queued: _QueuedItem[Item], error: Exception) -> WorkerCrash[Item] | None:
        """Put the item of a lost worker back into the queue, or report a crash after the last attempt."""
        # The first loss of a worker may be caused by the machine, not by the item.
        if queued.tries < 2:
            self._queue.appendleft(queued)
            return None
        memory = "memory" in str(error).lower()
        hint = "its node ran out of memory: use fewer jobs" if memory else "often its node is out of memory"
        return WorkerCrash(
            item=queued.item, reason=f"the worker was lost {queued.tries} times over this sample ({hint})"
        )
