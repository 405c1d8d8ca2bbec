"""Trials: clips under conditions, measured by worker processes."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.grounding.evaluation.clip import TruthClip, TruthClipFile
from kinebench_drake.grounding.evaluation.errors import ClipErrors, compare, measure_expense
from kinebench_drake.grounding.evaluation.perturbation.catalogue import Perturbation, perturb
from kinebench_drake.grounding.evaluation.reframing import Reframing, reframe
from kinebench_drake.grounding.evaluation.store import fingerprint
from kinebench_drake.grounding.evaluation.variants import (
    VARIANTS,
    Degradation,
    Ground,
    VariantTools,
    degraded,
    external,
)
from kinebench_drake.grounding.overrides.depth import DepthPlugIn
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
    plug_in: DepthPlugIn | None = None
    """Another depth estimator."""
    reframing: Reframing | None = None
    """Size and shape of the frames."""
    group: str = ""
    """Conditions of one group have one colour in figures."""

    def identity(self) -> str:
        """Return a text that is equal for equal conditions; a plug-in counts with its files, not with their paths."""
        if self.plug_in is None:
            return repr(self)
        return repr(replace(self, plug_in=DepthPlugIn(f"{self.name} {fingerprint(files=self.plug_in.files)}")))


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundingTrial:
    """One clip under one condition."""

    clip: TruthClipFile
    condition: TrialCondition


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
            return external(condition.plug_in)
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
