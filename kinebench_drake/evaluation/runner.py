"""One run over many samples, whatever they are: resumed, shared out, stored, summed up."""

import os
import platform
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Protocol

from kinebench_drake.errors import SetupError, UsageError
from kinebench_drake.evaluation.evaluator import SCHEMA_VERSION, Evaluator, ResourcesT, RunKind, SampleT
from kinebench_drake.evaluation.resume import resume
from kinebench_drake.evaluation.stages import SHIPPED_STAGES, RobotOptions
from kinebench_drake.executors.base import Executor, ExecutorKind, SupportsDrain, WorkerCrash, create_executor
from kinebench_drake.executors.interrupt import graceful_interrupt
from kinebench_drake.executors.progress import NullObserver, Observer
from kinebench_drake.io.atomic import disk_errors
from kinebench_drake.report.sample import worst_samples
from kinebench_drake.results.aggregate import Estimate, aggregate, by_key, estimate, normalize_run
from kinebench_drake.results.metadata import RunMetadata, Shard
from kinebench_drake.results.provenance import code_hash, host, versions, weights_hash
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.results.store import REPORT, RUN, ResultStore, artifact_path
from kinebench_drake.types import Json


@dataclass(frozen=True, slots=True, kw_only=True)
class RunConfig:
    """What every run is told."""

    out: Path
    """Output folder, made if absent."""
    kind: RunKind
    limit: int | None = None
    """Work on the first so many samples only."""
    shard: Shard | None = None
    """Work on this part of the samples only."""
    jobs: int = 1
    """Worker processes."""
    engine: ExecutorKind = ExecutorKind.LOCAL
    address: str | None = None
    """Address of the Ray cluster."""
    overwrite: bool = False
    """Forget what `out` holds instead of going on from there."""
    seed: int = 0
    """Seed of the intervals' resampling."""
    model: str | None = None
    """Model of samples that name none."""
    tags: Mapping[str, str] = field(default_factory=dict)
    """Free labels, kept in the results."""
    stages: str = SHIPPED_STAGES
    """Import path of the heavy steps."""
    table_height_m: float = 0.0
    """Height of the table's top in the robot's base frame [m]."""
    replays: int | None = None
    """3D replays to write, of the worst samples; None for runs that write none, where those of `view` stay."""

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            UsageError: one of them makes no sense.
        """
        if self.limit is not None and self.limit < 1:
            raise UsageError(f"--limit is {self.limit}, expected 1 or more")
        if self.seed < 0:
            raise UsageError(f"--seed is {self.seed}, expected 0 or more")
        if self.replays is not None and self.replays < 0:
            raise UsageError(f"--replays is {self.replays}, expected 0 or more")
        self.stage_options()

    @property
    def suite_version(self) -> str | None:
        """Version of the suites whose episodes are run; None where none are."""
        return None

    def stage_options(self) -> RobotOptions:
        """What the stages are told.

        Raises:
            UsageError: it cannot be used.
        """
        return RobotOptions(table_height_m=self.table_height_m)

    def to_json(self) -> dict[str, Json]:
        """What results tell of the configuration; paths by their last name only."""
        return {
            "kind": self.kind.value,
            "limit": self.limit,
            "shard": str(self.shard) if self.shard else None,
            "jobs": self.jobs,
            "engine": self.engine.value,
            "seed": self.seed,
            "model": self.model,
            "table_height_m": self.table_height_m,
            "replays": self.replays,
        }


class RunObserver(Observer, Protocol):
    """Observer of a run: receives finished rows in place of `advance`."""

    def finish(self, row: SampleRow, wall_s: float) -> None:
        """Report a sample whose row is stored, and its processing time [s]."""
        ...


class NullRunObserver(NullObserver):
    """Run observer that ignores every report; override the methods of interest."""

    def finish(self, row: SampleRow, wall_s: float) -> None:
        """Ignore the row."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSummary:
    """How a run ended."""

    rows: tuple[SampleRow, ...]
    """All rows of the output folder, by id."""
    counts: Mapping[Status, int]
    """Samples of each status in the output folder."""
    feasible: Estimate | None
    """Share of the measured samples that the robot can do; None where none was judged."""
    success: Estimate | None
    """Share of episodes that reached their goal; None of runs without goals, or where none was measured."""
    report: Path | None
    """The html report; None for kinds that have none."""


