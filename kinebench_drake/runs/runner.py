"""A run over many samples of any kind: resume, distribute, store, summarize."""

import os
import platform
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Generic, Protocol

from kinebench_drake.errors import SetupError
from kinebench_drake.executors.base import (
    Executor,
    Observer,
    SupportsClose,
    SupportsDrain,
    WorkerCrash,
    create_executor,
)
from kinebench_drake.executors.interrupt import graceful_interrupt
from kinebench_drake.io.atomic import disk_errors
from kinebench_drake.io.jsonl import Json, write_lines
from kinebench_drake.io.progress import listen, named
from kinebench_drake.report.sample import worst_samples
from kinebench_drake.results.aggregate import Estimate, RunStatistics, estimate, estimate_executable
from kinebench_drake.results.drops import DROPS, GATED, Drop, list_drops
from kinebench_drake.results.inputs import list_inputs
from kinebench_drake.results.metadata import RunMetadata, read_metadata
from kinebench_drake.results.provenance import host, versions, weights_hash
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.results.store import REPORT, RESULTS, RUN, ResultStore, artifact_path
from kinebench_drake.runs.config import RunConfig, RunKind
from kinebench_drake.runs.evaluator import Evaluator, ResourcesT, SampleT, fail_row
from kinebench_drake.runs.resume import SCHEMA_VERSION, hash_sample, resume


class RunObserver(Observer, Protocol):
    """Observer of a run: receives finished rows in place of `advance`."""

    def detail(self, line: str) -> None:
        """Report progress within a sample."""
        return None

    def finish(self, row: SampleRow, wall_s: float) -> None:
        """Report a sample whose row is stored, and its processing time [s]."""
        return None


class NullRunObserver(RunObserver):
    """Run observer that ignores every report; override the methods of interest."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSummary:
    """Outcome of a run."""

    rows: tuple[SampleRow, ...]
    """All rows of the output folder, by id."""
    counts: Mapping[Status, int]
    """Samples of each status in the output folder."""
    executable: Estimate | None
    """Share of all samples that are executable, with its upper bound; None where none was judged."""
    feasible: Estimate | None
    """Share of the measured samples that are feasible; None where none was judged."""
    success: Estimate | None
    """Share of successful episodes; None for runs without episodes, or where none was measured."""
    report: Path | None
    """The html report; None for kinds that have none."""
    drops: tuple[Drop, ...] = ()
    """The drop list, of files that are judged."""
    missed: tuple[str, ...] = ()
    """Bounds of the gate that are missed, a clause each."""

    @property
    def pending(self) -> list[Mapping[str, Json]]:
        """Rows of a manifest of the videos that samples wait for."""
        return [row.pending for row in self.rows if row.pending is not None]


def run_samples(
    samples: Sequence[SampleT], evaluator: Evaluator[SampleT, ResourcesT], observer: RunObserver
) -> RunSummary:
    """Evaluate every sample and fill the output folder.

    Rows that are still valid (same input bytes, options and code) are kept. A sample that fails becomes a row, too.

    Raises:
        UsageError: the configuration or the output folder cannot be used.
        SetupError: something is missing on this machine, or the disk is full. Finished samples are kept.
        KeyboardInterrupt: the run was interrupted; at the first interrupt running samples are finished, if the executor
            can.
    """
    config = evaluator.config
    executor = create_executor(config.engine, config.jobs, config.address)
    chosen = config.select(samples)
    metadata = run_metadata(config, samples_found=len(samples), code=evaluator.code)
    with ResultStore(config.out, overwrite=config.overwrite) as store:
        waiting = resume(store, samples, chosen, evaluator, metadata, observer.warn)
        if waiting:
            evaluator.prepare(waiting, observer.warn)
        observer.start(total=len(chosen), completed=len(chosen) - len(waiting))
        with _graceful(executor, observer) as interrupted, listen(observer.detail):
            done = 0
            with closing(executor.run(partial(_start_worker, evaluator), waiting)) as outcomes:
                for outcome in outcomes:
                    if isinstance(outcome, WorkerCrash):
                        hashes = hash_sample(evaluator, outcome.item)
                        row = fail_row(evaluator.blank_row(outcome.item, hashes), Status.ERROR, outcome.reason)
                        wall_s = 0.0
                    else:
                        row, wall_s = outcome.result
                    stored = store.rows.get(row.id)
                    if stored is None or not stored.is_same(row):  # an error may have remained
                        store.begin(metadata.to_json())
                        store.append(row, wall_s)
                    observer.finish(row, wall_s)
                    done += 1
            if interrupted.is_set() and done < len(waiting):
                raise KeyboardInterrupt
            worst = worst_samples(store.rows.values(), partial(artifact_path, store.out, "tracks"), config.replays or 0)
            replayed = all(artifact_path(store.out, "replays", id).is_file() for id in worst)
            if replayed and _is_complete(config, metadata):
                return summarize_run(store, config.kind, config.seed)
            if config.replays is not None:
                store.keep_artifacts("replays", worst)
            statistics = RunStatistics.of(store.rows.values(), config.seed)
            store.finish(summarize(store.sorted_rows(), metadata, statistics))
            try:
                replay_samples(config, worst)
            except SetupError:  # a full disk, or no program may open a port: the report stands, the next run makes up
                close_run(store, config.kind, config.seed, statistics)
                raise
            return close_run(store, config.kind, config.seed, statistics)


def _graceful(executor: Executor, observer: RunObserver) -> AbstractContextManager[threading.Event]:
    """Return a context in which the first interrupt lets running samples finish, if the executor can."""
    if isinstance(executor, SupportsDrain):
        return graceful_interrupt(executor.drain, observer.warn)
    return nullcontext(threading.Event())


def _is_complete(config: RunConfig, metadata: RunMetadata) -> bool:
    """Return whether the folder holds the results of this very run, and its report if the kind of run has one."""
    from kinebench_drake.report.page import is_report_current

    stored = read_metadata(config.out)
    finished = stored is not None and stored.finished and stored.run.to_json() == metadata.to_json()
    return finished and (not config.kind.reports or is_report_current(config.out))


@dataclass(frozen=True, slots=True)
class SampleWorker(Generic[SampleT, ResourcesT]):
    """Evaluates samples in one process."""

    evaluator: Evaluator[SampleT, ResourcesT]
    resources: ResourcesT

    def __call__(self, sample: SampleT) -> tuple[SampleRow, float]:
        """Return the sample's row and the wall time it took [s]."""
        start = time.perf_counter()
        hashes = hash_sample(self.evaluator, sample)  # before: a file that changes meanwhile is measured again
        with named(sample.id):
            return self.evaluator.row(sample, self.resources, hashes), time.perf_counter() - start

    def close(self) -> None:
        """Release the resources."""
        if isinstance(self.resources, SupportsClose):
            self.resources.close()


