"""Studies: sets of conditions to compare, their execution and their outcome."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.perception.clip import choose, find_clips
from benchmarks.perception.errors import ClipErrors
from benchmarks.perception.perturbation.catalogue import PerturbationKind, ladder
from benchmarks.perception.store import MeasurementStore, fingerprint
from benchmarks.perception.tables import compared, comparison_table
from benchmarks.perception.trial import GroundingTrial, TrialCondition, TrialWorkerFactory
from benchmarks.perception.variants import VARIANTS
from kinebench_drake.executors.base import Executor, MakeWorker, Observer
from kinebench_drake.stats import IntervalEstimate

CLEAN = TrialCondition(name="as it is")
TRUE_DEPTH = TrialCondition(name="true depth", variant="true-depth")
LEARNED = "learned"
"""End of the names of the conditions in which the learned baseline takes the place of the grounding."""
BUDGET = tuple(TrialCondition(name=v.label, variant=name) for name, v in VARIANTS.items())
"""Conditions of the error budget: each true value as prior, one at a time and all together."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyPlan:
    """Videos and settings of a study."""

    folder: Path
    """Folder of videos with ground truth."""
    weights: Path | None = None
    """Weights in place of those shipped."""
    limit: int | None = None
    """Number of videos, taken from all tasks in turn; all if None."""
    seed: int = 0
    keep: Path | None = None
    """File of finished measurements."""


def robustness(kinds: Sequence[PerturbationKind], baseline: Path) -> tuple[TrialCondition, ...]:
    """Return the conditions of unchanged frames and of each kind of perturbation at its strengths.

    The learned baseline, of the weights `baseline`, is measured on the same frames.
    """
    steps = [p for kind in kinds for p in ladder(kind)]
    conditions = [CLEAN, *(TrialCondition(name=p.label, perturbation=p) for p in steps)]
    learned = [replace(c, name=f"{c.name}, {LEARNED}", baseline=baseline) for c in conditions]
    return (TRUE_DEPTH, *(c for pair in zip(conditions, learned, strict=True) for c in pair))


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyOutcome:
    """Results of a study."""

    conditions: tuple[TrialCondition, ...]
    results: dict[str, list[ClipErrors]]
    """Errors of all clips by condition name."""
    figures: dict[str, dict[str, IntervalEstimate]]
    """Figures by condition name, see `compared`."""

    def lines(self) -> Iterator[str]:
        """Yield the comparison as lines of a table."""
        first = next(iter(self.results.values()))
        frames = sum(len(e.tracked) for e in first)
        yield f"{len(first)} videos, {frames} frames; 95 % intervals over videos"
        yield "tracked: share of the frames that show at least 30 % of the gripper; errors: of tracked frames"
        yield from comparison_table(self.figures)


def run_study(
    conditions: Sequence[TrialCondition],
    plan: StudyPlan,
    executor: Executor,
    observer: Observer,
    make_worker: MakeWorker[GroundingTrial, ClipErrors] | None = None,
) -> StudyOutcome:
    """Measure all clips under all conditions; an interrupted study resumes.

    Raises:
        UsageError: the folder holds no clips with ground truth.
        SetupError: weights or libraries are missing, or a worker died.
    """
    clips = choose(find_clips(plan.folder), plan.limit)
    trials = [GroundingTrial(clip=clip, condition=condition) for clip in clips for condition in conditions]
    needs_depth = any(VARIANTS[c.variant].needs_depth for c in conditions)
    factory = TrialWorkerFactory(weights=plan.weights, seed=plan.seed, with_depth=needs_depth)
    weights = [plan.weights] if plan.weights else []
    base = fingerprint(plan.seed, modules=[TrialWorkerFactory.__module__], files=weights)
    digests = {clip.id: clip.digest() for clip in clips}
    identities = {condition: condition.identity() for condition in conditions}

    def key(trial: GroundingTrial) -> str:
        return f"{base}-{digests[trial.clip.id]}-{trial.clip.id}-{identities[trial.condition]}"

    def label(trial: GroundingTrial) -> str:
        return f"{trial.clip.id}  {trial.condition.name}"

    store = MeasurementStore(plan.keep, ClipErrors)
    todo = sorted(trials, key=lambda t: t.clip.id)
    store.complete(todo, key, executor, make_worker or factory, observer, label)
    results: dict[str, list[ClipErrors]] = {}
    for trial in trials:
        results.setdefault(trial.condition.name, []).append(store[key(trial)])
    return StudyOutcome(conditions=tuple(conditions), results=results, figures=compared(results, plan.seed))