def run_samples(
    config: RunConfig, samples: Sequence[SampleT], measure: Evaluator[SampleT, ResourcesT], observer: RunObserver
) -> RunSummary:
    """Measure every sample and fill the output folder.

    Samples whose results are there already, from the same bytes and settings, are kept. A sample that fails is a row
    like any other.

    Raises:
        UsageError: the configuration or the output folder cannot be used.
        SetupError: something is missing on this machine, or the disk is full. What was finished is kept.
        KeyboardInterrupt: there was an interrupt. After the first the samples at hand were finished, if the engine can.
    """
    engine = create_executor(config.engine, config.jobs, config.address)
    chosen = list(samples[: config.limit])
    chosen = config.shard.take(chosen) if config.shard else chosen
    header = run_metadata(config, found=len(samples))
    with ResultStore(config.out, overwrite=config.overwrite) as store:
        waiting = resume(store, samples, chosen, measure, header, observer.warn)
        observer.start(total=len(chosen), completed=len(chosen) - len(waiting))
        with _interruptible(engine, observer) as interrupted:
            done = 0
            with closing(engine.run(partial(_make, measure), waiting)) as outcomes:
                for outcome in outcomes:
                    if isinstance(outcome, WorkerCrash):
                        row, wall_s = measure.failed(outcome.item, Status.ERROR, outcome.reason), 0.0
                    else:
                        row, wall_s = outcome.result
                    store.append(row, wall_s)
                    observer.finish(row, wall_s)
                    done += 1
            if interrupted.is_set() and done < len(waiting):
                raise KeyboardInterrupt
            worst = worst_samples(store.rows.values(), partial(artifact_path, store.out, "tracks"), config.replays or 0)
            if config.replays is not None:
                store.keep_files("replays", worst)
            store.finish(summarize(store.sorted_rows(), header))
            if worst:
                _replay(config, worst, observer)
            return close_run(store, config.kind, config.seed)


def _interruptible(engine: Executor, observer: RunObserver) -> AbstractContextManager[threading.Event]:
    """A context in which a first interrupt lets the samples at hand be finished, with engines that can."""
    if isinstance(engine, SupportsDrain):
        return graceful_interrupt(engine.drain, observer.warn)
    return nullcontext(threading.Event())


def _make(measure: Evaluator[SampleT, ResourcesT]) -> Callable[[SampleT], tuple[SampleRow, float]]:
    """Begin to work in some process.

    Raises:
        SetupError: it does not see what is written here, or something is missing.
    """
    if not measure.out.is_dir() or RUN not in os.listdir(measure.out):  # a listing is fresh also over a network
        raise SetupError(
            f"{platform.node()} does not see the run in {measure.out}: put --out in a folder that all nodes share"
        )
    return measure.make()


def close_run(store: ResultStore, kind: RunKind, seed: int) -> RunSummary:
    """Write the report of a finished folder and sum it up.

    Raises:
        SetupError: writing failed.
    """
    rows = store.sorted_rows()
    report = _report(store.out) if kind.judges else None
    measured = [r for r in rows if r.status is Status.OK]
    feasible = estimate([r.feasible for r in measured], total=len(rows), seed=seed)
    goals = [r.extra.get("success") for r in measured] if kind is RunKind.SUITE else []
    success = estimate(goals, total=len(rows), seed=seed)
    return RunSummary(
        rows=tuple(rows),
        counts={status: sum(row.status is status for row in rows) for status in Status},
        feasible=feasible if feasible.n else None,
        success=success if success.n else None,
        report=report,
    )


def run_metadata(config: RunConfig, found: int) -> RunMetadata:
    """What results tell of a run besides its rows and their numbers, on this machine with this code."""
    return RunMetadata(
        schema_version=SCHEMA_VERSION,
        suite_version=config.suite_version,
        kind=config.kind.value,
        samples_found=found,
        config=config.to_json(),
        tags=config.tags,
        bootstrap_seed=config.seed,
        versions=versions(),
        code_sha256=code_hash(),
        weights_sha256=weights_hash(),
        host=host(),
    )


def summarize(rows: Sequence[SampleRow], header: RunMetadata) -> dict[str, Json]:
    """The content of `results.json`."""
    seed = header.bootstrap_seed

    def groups(key: str) -> dict[str, Json]:
        return {name: aggregate(group, seed).to_json() for name, group in by_key(rows, key).items()}

    return header.to_json(
        {
            "aggregates": aggregate(rows, seed).to_json(),
            "per_task": groups("task"),
            "per_model": groups("model"),
            "normalization": normalize_run(rows),
        }
    )


def _replay(config: RunConfig, ids: Sequence[str], observer: RunObserver) -> None:
    """Write replays of samples; the robot's meshes are simplified anew each time (some two seconds).

    A machine that can draw none, as it lets no program open a port, costs the replays, not the report.
    """
    from kinebench_drake.kinematics.plant import ArmPlant
    from kinebench_drake.models.arm import choose_robot
    from kinebench_drake.report.replay import write_replays

    options = config.stage_options()
    try:
        write_replays(config.out, ids, ArmPlant(choose_robot(options.urdf, options.tcp_frame)))
    except SetupError as error:
        observer.warn(f"there are no 3D replays: {error}")


def _report(out: Path) -> Path:
    from kinebench_drake.report import write_report

    with disk_errors(REPORT):
        return write_report(out)
