"""How many workers of a Ray cluster the process that started the run can serve.

Measured: its processor time a sample with real Ray, real rows and 64 samples in flight, each of which only waits. From
it: a simulation of runs with more and more workers, in which results queue for that process.
"""

import heapq
import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.markdown import table
from benchmarks.record import machine_text
from kinebench_drake.executors.base import ItemResult
from kinebench_drake.executors.ray import ActorPool, WorkerActor
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.store import ResultStore, read_rows

HEADING = "## Workers of a Ray cluster"
"""Heading of the section of the document."""
IN_FLIGHT = 64
"""Samples that Ray has at a time while the driver is measured."""
WORKERS = (16, 64, 256, 1024, 4096)
"""Numbers of workers that are simulated."""
SPREAD = 0.3
"""Standard deviation of the time of a simulated sample, as a share of its mean."""
_PROCESSES, _WAIT_S = 2, 0.05
_STORE_BYTES = 100 * 2**20


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedRun:
    """Run of many samples with so many workers."""

    workers: int
    hours: float
    efficiency: float
    """Time that the workers worked, as a share of the run."""
    driver_load: float
    """Time that the driver worked, as a share of the run."""


class _SharedPool(ActorPool[str, SampleRow]):
    """Pool in which many workers share few processes, each of which waits for many samples at a time."""

    _actors: Sequence[Any] = ()

    def _start(self) -> WorkerActor[str]:
        if not self._actors:
            shared = self._actor_class.options(num_cpus=0, num_gpus=0, max_concurrency=IN_FLIGHT)
            self._actors = [shared.remote() for _ in range(_PROCESSES)]
        actor = self._actors[len(self._workers) % _PROCESSES]
        return WorkerActor(actor=actor, answer=self._equip(actor))

    def _dismiss(self, worker: WorkerActor[str]) -> None:
        self._workers.remove(worker)


@dataclass(frozen=True, slots=True, kw_only=True)
class WaitingWorker:
    """Worker that waits and returns a real row."""

    rows: Sequence[SampleRow]

    def __call__(self, id: str) -> SampleRow:
        """Return a row under the sample's id."""
        time.sleep(_WAIT_S)
        return replace(self.rows[int(id[-6:]) % len(self.rows)], id=id)


def measure_driver(template: Path, work: Path, samples: int) -> float:
    """Measure the processor time of the driver for one sample: Ray, queue, storage [s].

    Args:
        template: output folder whose rows the workers return.
        work: folder for the output.
        samples: number of samples.
    """
    import ray

    logging.getLogger("ray").setLevel(logging.ERROR)
    ray.init(num_cpus=_PROCESSES, object_store_memory=_STORE_BYTES, include_dashboard=False, log_to_driver=False)
    try:
        rows = tuple(read_rows(template).values())
        ids = [f"sample-{k:06d}" for k in range(samples)]
        worker = WaitingWorker(rows=rows)
        with ResultStore(work / "driver") as store:
            outcomes = _SharedPool(lambda: worker, ids, IN_FLIGHT).outcomes()
            _store(islice(outcomes, samples // 10), store)  # start-up apart
            start = time.process_time()
            _store(outcomes, store)
            return (time.process_time() - start) / (samples - samples // 10)
    finally:
        ray.shutdown()


def _store(outcomes: Any, store: ResultStore) -> None:
    for outcome in outcomes:
        if isinstance(outcome, ItemResult):
            store.append(outcome.result, 0.0)


def simulate_run(workers: int, samples: int, sample_s: float, driver_s: float, seed: int = 0) -> SimulatedRun:
    """Simulate a run: a worker that has finished a sample gets its next one when the driver has served its result.

    Args:
        workers: number of workers.
        samples: number of samples.
        sample_s: mean time of a sample [s]; gamma distributed with a relative deviation of SPREAD.
        driver_s: time of the driver for a result [s].
        seed: seed of the times.
    """
    shape = 1.0 / SPREAD**2
    times = np.random.default_rng(seed).gamma(shape, sample_s / shape, samples).tolist()
    started = min(workers, samples)
    finished = times[:started]
    heapq.heapify(finished)
    clock = 0.0
    for work_s in times[started:]:
        clock = max(clock, heapq.heappop(finished)) + driver_s
        heapq.heappush(finished, clock + work_s)
    while finished:
        clock = max(clock, heapq.heappop(finished)) + driver_s
    return SimulatedRun(
        workers=workers,
        hours=clock / 3600.0,
        efficiency=sum(times) / (workers * clock),
        driver_load=samples * driver_s / clock,
    )


def measure(
    template: Path, work: Path, *, samples: int, sample_s: float, log: Callable[[str], None]
) -> tuple[float, list[SimulatedRun]]:
    """Measure the driver [s a sample] and simulate runs of 100,000 samples."""
    driver_s = measure_driver(template, work, samples)
    log(f"driver: {1e3 * driver_s:.2f} ms a sample")
    return driver_s, [simulate_run(workers, 100_000, sample_s, driver_s) for workers in WORKERS]


def section(driver_s: float, runs: Sequence[SimulatedRun], sample_s: float) -> str:
    """Return the section of the document."""
    rows = [[str(r.workers), f"{r.hours:.2f}", f"{r.efficiency:.1%}", f"{r.driver_load:.0%}"] for r in runs]
    return "\n".join(
        [
            HEADING,
            "",
            f"Written by `python -m benchmarks driver` on {machine_text()}. The process "
            f"that started the run spends {1e3 * driver_s:.2f} ms of processor time on a sample (Ray, queue, storage), "
            f"measured with real rows and {IN_FLIGHT} samples in flight in {_PROCESSES} processes. From this a "
            f"simulation of 100,000 samples of {sample_s:g} s (standard deviation {SPREAD:.0%}); it has no node that "
            f"fails and no start-up. That process is the limit from about {sample_s / driver_s:.0f} workers on.",
            "",
            *table(("workers", "hours", "workers busy", "that process busy"), rows),
            "",
        ]
    )


def figures(driver_s: float) -> dict[str, float]:
    """Return the processor time of the driver."""
    return {"driver, ms a sample": 1e3 * driver_s}
