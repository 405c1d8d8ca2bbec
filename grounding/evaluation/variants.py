"""The pipelines that are held against each other, by name: as shipped, and with something known beforehand."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinebench_drake.grounding.confidence import Confidence
from kinebench_drake.grounding.estimator import NetworkEstimator
from kinebench_drake.grounding.evaluation.clip import TruthClip
from kinebench_drake.grounding.evaluation.degradation import Degradation, DegradedEstimator
from kinebench_drake.grounding.overrides.depth import check_depth_source, estimate_depth
from kinebench_drake.grounding.pipeline import GroundingPipeline, GroundingResult
from kinebench_drake.grounding.tracker import CadTracker
from kinebench_drake.grounding.view import DenseEstimator, Frames
from kinebench_drake.models.panda.cad import GripperCad
from kinebench_drake.models.perception.weights import WEIGHTS, load_network
from kinebench_drake.types import ExternalDepth, Priors


@dataclass(frozen=True, slots=True, kw_only=True)
class VariantTools:
    """What is loaded once and serves every clip."""

    estimator: DenseEstimator
    cad: GripperCad
    confidence: Confidence
    shipped: GroundingPipeline
    """The pipeline of these, warmed up."""

    @classmethod
    def load(cls, weights: Path | None = None) -> "VariantTools":
        """Load network, CAD model and calibration; `weights` in place of those shipped.

        Raises:
            SetupError: one of them is missing.
        """
        estimator, cad = NetworkEstimator(load_network(weights or WEIGHTS)), GripperCad()
        confidence = Confidence.load()
        pipeline = GroundingPipeline(CadTracker(estimator, cad), confidence)
        pipeline.warm_up()
        return cls(estimator=estimator, cad=cad, confidence=confidence, shipped=pipeline)

    def pipeline(self, estimator: DenseEstimator) -> GroundingPipeline:
        """The shipped pipeline with another estimator."""
        return GroundingPipeline(CadTracker(estimator, self.cad), self.confidence)


Know = Callable[[TruthClip], Priors]
Ground = Callable[[Frames], GroundingResult]
"""What grounds the frames of one video."""
Make = Callable[[VariantTools, TruthClip], Ground]
"""Makes it for a clip."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PipelineVariant:
    """The shipped pipeline with something known beforehand."""

    label: str
    """What stands in tables."""
    know: Know
    """What is known of a clip."""
    needs_depth: bool = False
    """Whether the clip's truth must hold depth and mask."""

    def make(self, tools: VariantTools, clip: TruthClip) -> Ground:
        """See `Make`."""
        known = self.know(clip)
        return lambda frames: tools.shipped.ground(frames, clip.camera, clip.t_s[: len(frames)], known)


def _true(*, mask: bool = False, depth: bool = False, first: bool = False, opening: bool = False) -> Know:
    def know(clip: TruthClip) -> Priors:
        return Priors(
            mask=clip.mask if mask else None,
            depth=ExternalDepth(depth_m=clip.depth_m, exact=True) if depth and clip.depth_m is not None else None,
            initial_state=clip.initial_state if first else None,
            finger_width_m=clip.finger_width_m if opening else None,
        )

    return know


VARIANTS: Mapping[str, PipelineVariant] = {
    "pixels": PipelineVariant(label="pixels only", know=_true()),
    "true-mask": PipelineVariant(label="true mask", know=_true(mask=True), needs_depth=True),
    "true-depth": PipelineVariant(label="true depth", know=_true(depth=True), needs_depth=True),
    "true-mask-and-depth": PipelineVariant(
        label="true mask and depth", know=_true(mask=True, depth=True), needs_depth=True
    ),
    "true-start": PipelineVariant(label="true start pose", know=_true(first=True)),
    "true-opening": PipelineVariant(label="true finger opening", know=_true(opening=True)),
    "all-true": PipelineVariant(
        label="all of these", know=_true(mask=True, depth=True, first=True, opening=True), needs_depth=True
    ),
}
"""Pipelines by name."""


def degraded(degradation: Degradation, seed: int) -> Make:
    """The shipped pipeline on depth made worse; `seed` draws how."""

    def make(tools: VariantTools, clip: TruthClip) -> Ground:
        rng = np.random.default_rng([seed, *clip.id.encode()])
        pipeline = tools.pipeline(DegradedEstimator(tools.estimator, len(clip.t_s), degradation, rng))
        return lambda frames: pipeline.ground(frames, clip.camera, clip.t_s)

    return make


def plug_in(spec: str) -> Make:
    """The shipped pipeline on depth of another estimator, `moge:CHECKPOINT` or `module:Class`.

    Raises:
        UsageError: there is no such estimator.
    """
    check_depth_source(spec)

    def make(tools: VariantTools, clip: TruthClip) -> Ground:
        def ground(frames: Frames) -> GroundingResult:
            camera = clip.camera.resized(frames.shape[2], frames.shape[1])
            known = Priors(depth=estimate_depth(spec, frames, camera))
            return tools.shipped.ground(frames, clip.camera, clip.t_s[: len(frames)], known)

        return ground

    return make
