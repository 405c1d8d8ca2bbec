"""The main job: videos to tracks to metrics to an output folder. `ground` is the same job without the kinematics."""

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from kinebench_drake.aggregate import Estimate, aggregate, by_key, estimate
from kinebench_drake.engines import Crashed, EngineKind, create_engine
from kinebench_drake.errors import UsageError
from kinebench_drake.inputs import Inputs, Sample, Shard, find_samples
from kinebench_drake.measure import BENCHMARK_PERIOD_S, SCHEMA_VERSION, Kind, Measure, PeriodSource
from kinebench_drake.provenance import host, versions, weights_hash
from kinebench_drake.results import REPORT, ResultStore, storage
from kinebench_drake.row import Json, SampleRow, Status


@dataclass(frozen=True, slots=True, kw_only=True)
class RunConfig:
    """Everything a run is told."""

    source: Path
    """Video, folder, npy/npz file or manifest."""
    out: Path
    """Output folder, made if absent."""
    kind: Kind = Kind.SCORE
    limit: int | None = None
    """Work on the first so many samples only."""
    shard: Shard | None = None
    """Work on this part of the samples only."""
    jobs: int = 1
    """Worker processes."""
    engine: EngineKind = EngineKind.LOCAL
    overwrite: bool = False
    """Forget what `out` holds instead of going on from there."""
    seed: int = 0
    """Seed of the intervals' resampling."""
    model: str | None = None
    """Model of samples that name none."""
    task: str | None = None
    """Task of samples that name none."""
    tags: Mapping[str, str] = field(default_factory=dict)
    """Free labels, kept in the results."""
    frame_period_s: float | None = None
    """Task time between two frames [s]."""
    overlay: bool = False
    """Write overlays/ID.mp4."""
    stages: str = "kinebench_drake.drake_stages:DrakeStages"
    """Import path of the heavy steps."""

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            UsageError: one of them makes no sense.
        """
        if self.limit is not None and self.limit < 1:
            raise UsageError(f"--limit is {self.limit}, expected 1 or more")
        if self.seed < 0:
            raise UsageError(f"--seed is {self.seed}, expected 0 or more")
        if self.frame_period_s is not None and not 0.0 < self.frame_period_s < float("inf"):
            raise UsageError(f"--frame-period is {self.frame_period_s}, expected seconds above 0, such as 0.2")

    def to_json(self) -> dict[str, Json]:
        """What results tell of the configuration; paths by their last name only."""
        return {
            "kind": self.kind.value,
            "source": self.source.resolve().name,
            "limit": self.limit,
            "shard": f"{self.shard.index}/{self.shard.count}" if self.shard else None,
            "jobs": self.jobs,
            "engine": self.engine.value,
            "seed": self.seed,
            "model": self.model,
            "task": self.task,
            "frame_period_s": self.frame_period_s,
            "overlay": self.overlay,
        }


class Observer(Protocol):
    """Who wants to hear how a run goes."""

    def warned(self, message: str) -> None:
        """Something the user should know."""
        ...

    def started(self, total: int, kept: int) -> None:
        """So many samples are to be done in all, of which so many are done from before."""
        ...

    def finished(self, row: SampleRow, wall_s: float) -> None:
        """One more sample is done and on disk."""
        ...


class Silence:
    """An `Observer` that does not care."""

    def warned(self, message: str) -> None:
        """Ignore it."""

    def started(self, total: int, kept: int) -> None:
        """Ignore it."""

    def finished(self, row: SampleRow, wall_s: float) -> None:
        """Ignore it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSummary:
    """How a run ended."""

    counts: Mapping[Status, int]
    """Samples of each status in the output folder."""
    feasible: Estimate | None
    """Share of the measured samples that the robot can do; None where none was judged."""
    report: Path | None
    """The html report; None for kinds that have none."""


