"""The studies: which conditions are held against each other, and what is told of the outcome."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kinebench_drake.errors import UsageError
from kinebench_drake.executors.base import Executor
from kinebench_drake.executors.progress import Observer
from kinebench_drake.grounding.evaluation.clip import TruthClipFile, choose, find_clips
from kinebench_drake.grounding.evaluation.degradation import Degradation
from kinebench_drake.grounding.evaluation.errors import ClipErrors
from kinebench_drake.grounding.evaluation.perturbation.catalogue import PerturbationKind, ladder
from kinebench_drake.grounding.evaluation.reframed import reframings
from kinebench_drake.grounding.evaluation.store import TrialStore
from kinebench_drake.grounding.evaluation.summary import PercentileInterval, Results
from kinebench_drake.grounding.evaluation.tables import compared, comparison_table, intervals_json
from kinebench_drake.grounding.evaluation.trial import (
    GroundingTrial,
    MakeWorker,
    TrialCondition,
    TrialRunner,
    run,
)
from kinebench_drake.grounding.evaluation.variants import VARIANTS, plug_in
from kinebench_drake.grounding.overrides.depth import depth_source_name

CLEAN = TrialCondition(name="as it is")
_DEGRADED = {
    "scale": tuple(Degradation(scale=s) for s in (0.02, 0.05, 0.10)),
    "smooth error": tuple(Degradation(field=s) for s in (0.02, 0.05, 0.10)),
    "noise": tuple(Degradation(noise=s) for s in (0.02, 0.05, 0.10)),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundingStudy:
    """Conditions to be held against each other."""

    title: str
    conditions: tuple[TrialCondition, ...]
    groups: dict[str, str]
    """What each condition belongs to, by name."""
    marks: tuple[str, ...] = ()
    """Conditions that the grounding promises to bear."""

    @property
    def needs_depth(self) -> bool:
        """Whether clips must come with depth and mask."""
        return any(VARIANTS[c.variant].needs_depth for c in self.conditions)


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyPlan:
    """How a study is carried out."""

    folder: Path
    """Videos with their truth."""
    weights: Path | None = None
    """Weights in place of those shipped."""
    limit: int | None = None
    """So many videos only, tasks in turn."""
    seed: int = 0
    keep: Path | None = None
    """Where finished measurements are kept."""

    def clips(self) -> list[TruthClipFile]:
        """The videos.

        Raises:
            UsageError: there are none, or no truth.
        """
        return choose(find_clips(self.folder), self.limit)


def evaluation(variant: str) -> GroundingStudy:
    """One pipeline of `VARIANTS` by itself.

    Raises:
        UsageError: there is none of this name.
    """
    if variant not in VARIANTS:
        raise UsageError(f"pipeline {variant!r} is not known; there are {', '.join(VARIANTS)}")
    name = VARIANTS[variant].label
    return GroundingStudy(title=name, conditions=(TrialCondition(name=name, variant=variant),), groups={name: name})


def robustness(kinds: Sequence[PerturbationKind]) -> GroundingStudy:
    """The frames as they are, and each kind of perturbation at its strengths."""
    steps = [p for kind in kinds for p in ladder(kind)]
    conditions = (CLEAN, *(TrialCondition(name=p.label, perturbation=p) for p in steps))
    return GroundingStudy(
        title="Pose errors under perturbations",
        conditions=conditions,
        groups={CLEAN.name: "", **{p.label: p.kind.value for p in steps}},
        marks=tuple(p.label for p in steps if p.must_be_borne),
    )


def framing() -> GroundingStudy:
    """The frames as they are, and shown in the sizes and shapes of video models."""
    others = reframings()
    return GroundingStudy(
        title="Pose errors in other sizes and shapes",
        conditions=(CLEAN, *(TrialCondition(name=other.label, reframing=other) for other in others)),
        groups={CLEAN.name: "", **{other.label: other.way for other in others}},
    )


def depth_ablation(plug_ins: Sequence[str]) -> GroundingStudy:
    """True depth, the estimate, the estimate made worse, and other estimators.

    Raises:
        UsageError: an estimator is not available.
    """
    conditions = [TrialCondition(name="true depth", variant="true-depth"), TrialCondition(name="our estimate")]
    groups = {c.name: c.name for c in conditions}
    for what, levels in _DEGRADED.items():
        for level in levels:
            name = f"{what} {max(level.scale, level.field, level.noise):.0%}"
            conditions.append(TrialCondition(name=name, degradation=level))
            groups[name] = what
    for spec in plug_ins:
        plug_in(spec)
        name = depth_source_name(spec)
        conditions.append(TrialCondition(name=name, plug_in=spec))
        groups[name] = name
    title = "Pose errors with depth of graded quality"
    return GroundingStudy(title=title, conditions=tuple(conditions), groups=groups)


def budget() -> GroundingStudy:
    """What each stage owes: true values put in one at a time, and all together."""
    conditions = tuple(TrialCondition(name=variant.label, variant=name) for name, variant in VARIANTS.items())
    return GroundingStudy(
        title="Pose errors with true values put in",
        conditions=conditions,
        groups={c.name: c.name for c in conditions},
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyOutcome:
    """What came of a study."""

    study: GroundingStudy
    results: dict[str, list[ClipErrors]]
    """Clips by condition."""
    figures: dict[str, dict[str, PercentileInterval]]
    """Figures by condition, as `compared` gives them."""

    def lines(self) -> Iterator[str]:
        """The comparison as a table."""
        first: Results = next(iter(self.results.values()))
        frames = sum(len(e.tracked) for e in first)
        yield f"{self.study.title}: {len(first)} videos, {frames} frames; 95 % intervals over videos"
        yield "tracked: share of the frames that show at least 30 % of the gripper; errors: of tracked frames"
        yield from comparison_table(self.figures, self.study.marks)
        if self.study.marks:
            yield "* strength that the grounding has to bear"

    def to_json(self) -> dict[str, Any]:
        """The same as a JSON object."""
        return {
            "title": self.study.title,
            "videos": [e.id for e in next(iter(self.results.values()))],
            "conditions": {name: intervals_json(row) for name, row in self.figures.items()},
            "to_be_borne": list(self.study.marks),
        }


def carry_out(
    study: GroundingStudy,
    plan: StudyPlan,
    engine: Executor,
    observer: Observer,
    make_worker: MakeWorker | None = None,
) -> StudyOutcome:
    """Measure all clips under all conditions, going on where a run before was stopped.

    Raises:
        UsageError: the folder holds no clips with truth.
        SetupError: weights or libraries are missing, or a worker died.
    """
    clips = plan.clips()
    if not study.conditions:
        raise UsageError("there is nothing to compare; name at least one condition")
    trials = [GroundingTrial(clip=clip, condition=condition) for clip in clips for condition in study.conditions]
    workshop = TrialRunner(weights=plan.weights, seed=plan.seed, with_depth=study.needs_depth)
    results = run(trials, workshop, engine, TrialStore(plan.keep), observer, make_worker)
    return StudyOutcome(study=study, results=dict(results), figures=compared(results, plan.seed))
