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
                yield from _outcomes(make_worker, items, min(self.jobs, len(items)))


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
    """Class of the actors: one worker process on some node, which Ray starts again where it is lost."""

    def __init__(self, folder: str, code: str, make_worker: MakeWorker[Item, Result]) -> None:
        node = platform.node()
        self._error: KinebenchError | None = None
        if code_hash(*RUNS) != code:
            self._error = SetupError(
                f"node {node} has another version of kinebench-drake: install the same on all nodes"
            )
            return
        try:
            os.chdir(folder)
        except OSError as error:
            self._error = SetupError(
                f"node {node} has no access to the folder {folder} ({error.strerror}): nodes must share the file system"
            )
            return
        try:
            self._work = make_worker()
        except KinebenchError as error:
            self._error = error

    def check(self) -> KinebenchError | None:
        """Return why this node cannot run the worker; None once it is ready."""
        return self._error

    def work(self, item: Item) -> Result | KinebenchError:
        """Return the result of an item, or the error that ends the run."""
        try:
            return self._error or self._work(item)
        except KinebenchError as error:
            return error


def _outcomes(make_worker: MakeWorker[Item, Result], items: Sequence[Item], size: int) -> Outcomes[Item, Result]:
    """Yield the outcome of each item as soon as it is available, in any order, from `size` actors.

    An item whose worker is lost is tried once more: the machine may be the cause, not the item.
    """
    import ray

    actor_class = ray.remote(
        num_cpus=1,
        num_gpus=gpu_share(int(ray.cluster_resources().get("GPU", 0.0)), size),
        scheduling_strategy="SPREAD",
        max_restarts=3,
        max_task_retries=1,
        runtime_env={"env_vars": dict.fromkeys(THREAD_VARIABLES, "1")},
    )(RayWorker)
    arguments = (os.getcwd(), code_hash(*RUNS), make_worker)
    queue = deque(items)
    actors: list[Any] = []
    running: dict[Any, tuple[Any, Item | None]] = {}  # by answer; no item while the actor loads its models

    def start() -> None:
        actors.append(actor_class.remote(*arguments))
        running[actors[-1].check.remote()] = actors[-1], None

    try:
        for _ in range(size):
            start()
        while queue or any(item is not None for _, item in running.values()):
            answers, _ = ray.wait(list(running), timeout=1.0)  # an interrupt is noticed within a second
            for answer in answers:
                actor, item = running.pop(answer)
                try:
                    result = ray.get(answer)
                except ray.exceptions.RayError as error:
                    message = " ".join(str(error).split())
                    if item is None:
                        raise SetupError(
                            "workers on the Ray cluster die before they start: is kinebench-drake installed on every "
                            f"node, is there enough memory? Ray says: ...{message[-300:]}"
                        ) from None
                    ray.kill(actor)
                    start()
                    memory = "its node ran out of memory: use fewer jobs" if "memory" in message.lower() else None
                    hint = memory or "often its node is out of memory"
                    yield WorkerCrash(item=item, reason=f"the worker was lost twice over this sample ({hint})")
                    continue
                if isinstance(result, KinebenchError):
                    raise result
                if queue:
                    following = queue.popleft()
                    running[actor.work.remote(following)] = actor, following
                else:
                    ray.kill(actor)
                if item is not None:
                    yield ItemResult(item=item, result=result)
    finally:
        for actor in actors:
            ray.kill(actor)
