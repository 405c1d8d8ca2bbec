"""Trials: clips under conditions, measured by worker processes and stored."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import SetupError
from kinebench_drake.executors.base import Executor, MakeWorker, WorkerCrash
from kinebench_drake.executors.progress import Observer
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.evaluation.clip import TruthClip, TruthClipFile
from kinebench_drake.grounding.evaluation.errors import ClipErrors, compare, measure_expense
from kinebench_drake.grounding.evaluation.perturbation.catalogue import Perturbation, perturb
from kinebench_drake.grounding.evaluation.reframing import Reframing, reframe
from kinebench_drake.grounding.evaluation.store import MeasurementStore, fingerprint
from kinebench_drake.grounding.evaluation.variants import (
    VARIANTS,
    Degradation,
    Ground,
    VariantTools,
    degraded,
    plug_in,
)
from kinebench_drake.grounding.overrides.depth import depth_source_files
from kinebench_drake.grounding.view import Frames
from kinebench_drake.io.reader import read_video


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialCondition:
    """Change of a clip or of the pipeline under which errors are measured."""

    name: str
    """Unique name in tables."""
    variant: str = "pixels"
    """Key of `VARIANTS`."""
    perturbation: Perturbation | None = None
    """Perturbation of the frames."""
    degradation: Degradation | None = None
    """Degradation of the estimated depth."""
    plug_in: str | None = None
    """Spec of another depth estimator."""
    reframing: Reframing | None = None
    """Size and shape of the frames."""
    group: str = ""
    """Conditions of one group have one colour in figures."""

    def identity(self) -> str:
        """Return a text that is equal for equal conditions; a plug-in counts with its files, not with their paths."""
        if self.plug_in is None:
            return repr(self)
        files = fingerprint(files=depth_source_files(self.plug_in))
        return repr(replace(self, plug_in=f"{self.name} {files}"))


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundingTrial:
    """One clip under one condition."""

    clip: TruthClipFile
    condition: TrialCondition

    @property
    def key(self) -> tuple[str, str]:
        """Clip id and condition name."""
        return self.clip.id, self.condition.name


@dataclass(frozen=True, slots=True, kw_only=True)
class _LoadedClip:
    """Clip that consecutive trials share."""

    clip: TruthClip
    frames: Frames
    masks: NDArray[np.bool_]
    share: Array
    """(T,) share of the gripper's silhouette that the image shows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialWorkerFactory:
    """Creates, in each process, the function that measures trials."""

    weights: Path | None = None
    """Weights in place of those shipped."""
    seed: int = 0
    """Seed of perturbations and degradations."""
    with_depth: bool = False
    """True if some condition needs the true depth."""

    def __call__(self) -> Callable[[GroundingTrial], ClipErrors]:
        """Return the function that measures one trial.

        Raises:
            SetupError: weights, CAD model or native libraries are missing.
        """
        tools = VariantTools.load(self.weights)
        loaded: dict[str, _LoadedClip] = {}

        def measure(trial: GroundingTrial) -> ClipErrors:
            if trial.clip.id not in loaded:
                loaded.clear()
                loaded[trial.clip.id] = self._load(trial.clip, tools)
            source, condition = loaded[trial.clip.id], trial.condition
            clip, frames, share = source.clip, None, source.share
            if condition.reframing is not None:
                clip, frames, shown = reframe(condition.reframing, clip, source.frames, source.masks)
                share = np.asarray(share * shown)
            elif condition.perturbation is not None:
                frames, masks = perturb(condition.perturbation, source.frames, source.masks, self.seed, clip.id)
                shown = masks.sum(axis=(1, 2)) / np.maximum(source.masks.sum(axis=(1, 2)), 1)
                share = np.asarray(share * shown)
            return evaluate(clip, self._pipeline(condition), tools, frames=frames, share=share)

        return measure

    def _load(self, file: TruthClipFile, tools: VariantTools) -> _LoadedClip:
        clip = file.load(with_depth=self.with_depth)
        frames, masks = read_video(clip.path).frames, clip.masks(tools.cad)
        return _LoadedClip(clip=clip, frames=frames, masks=masks, share=clip.visible_share(masks, tools.cad))

    def _pipeline(self, condition: TrialCondition) -> Ground:
        if condition.plug_in is not None:
            return plug_in(condition.plug_in)
        if condition.degradation is not None:
            return degraded(condition.degradation, self.seed)
        return VARIANTS[condition.variant].ground


def evaluate(
    clip: TruthClip, ground: Ground, tools: VariantTools, *, frames: Frames | None = None, share: Array | None = None
) -> ClipErrors:
    """Ground a clip and return its errors; decoding counts as expense unless `frames` are passed."""
    grounding, expense = measure_expense(
        lambda: ground(tools, clip, read_video(clip.path).frames if frames is None else frames)
    )
    return compare(clip, grounding, expense, share)


def run_trials(
    trials: Sequence[GroundingTrial],
    factory: TrialWorkerFactory,
    executor: Executor,
    store: MeasurementStore[ClipErrors],
    observer: Observer,
    make_worker: MakeWorker[GroundingTrial, ClipErrors] | None = None,
) -> Mapping[str, list[ClipErrors]]:
    """Measure the trials that are not in the store yet.

    Returns:
        The errors of all trials by condition name, in the order of the trials.

    Raises:
        SetupError: a worker died; finished trials are stored.
    """
    weights = [factory.weights] if factory.weights else []
    base = fingerprint(factory.seed, modules=[__name__], files=weights)
    digests = {t.clip.id: t.clip.digest() for t in {t.clip.id: t for t in trials}.values()}
    conditions = {t.condition: t.condition.identity() for t in trials}
    keys = {t.key: f"{base}-{digests[t.clip.id]}-{t.clip.id}-{conditions[t.condition]}" for t in trials}
    todo = [t for t in trials if keys[t.key] not in store]
    observer.start(len(trials), len(trials) - len(todo))
    for outcome in executor.run(make_worker or factory, sorted(todo, key=lambda t: t.clip.id)):
        trial = outcome.item
        if isinstance(outcome, WorkerCrash):
            raise SetupError(
                f"{trial.clip.id}, {trial.condition.name}: {outcome.reason}; run the same command again, what is "
                "finished is kept"
            )
        store.put(keys[trial.key], outcome.result)
        observer.advance(f"{trial.clip.id}  {trial.condition.name}")
    results: dict[str, list[ClipErrors]] = {}
    for trial in trials:
        results.setdefault(trial.condition.name, []).append(store[keys[trial.key]])
    return results
