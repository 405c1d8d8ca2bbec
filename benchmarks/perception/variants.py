"""Variants of the grounding pipeline: with ground truth as prior, with degraded depth, with external depth."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from benchmarks.perception.clip import TruthClip
from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.overrides.depth import DepthPlugIn
from kinebench_drake.grounding.pipeline import GroundingPipeline, PipelineResult
from kinebench_drake.grounding.priors import ExternalDepth, Priors
from kinebench_drake.grounding.tracking.confidence import load_confidence
from kinebench_drake.grounding.tracking.estimator import NetworkEstimator
from kinebench_drake.grounding.tracking.tracker import CadTracker
from kinebench_drake.grounding.tracking.view import Crop, DenseEstimator, GripperView
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.panda.cad import GripperCad
from kinebench_drake.models.perception.network import WEIGHTS, load_network

_FIELD_CELLS = 12  # nodes of an error field across the image: about a gripper's width apart
_FIELD_FRAMES = 8  # frames from one error field to the next, interpolated smoothly between


@dataclass(frozen=True, slots=True, kw_only=True)
class VariantTools:
    """Models that are loaded once and shared by all variants."""

    estimator: DenseEstimator
    cad: GripperCad
    shipped: GroundingPipeline
    """The shipped pipeline, warmed up."""

    @classmethod
    def load(cls, weights: Path | None = None) -> "VariantTools":
        """Load network, CAD model and calibration; `weights` in place of those shipped.

        Raises:
            SetupError: one of them is missing.
        """
        estimator = NetworkEstimator(load_network(weights or WEIGHTS))
        cad = GripperCad()
        pipeline = GroundingPipeline(CadTracker(estimator, cad), load_confidence())
        camera = benchmark_camera()  # the first use of the network and of the ray caster is slow
        pipeline.ground(np.zeros((2, camera.height, camera.width, 3), np.uint8), camera, np.array([0.0, 1.0]))
        return cls(estimator=estimator, cad=cad, shipped=pipeline)


Ground = Callable[[VariantTools, TruthClip, Frames], PipelineResult]
"""Function that grounds the frames of a clip."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PipelineVariant:
    """The shipped pipeline with ground truth as prior."""

    label: str
    """Name in tables."""
    mask: bool = False
    depth: bool = False
    start: bool = False
    """True if the pose in the first frame is a prior."""
    opening: bool = False
    """True if the gap between the fingers is a prior."""

    @property
    def needs_depth(self) -> bool:
        """True if the ground truth must hold depth and mask."""
        return self.mask or self.depth

    def ground(self, tools: VariantTools, clip: TruthClip, frames: Frames) -> PipelineResult:
        """Ground frames with the priors of this variant."""
        exact = ExternalDepth(depth_m=clip.depth_m, exact=True) if self.depth and clip.depth_m is not None else None
        priors = Priors(
            mask=clip.mask if self.mask else None,
            depth=exact,
            initial_state=clip.initial_state if self.start else None,
            finger_width_m=clip.finger_width_m if self.opening else None,
        )
        return tools.shipped.ground(frames, clip.camera, clip.t_s[: len(frames)], priors)


VARIANTS: Mapping[str, PipelineVariant] = {
    "pixels": PipelineVariant(label="pixels only"),
    "true-mask": PipelineVariant(label="true mask", mask=True),
    "true-depth": PipelineVariant(label="true depth", depth=True),
    "true-mask-and-depth": PipelineVariant(label="true mask and depth", mask=True, depth=True),
    "true-start": PipelineVariant(label="true start pose", start=True),
    "true-opening": PipelineVariant(label="true finger opening", opening=True),
    "all-true": PipelineVariant(label="all of these", mask=True, depth=True, start=True, opening=True),
}
"""Variants by their name on the command line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Degradation:
    """Artificial errors of the estimated depth, relative to the depth."""

    scale: float = 0.0
    """Scale error of a whole video; its sign is random."""
    field: float = 0.0
    """Root mean square of an error that varies smoothly over image and time."""
    noise: float = 0.0
    """Standard deviation of an independent error of each cell."""


class DegradedEstimator:
    """Estimator whose depth is degraded."""

    def __init__(self, base: DenseEstimator, count: int, degradation: Degradation, rng: np.random.Generator) -> None:
        """Draw the errors for a video of `count` frames; the same state of `rng` gives the same errors."""
        self._base = base
        self._degradation = degradation
        self._sign = float(rng.choice([-1.0, 1.0]))
        self._fields = rng.normal(0.0, 1.0, (-(-count // _FIELD_FRAMES) + 1, _FIELD_CELLS, _FIELD_CELLS))
        self._seed = int(rng.integers(2**32))

    def estimate(self, frames: Frames, camera: Camera, crops: Mapping[int, Crop]) -> Iterator[tuple[int, GripperView]]:
        """Yield the views of the estimator with degraded depth."""
        for number, view in self._base.estimate(frames, camera, crops):
            yield number, replace(view, depth_m=view.depth_m * self.factor(number, view, camera))

    def factor(self, number: int, view: GripperView, camera: Camera) -> Array:
        """Return the factor (h, w) of the depth of each cell of a view of frame `number`."""
        h, w = view.part.shape
        noise = np.random.default_rng([self._seed, number]).normal(0.0, 1.0, (h, w))
        d = self._degradation
        errors = d.scale * self._sign + d.field * self._field(number, view, camera) + d.noise * noise
        return np.asarray(np.clip(1.0 + errors, 0.2, 5.0))

    def _field(self, number: int, view: GripperView, camera: Camera) -> Array:
        """Return the smooth error (h, w) at the cells of a view, with unit variance."""
        first, s = divmod(number / _FIELD_FRAMES, 1.0)
        a = self._fields[int(first)]
        b = self._fields[min(int(first) + 1, len(self._fields) - 1)]
        nodes = (np.cos(s * np.pi / 2) * a + np.sin(s * np.pi / 2) * b).astype(np.float32)
        smooth = np.asarray(cv2.resize(nodes, (camera.width // 4, camera.height // 4), interpolation=cv2.INTER_CUBIC))
        smooth /= max(float(smooth.std()), 1e-9)
        whole = cv2.resize(smooth, (camera.width, camera.height), interpolation=cv2.INTER_LINEAR)
        return np.asarray(view.crop.warp(np.asarray(whole), camera, view.stride), dtype=np.float64)


def degraded(degradation: Degradation, seed: int) -> Ground:
    """Return the shipped pipeline on degraded depth; `seed` and the clip's id determine the errors."""

    def ground(tools: VariantTools, clip: TruthClip, frames: Frames) -> PipelineResult:
        rng = np.random.default_rng([seed, *clip.id.encode()])
        estimator = DegradedEstimator(tools.estimator, len(clip.t_s), degradation, rng)
        pipeline = GroundingPipeline(CadTracker(estimator, tools.cad), load_confidence())
        return pipeline.ground(frames, clip.camera, clip.t_s)

    return ground


def external(plug_in: DepthPlugIn) -> Ground:
    """Return the shipped pipeline on the depth of another estimator."""

    def ground(tools: VariantTools, clip: TruthClip, frames: Frames) -> PipelineResult:
        camera = clip.camera.resized(frames.shape[2], frames.shape[1])
        priors = Priors(depth=plug_in.estimate(frames, camera))
        return tools.shipped.ground(frames, clip.camera, clip.t_s[: len(frames)], priors)

    return ground
