"""The pipelines that are held against each other, by name: as shipped, and with stages replaced.

A pipeline that replaces stages is one more entry of `VARIANTS`: a function from what is loaded and a clip to something
that grounds it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.errors import UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.confidence import Confidence
from kinebench_drake.grounding.estimator import NetworkEstimator
from kinebench_drake.grounding.evaluation.clip import Clip
from kinebench_drake.grounding.evaluation.degradation import Degradation, DegradedEstimator
from kinebench_drake.grounding.given import GivenEstimator
from kinebench_drake.grounding.pipeline import Grounding, GroundingPipeline
from kinebench_drake.grounding.tracker import CadTracker
from kinebench_drake.grounding.view import DepthEstimator, Frames
from kinebench_drake.models.panda.cad import GripperCad
from kinebench_drake.models.perception.weights import WEIGHTS, load_network


class Grounder(Protocol):
    """What grounds a video: the pipeline here, or another program's."""

    def ground(self, frames: Frames, camera: Camera, t_s: Array) -> Grounding:
        """See `GroundingPipeline.ground`."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Tools:
    """What is loaded once and serves every clip."""

    estimator: DepthEstimator
    cad: GripperCad
    confidence: Confidence
    shipped: GroundingPipeline
    """The pipeline of these, warmed up."""

    @classmethod
    def load(cls, weights: Path | None = None) -> "Tools":
        """Load network, CAD model and calibration; `weights` in place of those shipped.

        Raises:
            SetupError: one of them is missing.
        """
        estimator, cad = NetworkEstimator(load_network(weights or WEIGHTS)), GripperCad()
        confidence = Confidence.load()
        pipeline = GroundingPipeline(CadTracker(estimator, cad), confidence)
        pipeline.warm_up()
        return cls(estimator=estimator, cad=cad, confidence=confidence, shipped=pipeline)

    def pipeline(self, estimator: DepthEstimator, *, trust_depth: bool = False) -> GroundingPipeline:
        """The shipped pipeline with another estimator."""
        tracker = CadTracker(estimator, self.cad, trust_depth=trust_depth)
        return GroundingPipeline(tracker, self.confidence)


Make = Callable[[Tools, Clip, Frames], Grounder]


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant:
    """A named pipeline."""

    label: str
    """What stands in tables."""
    make: Make | None
    """Makes it for a clip and its frames; None for one that is not available."""
    needs_depth: bool = False
    """Whether the clip's truth must hold depth and mask."""


def _pixels(tools: Tools, clip: Clip, frames: Frames) -> Grounder:
    return tools.shipped


def _given(*, mask: bool = False, depth: bool = False) -> Make:
    def make(tools: Tools, clip: Clip, frames: Frames) -> Grounder:
        estimator = GivenEstimator(
            tools.estimator, mask=clip.mask if mask else None, depth_m=clip.depth_m if depth else None
        )
        return tools.pipeline(estimator, trust_depth=depth)

    return make


VARIANTS: Mapping[str, Variant] = {
    "pixels": Variant(label="pixels only", make=_pixels),
    "true-mask": Variant(label="true mask", make=_given(mask=True), needs_depth=True),
    "true-depth": Variant(label="true depth", make=_given(depth=True), needs_depth=True),
    "true-mask-and-depth": Variant(label="true mask and depth", make=_given(mask=True, depth=True), needs_depth=True),
    "true-start": Variant(label="true start pose", make=None, needs_depth=True),
    "true-opening": Variant(label="true finger opening", make=None),
    "all-true": Variant(label="all of these", make=None, needs_depth=True),
}
"""Pipelines by name."""


def degraded(degradation: Degradation, seed: int) -> Make:
    """The shipped pipeline on depth made worse; `seed` draws how."""

    def make(tools: Tools, clip: Clip, frames: Frames) -> Grounder:
        rng = np.random.default_rng([seed, *clip.id.encode()])
        return tools.pipeline(DegradedEstimator(tools.estimator, len(frames), degradation, rng))

    return make


def plug_in(spec: str) -> Make:
    """The pipeline on depth of another estimator, such as `moge:CHECKPOINT`.

    Raises:
        UsageError: there is no such estimator.
    """
    raise UsageError(f"--depth {spec}: no such depth estimator is available here")
