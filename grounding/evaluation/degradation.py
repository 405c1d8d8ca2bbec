"""Estimated depth made worse on purpose: a wrong scale, smooth error fields, noise."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.crop import Crop
from kinebench_drake.grounding.view import DenseEstimator, Frames, GripperView

_FIELD_CELLS = 12  # nodes of an error field across the picture: about a gripper's width apart
_FIELD_FRAMES = 8  # frames from one field to the next, between which it turns smoothly


@dataclass(frozen=True, slots=True, kw_only=True)
class Degradation:
    """How far depth is made worse; every number is relative to the depth."""

    scale: float = 0.0
    """Common error of a whole video, too long or too short by chance."""
    field: float = 0.0
    """Root mean square of an error that varies smoothly over picture and time."""
    noise: float = 0.0
    """Standard deviation of an error of each cell by itself."""


class DegradedEstimator:
    """Another estimator with its depth made worse."""

    def __init__(self, base: DenseEstimator, count: int, degradation: Degradation, rng: np.random.Generator) -> None:
        """Draw the errors for a video of `count` frames: the same state of `rng` gives the same errors."""
        self._base, self._degradation = base, degradation
        self._sign = float(rng.choice([-1.0, 1.0]))
        self._fields = rng.normal(0.0, 1.0, (-(-count // _FIELD_FRAMES) + 1, _FIELD_CELLS, _FIELD_CELLS))
        self._seed = int(rng.integers(2**32))

    def estimate(self, frames: Frames, camera: Camera, crops: Mapping[int, Crop]) -> Iterator[tuple[int, GripperView]]:
        """See `DepthEstimator`."""
        for number, view in self._base.estimate(frames, camera, crops):
            yield number, replace(view, depth_m=view.depth_m * self.factor(number, view, camera))

    def factor(self, number: int, view: GripperView, camera: Camera) -> Array:
        """What the depth of each cell (h, w) of a view of frame `number` is multiplied by."""
        h, w = view.part.shape
        noise = np.random.default_rng([self._seed, number]).normal(0.0, 1.0, (h, w))
        d = self._degradation
        errors = d.scale * self._sign + d.field * self._field(number, view, camera) + d.noise * noise
        return np.asarray(np.clip(1.0 + errors, 0.2, 5.0))

    def _field(self, number: int, view: GripperView, camera: Camera) -> Array:
        """The smooth error (h, w) at the cells of a view, of unit variance."""
        first, s = divmod(number / _FIELD_FRAMES, 1.0)
        a, b = self._fields[int(first)], self._fields[min(int(first) + 1, len(self._fields) - 1)]
        nodes = (np.cos(s * np.pi / 2) * a + np.sin(s * np.pi / 2) * b).astype(np.float32)
        smooth = np.asarray(cv2.resize(nodes, (camera.width // 4, camera.height // 4), interpolation=cv2.INTER_CUBIC))
        smooth /= max(float(smooth.std()), 1e-9)
        whole = cv2.resize(smooth, (camera.width, camera.height), interpolation=cv2.INTER_LINEAR)
        return np.asarray(view.crop.warp(np.asarray(whole), camera, view.stride), dtype=np.float64)