def score_videos(config: RunConfig, observer: Observer | None = None) -> RunSummary:
    """Measure every video of `config.source` and fill the output folder.

    Samples whose results are there already, from the same bytes and settings, are kept. A sample that fails is a row
    like any other.

    Raises:
        UsageError: the configuration, the input or the output folder cannot be used.
        SetupError: something is missing on this machine, or the disk is full. What was finished is kept.
    """
    observer = observer or Silence()
    engine = create_engine(config.engine, config.jobs)
    inputs = find_samples(config.source, out=config.out, model=config.model, task=config.task)
    for warning in inputs.warnings:
        observer.warned(warning)
    measure = Measure(
        kind=config.kind,
        out=config.out,
        frame_period_s=config.frame_period_s,
        overlay=config.overlay,
        stages=config.stages,
    )
    chosen = list(inputs.samples[: config.limit])
    chosen = config.shard.take(chosen) if config.shard else chosen
    with ResultStore(config.out, overwrite=config.overwrite) as store:
        waiting = _resume(store, inputs, chosen, measure, observer)
        observer.started(total=len(chosen), kept=len(chosen) - len(waiting))
        with closing(engine.run(measure.make, waiting)) as outcomes:
            for outcome in outcomes:
                if isinstance(outcome, Crashed):
                    row, wall_s = measure.failed(outcome.item, Status.ERROR, outcome.reason), 0.0
                else:
                    row, wall_s = outcome.result
                store.append(row, wall_s)
                observer.finished(row, wall_s)
        rows = [store.rows[id] for id in sorted(store.rows)]
        store.finish(summarize(rows, config, found=len(inputs.samples)))
        report = _report(config) if config.kind is Kind.SCORE else None
    clockless = sum(row.extra.get("frame_period_source") == PeriodSource.BENCHMARK.value for row in rows)
    if clockless:
        observer.warned(
            f"{clockless} samples have no frame rate: {BENCHMARK_PERIOD_S} s between frames was taken, as in the "
            "benchmark; give --frame-period SECONDS if it is not so"
        )
    counts = {status: sum(row.status is status for row in rows) for status in Status}
    feasible = estimate([r.feasible for r in rows if r.status is Status.OK], total=len(rows), seed=config.seed)
    return RunSummary(counts=counts, feasible=feasible if feasible.n else None, report=report)


def summarize(rows: list[SampleRow], config: RunConfig, found: int) -> dict[str, Json]:
    """The content of `results.json`."""

    def groups(key: str) -> dict[str, Json]:
        return {name: aggregate(group, config.seed).to_json() for name, group in by_key(rows, key).items()}

    return {
        "schema_version": SCHEMA_VERSION,
        "suite_version": None,
        "kind": config.kind.value,
        "samples_found": found,
        "aggregates": aggregate(rows, config.seed).to_json(),
        "per_task": groups("task"),
        "per_model": groups("model"),
        "config": config.to_json(),
        "tags": dict(sorted(config.tags.items())),
        "seeds": {"bootstrap": config.seed},
        "versions": versions(),
        "weights_sha256": weights_hash(),
        "host": host(),
    }


def _resume(
    store: ResultStore, inputs: Inputs, chosen: list[Sample], measure: Measure, observer: Observer
) -> list[Sample]:
    """Drop kept rows that no longer hold; return the samples still to do."""
    known = {sample.id: sample for sample in inputs.samples}
    if store.rows and not known.keys() & store.rows.keys():
        raise UsageError(
            f"--out {store.out}: holds results of other videos (such as {min(store.rows)!r}); name another folder, "
            "or give --overwrite to drop them"
        )
    strangers = sorted(store.rows.keys() - known.keys())
    if strangers:
        observer.warned(
            f"{len(strangers)} earlier results are dropped, their videos are gone (such as {strangers[0]!r})"
        )
    waiting = {s.id: s for s in chosen if not measure.is_finished(s, store.rows.get(s.id))}
    store.keep(lambda row: row.id in known and row.id not in waiting)
    return list(waiting.values())


def _report(config: RunConfig) -> Path:
    from kinebench_drake.report import write_report

    with storage(REPORT):
        return write_report(config.out)