def _start_worker(evaluator: Evaluator[SampleT, ResourcesT]) -> Callable[[SampleT], tuple[SampleRow, float]]:
    """Load the resources of a worker process."""
    out = evaluator.config.out
    if not out.is_dir() or not {RUN, RESULTS} & set(os.listdir(out)):  # a listing is fresh also over a network
        raise SetupError(f"{platform.node()} does not see the run in {out}: put $out in a folder that all nodes share")
    return SampleWorker(evaluator, evaluator.setup())


def close_run(store: ResultStore, kind: RunKind, seed: int, statistics: RunStatistics) -> RunSummary:
    """Write the report of a finished output folder and return its summary."""
    if kind.value in GATED:
        write_lines(store.out / DROPS, (drop.to_json() for drop in list_drops(store.sorted_rows())))
    if kind.reports:
        from kinebench_drake.report.page import write_report

        with disk_errors(REPORT):
            write_report(store.out, store.sorted_rows(), statistics)
    return summarize_run(store, kind, seed)


def summarize_run(store: ResultStore, kind: RunKind, seed: int) -> RunSummary:
    """Return the summary of a finished output folder with its report."""
    rows = store.sorted_rows()
    measured = [row for row in rows if row.status is Status.OK]

    def share(values: Sequence[bool | None], members: Sequence[SampleRow]) -> Estimate:
        return estimate(values, total=len(rows), seed=seed, episodes=[row.episode for row in members])

    feasible = share([row.feasible for row in measured], measured)
    success = share([row.success for row in measured], measured)
    return RunSummary(
        rows=tuple(rows),
        counts={status: sum(row.status is status for row in rows) for status in Status},
        executable=estimate_executable(rows, seed) if kind.judges and rows else None,
        feasible=feasible if feasible.n else None,
        success=success if kind is RunKind.SUITE and success.n else None,
        report=store.out / REPORT if kind.reports else None,
        drops=tuple(list_drops(rows)) if kind.value in GATED else (),
    )


def run_metadata(config: RunConfig, samples_found: int, code: str) -> RunMetadata:
    """Return the metadata of a run with this configuration, on this machine, with this code."""
    return RunMetadata(
        schema_version=SCHEMA_VERSION,
        suite_version=config.suite_version,
        kind=config.kind.value,
        samples_found=samples_found,
        config=config.to_json(),
        tags=config.tags,
        bootstrap_seed=config.seed,
        versions=versions(),
        code_sha256=code,
        weights_sha256=weights_hash(),
        host=host(),
    )


def summarize(rows: Sequence[SampleRow], metadata: RunMetadata, statistics: RunStatistics) -> dict[str, Json]:
    """Return the content of `results.json`."""
    return metadata.to_json(
        {
            "aggregates": statistics.total.to_json(),
            **{f"per_{key}": {n: a.to_json() for n, a in own.items()} for key, own in statistics.groups.items()},
            "inputs": list_inputs(rows),
        }
    )


def replay_samples(config: RunConfig, ids: Sequence[str]) -> None:
    """Write 3D replays."""
    if ids:
        from kinebench_drake.kinematics.plant import ArmPlant
        from kinebench_drake.report.replay import write_replays

        write_replays(config.out, ids, ArmPlant(config.robot_options().load()))
