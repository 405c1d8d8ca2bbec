"""Dense estimates of one crop (part labels, metric depth, CAD coordinates on a grid of cells), and their overrides."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.priors import ExternalDepth, Priors
from kinebench_drake.grounding.tracking.crop import Crop
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.panda.description import GRIPPER, OPENING_SIGN, RobotPart

_EXACT_SIGMA = 1e-3
"""Relative standard deviation of exact depth, which is stored in whole millimetres."""
_EXACT_FACTOR_SIGMA = 1e-4
"""Relative standard deviation of its factor."""
_ESTIMATE_SIGMA = 0.02
"""Relative standard deviation of depth by an estimator of unknown accuracy."""
_ESTIMATE_FACTOR_SIGMA = 0.1
"""Relative standard deviation of its factor."""
_CALIBRATED_FACTOR_SIGMA = 0.03
"""The same of depth that was scaled in one frame: the factor drifts along a video."""
OPENING_SIGNS = np.array([OPENING_SIGN.get(part, 0.0) for part in RobotPart])
"""(PARTS,) `OPENING_SIGN` by value of `RobotPart`; 0 where a part does not move along the hand."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GripperView:
    """Dense estimates of one crop on a grid of h x w cells, every `stride`-th pixel of the crop."""

    crop: Crop
    stride: int
    in_image: NDArray[np.bool_]
    """(h, w) cells inside the camera image; outside, a gripper cut by the image border goes on unseen."""
    part: NDArray[np.uint8]
    """(h, w) values of `RobotPart`."""
    depth_m: Array
    """(h, w) depth along the crop's optical axis [m]."""
    depth_sigma: Array
    """(h, w) relative standard deviation of the depth."""
    depth_factor_sigma: float
    """Relative standard deviation of the depth error that all cells have in common."""
    coordinates_P: Array
    """(h, w, 3) CAD coordinates of the surface point [m]: of the gripper in the hand frame with closed fingers, of a
    link in the link's frame."""
    coordinates_sigma_m: Array
    """(h, w) standard deviation of each CAD coordinate [m]."""

    @property
    def gripper(self) -> NDArray[np.bool_]:
        """(h, w) cells that show hand or fingers."""
        return (self.part >= GRIPPER[0]) & (self.part <= GRIPPER[-1])

    @property
    def arm(self) -> NDArray[np.bool_]:
        """(h, w) cells that show a link of the arm."""
        return self.part >= RobotPart.LINK0

    @property
    def opening_sign(self) -> Array:
        """(h, w) direction along the hand's y axis as the fingers open: 1 (left finger), -1 (right finger) or 0."""
        return OPENING_SIGNS[self.part]

    def rays(self) -> Array:
        """Return the viewing directions (h, w, 3) of the cells in the crop's frame, scaled to z = 1."""
        return self.crop.rays(self.stride)

    def rays_at(self, v: NDArray[np.intp], u: NDArray[np.intp]) -> Array:
        """Return the viewing directions (N, 3) of the cells in rows `v` and columns `u`, like `rays`."""
        centre = self.crop.size / 2
        columns = [((index + 0.5) * self.stride - centre) / self.crop.focal for index in (u, v)]
        return np.column_stack([*columns, np.ones(len(u))])

    def to_frame(self, cells: NDArray[np.bool_], camera: Camera) -> NDArray[np.bool_]:
        """Return the pixels (H, W) of the camera image that are covered by `cells` (h, w)."""
        return self.crop.unwarp(cells.astype(np.uint8), camera, self.stride) > 0


class DenseEstimator(Protocol):
    """Source of dense estimates: the trained network, ground truth, or another model."""

    def estimate(self, frames: Frames, camera: Camera, crops: Mapping[int, Crop]) -> Iterator[tuple[int, GripperView]]:
        """Yield frame number and view of each of the `crops`, by frame number, of a video, in any order."""
        ...


class OverrideEstimator:
    """Estimator with its mask, its depth or both replaced by priors."""

    def __init__(self, base: DenseEstimator, priors: Priors) -> None:
        """Replace the estimates of `base` by those in `priors`."""
        self._base = base
        self._priors = priors

    def estimate(self, frames: Frames, camera: Camera, crops: Mapping[int, Crop]) -> Iterator[tuple[int, GripperView]]:
        """Estimate one view per crop, like `DenseEstimator.estimate`."""
        for number, view in self._base.estimate(frames, camera, crops):
            if self._priors.mask is not None:
                view = replace_mask(view, self._priors.mask[number], camera)
            if self._priors.depth is not None:
                view = replace_depth(view, self._priors.depth, number, camera)
            yield number, view


def replace_mask(view: GripperView, mask: NDArray[np.bool_], camera: Camera) -> GripperView:
    """Return the view with the gripper where `mask` (H, W) is true; which part a cell shows remains estimated."""
    in_mask = np.asarray(view.crop.warp(mask.astype(np.uint8), camera, view.stride, nearest=True)) > 0
    gripper = np.where(view.gripper, view.part, RobotPart.HAND)
    other = np.where(view.gripper, RobotPart.BACKGROUND, view.part)
    return replace(view, part=np.where(in_mask, gripper, other).astype(np.uint8))


def replace_depth(view: GripperView, depth: ExternalDepth, number: int, camera: Camera) -> GripperView:
    """Return the view with the depth of frame `number` in the cells that have one."""
    crop = view.crop
    depth_m = np.nan_to_num(depth.depth_m[number].astype(np.float32), nan=0.0, posinf=0.0)
    depth_C = np.asarray(crop.warp(depth_m, camera, view.stride, nearest=True), dtype=np.float64)
    z = depth_C / (view.rays() @ crop.R_CV.T)[..., 2]
    has_depth = z > 0
    estimate_sigma = _CALIBRATED_FACTOR_SIGMA if depth.calibrated else _ESTIMATE_FACTOR_SIGMA
    return replace(
        view,
        depth_m=np.where(has_depth, z, view.depth_m),
        depth_sigma=np.where(has_depth, _EXACT_SIGMA if depth.exact else _ESTIMATE_SIGMA, view.depth_sigma),
        depth_factor_sigma=_EXACT_FACTOR_SIGMA if depth.exact else estimate_sigma,
    )
