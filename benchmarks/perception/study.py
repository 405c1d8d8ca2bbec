"""Studies: sets of conditions to compare, their execution and their outcome."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from benchmarks.perception.clip import choose, find_clips
from benchmarks.perception.errors import ClipErrors
from benchmarks.perception.perturbation.catalogue import PerturbationKind, ladder
from benchmarks.perception.reframing import reframings
from benchmarks.perception.store import MeasurementStore, fingerprint
from benchmarks.perception.summary import Results
from benchmarks.perception.tables import compared, comparison_table, distribution_json, intervals_json
from benchmarks.perception.trial import GroundingTrial, TrialCondition, TrialWorkerFactory
from benchmarks.perception.variants import VARIANTS, Degradation
from kinebench_drake.errors import UsageError
from kinebench_drake.executors.base import Executor, MakeWorker, Observer
from kinebench_drake.grounding.overrides.depth import DepthPlugIn
from kinebench_drake.stats import IntervalEstimate

CLEAN = TrialCondition(name="as it is")
LEARNED = "learned"
"""Group of the conditions in which the learned baseline takes the place of the grounding."""
_DEGRADATIONS = {
    "scale": tuple(Degradation(scale=s) for s in (0.02, 0.05, 0.10)),
    "smooth error": tuple(Degradation(field=s) for s in (0.02, 0.05, 0.10)),
    "noise": tuple(Degradation(noise=s) for s in (0.02, 0.05, 0.10)),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundingStudy:
    """Conditions to compare."""

    name: str
    """Name in files."""
    title: str
    conditions: tuple[TrialCondition, ...]
    required: tuple[str, ...] = ()
    """Names of the conditions that the grounding is required to tolerate."""

    @property
    def needs_depth(self) -> bool:
        """True if the ground truth must hold depth and mask."""
        return any(VARIANTS[c.variant].needs_depth for c in self.conditions)


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


def evaluation(variant: str) -> GroundingStudy:
    """Return the study of a single pipeline of `VARIANTS`.

    Raises:
        UsageError: there is no such pipeline.
    """
    if variant not in VARIANTS:
        raise UsageError(f"pipeline {variant!r} is not known; there are {', '.join(VARIANTS)}")
    name = VARIANTS[variant].label
    return GroundingStudy(name="evaluation", title=name, conditions=(TrialCondition(name=name, variant=variant),))


def robustness(kinds: Sequence[PerturbationKind], baseline: Path | None = None) -> GroundingStudy:
    """Return the study of unchanged frames and of each kind of perturbation at its strengths.

    With the weights `baseline`, the learned baseline is measured on the same frames.
    """
    steps = [p for kind in kinds for p in ladder(kind)]
    conditions = [CLEAN, *(TrialCondition(name=p.label, perturbation=p, group=p.kind.value) for p in steps)]
    if baseline is not None:
        learned = [replace(c, name=f"{c.name}, {LEARNED}", baseline=baseline, group=LEARNED) for c in conditions]
        conditions = [c for pair in zip(conditions, learned, strict=True) for c in pair]
    return GroundingStudy(
        name="robustness",
        title="Pose errors under perturbations",
        conditions=tuple(conditions),
        required=tuple(p.label for p in steps if p.is_required),
    )


def framing() -> GroundingStudy:
    """Return the study of unchanged frames and of the sizes and shapes of video models."""
    others = (TrialCondition(name=r.label, reframing=r, group=r.way) for r in reframings())
    return GroundingStudy(name="framing", title="Pose errors in other sizes and shapes", conditions=(CLEAN, *others))


def depth_ablation(plug_ins: Sequence[str]) -> GroundingStudy:
    """Return the study of true depth, estimated depth, degraded depth and other depth estimators.

    Raises:
        UsageError: an estimator is not available.
    """
    conditions = [
        TrialCondition(name="true depth", variant="true-depth", group="true depth"),
        TrialCondition(name="our estimate", group="our estimate"),
    ]
    for kind, levels in _DEGRADATIONS.items():
        for level in levels:
            name = f"{kind} {max(level.scale, level.field, level.noise):.0%}"
            conditions.append(TrialCondition(name=name, degradation=level, group=kind))
    for spec in plug_ins:
        plug_in = DepthPlugIn(spec)
        plug_in.check()
        conditions.append(TrialCondition(name=plug_in.name, plug_in=plug_in, group=plug_in.name))
    return GroundingStudy(
        name="depth-ablation", title="Pose errors with depth of graded quality", conditions=tuple(conditions)
    )


def budget() -> GroundingStudy:
    """Return the study of the error budget: each true value as prior, one at a time and all together."""
    conditions = tuple(TrialCondition(name=v.label, variant=name, group=v.label) for name, v in VARIANTS.items())
    return GroundingStudy(name="budget", title="Pose errors with true values put in", conditions=conditions)


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyOutcome:
    """Results of a study."""

    study: GroundingStudy
    results: dict[str, list[ClipErrors]]
    """Errors of all clips by condition name."""
    figures: dict[str, dict[str, IntervalEstimate]]
    """Figures by condition name, see `compared`."""

    def lines(self) -> Iterator[str]:
        """Yield the comparison as lines of a table."""
        first: Results = next(iter(self.results.values()))
        frames = sum(len(e.tracked) for e in first)
        yield f"{self.study.title}: {len(first)} videos, {frames} frames; 95 % intervals over videos"
        yield "tracked: share of the frames that show at least 30 % of the gripper; errors: of tracked frames"
        yield from comparison_table(self.figures, self.study.required)
        if self.study.required:
            yield "* strength that the grounding is required to tolerate"

    def to_json(self) -> dict[str, Any]:
        """Return the comparison as a JSON object."""
        return {
            "study": self.study.name,
            "title": self.study.title,
            "videos": [e.id for e in next(iter(self.results.values()))],
            "conditions": {name: intervals_json(row) for name, row in self.figures.items()},
            "distributions": {
                condition.name: {"group": condition.group, **distribution_json(self.results[condition.name])}
                for condition in self.study.conditions
            },
            "required": list(self.study.required),
        }


def run_study(
    study: GroundingStudy,
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
    if not study.conditions:
        raise UsageError("there is nothing to compare; name at least one condition")
    trials = [GroundingTrial(clip=clip, condition=condition) for clip in clips for condition in study.conditions]
    factory = TrialWorkerFactory(weights=plan.weights, seed=plan.seed, with_depth=study.needs_depth)
    weights = [plan.weights] if plan.weights else []
    base = fingerprint(plan.seed, modules=[TrialWorkerFactory.__module__], files=weights)
    digests = {clip.id: clip.digest() for clip in clips}
    conditions = {condition: condition.identity() for condition in study.conditions}

    def key(trial: GroundingTrial) -> str:
        return f"{base}-{digests[trial.clip.id]}-{trial.clip.id}-{conditions[trial.condition]}"

    def label(trial: GroundingTrial) -> str:
        return f"{trial.clip.id}  {trial.condition.name}"

    store = MeasurementStore(plan.keep, ClipErrors)
    todo = sorted(trials, key=lambda t: t.clip.id)
    store.complete(todo, key, executor, make_worker or factory, observer, label)
    results: dict[str, list[ClipErrors]] = {}
    for trial in trials:
        results.setdefault(trial.condition.name, []).append(store[key(trial)])
    return StudyOutcome(study=study, results=results, figures=compared(results, plan.seed))
