"""Square crops around the gripper, and dense estimates of them (part labels, metric depth, CAD coordinates by cells).

A crop is the image of a virtual camera V whose optical axis points at the gripper. V shares the real camera's centre,
so a homography of the image gives exactly the image of a camera rotated towards the gripper. The network's input then
does not depend on where in the image the gripper is.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, make_pose, rotation_exp, transform_points
from kinebench_drake.grounding.priors import ExternalDepth, Priors
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.panda.description import GRIPPER, OPENING_SIGN, RobotPart

GRIPPER_CENTRE_H = np.array([0.0, 0.0, 0.045])
"""Centre of the gripper's bounding sphere in panda_hand [m]."""
GRIPPER_RADIUS_M = 0.115
"""Radius of that sphere [m]."""
WRIST_CENTRE_H = np.array([0.044, 0.0, -0.15])
WRIST_RADIUS_M = 0.17
"""The same for the last links."""
WIDE_SIZE = 192
"""Width of the crop that holds the whole image, for detection [px]."""
CLOSE_SIZE = 128
"""Width of the crop around the gripper, for pose estimation [px]."""
CLOSE_MARGIN = 1.3
"""Half width of that crop over the gripper's radius."""
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

_HALF_TURN = np.array([-1.0, -1.0, 1.0])
_SWAPPED = np.array(list(RobotPart), np.uint8)
_SWAPPED[[RobotPart.LEFT_FINGER, RobotPart.RIGHT_FINGER]] = [RobotPart.RIGHT_FINGER, RobotPart.LEFT_FINGER]


@dataclass(frozen=True, slots=True, kw_only=True)
class Crop:
    """Square image of a virtual camera V."""

    R_CV: Array
    """(3, 3) rotation of V in the camera frame."""
    focal: float
    """Focal length of V [px]."""
    size: int
    """Width and height [px]; the principal point is at the centre."""

    @property
    def X_CV(self) -> Array:
        """(4, 4) pose of V in the camera frame: a pure rotation."""
        return make_pose(self.R_CV, np.zeros(3))

    @classmethod
    def towards(cls, direction_C: ArrayLike, half_tangent: float, size: int, roll: float = 0.0) -> "Crop":
        """Return the crop along `direction_C` (3,) in the camera frame, of half the field of view by its tangent.

        `roll` is the rotation about the optical axis [rad]; at 0, V is the camera rotated by the smallest angle.
        """
        z = np.asarray(direction_C, dtype=np.float64)
        z = z / np.linalg.norm(z)
        axis = np.cross([0.0, 0.0, 1.0], z)
        sine = np.linalg.norm(axis)
        turn = axis / sine * np.arctan2(sine, z[2]) if sine > 1e-12 else np.zeros(3)
        R_CV = rotation_exp(turn) @ rotation_exp([0.0, 0.0, roll])
        return cls(R_CV=R_CV, focal=size / 2 / half_tangent, size=size)

    @classmethod
    def of_gripper(cls, X_CH: ArrayLike, margin: float, size: int) -> "Crop":
        """Return the crop filled by the bounding sphere, times `margin`, of a gripper at `X_CH` (4, 4)."""
        centre = transform_points(X_CH, GRIPPER_CENTRE_H[None])[0]
        return cls.towards(centre, margin * GRIPPER_RADIUS_M / float(np.linalg.norm(centre)), size)

    @classmethod
    def of_wrist(cls, X_CH: ArrayLike, size: int) -> "Crop":
        """Return the crop of the last links behind a gripper at `X_CH` (4, 4)."""
        centre = transform_points(X_CH, WRIST_CENTRE_H[None])[0]
        return cls.towards(centre, WRIST_RADIUS_M / float(np.linalg.norm(centre)), size)

    @classmethod
    def of_frame(cls, camera: Camera) -> "Crop":
        """Return the crop that holds the whole image of `camera`."""
        half = np.array([camera.width / 2, camera.height / 2])
        direction = np.array([(half[0] - camera.cx) / camera.fx, (half[1] - camera.cy) / camera.fy, 1.0])
        return cls.towards(direction, float(max(half / [camera.fx, camera.fy])), WIDE_SIZE)

    @classmethod
    def tiles(cls, camera: Camera) -> "list[Crop]":
        """Return square crops as wide as the shorter side, along the longer one, that overlap by half or more."""
        size = np.array([camera.width, camera.height])
        side = int(size.min())
        count = int(np.ceil(2 * size.max() / side)) - 1
        crops = []
        for share in np.linspace(0.0, 1.0, count) if count > 1 else [0.5]:
            u, v = side / 2 + share * (size - side)
            direction = np.array([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0])
            half = side / 2 / min(camera.fx, camera.fy) / np.linalg.norm(direction)
            crops.append(cls.towards(direction, float(half), WIDE_SIZE))
        return crops

    def homography(self, camera: Camera, stride: int = 1) -> Array:
        """Return the (3, 3) homography from cells of the crop to pixels of `camera`, centres at half-integers."""
        f = self.focal / stride
        c = self.size / stride / 2
        K_V_inverse = np.array([[1 / f, 0.0, -c / f], [0.0, 1 / f, -c / f], [0.0, 0.0, 1.0]])
        return np.asarray(camera.K @ self.R_CV @ K_V_inverse)

    def warp(
        self, image: NDArray[np.generic], camera: Camera, stride: int = 1, nearest: bool = False
    ) -> NDArray[np.generic]:
        """Return the crop (n, n[, 3]) of an image (H, W[, 3]) of `camera`; 0 outside the image."""
        M = _opencv_homography(self.homography(camera, stride))
        n = self.size // stride
        flags = (cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR) | cv2.WARP_INVERSE_MAP
        return np.asarray(cv2.warpPerspective(image, M, (n, n), flags=flags))

    def unwarp(self, cells: NDArray[np.uint8], camera: Camera, stride: int = 1) -> NDArray[np.uint8]:
        """Return the labels (n, n) of cells as an image (H, W) of `camera`; 0 outside the crop."""
        M = _opencv_homography(self.homography(camera, stride))
        return np.asarray(cv2.warpPerspective(cells, M, (camera.width, camera.height), flags=cv2.INTER_NEAREST))

    def in_image(self, camera: Camera, stride: int = 1) -> NDArray[np.bool_]:
        """Return the cells (n, n) that lie inside the image of `camera`."""
        return self.warp(np.ones((camera.height, camera.width), np.uint8), camera, stride, nearest=True).astype(bool)

    def rays(self, stride: int = 1) -> Array:
        """Return the directions (n, n, 3) in V through the centres of the cells, scaled to z = 1."""
        n = self.size // stride
        u = ((np.arange(n) + 0.5) * stride - self.size / 2) / self.focal
        grid = np.ones((n, n, 3))
        grid[..., 0], grid[..., 1] = np.meshgrid(u, u)
        return grid


def _opencv_homography(M: Array) -> Array:
    """Convert a homography from half-integer pixel centres to OpenCV's integer ones."""
    shift = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
    return np.asarray(np.linalg.inv(shift) @ M @ shift)


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

    def half_turned(self) -> "GripperView":
        """Return the view with the gripper taken for one after half a turn about its z axis."""
        gripper = self.gripper
        turned = self.coordinates_P * np.where(gripper[..., None], _HALF_TURN, 1.0)
        return replace(self, part=_SWAPPED[self.part], coordinates_P=turned)

    def rays(self) -> Array:
        """Return the viewing directions (h, w, 3) of the cells in the crop's frame, scaled to z = 1."""
        return self.crop.rays(self.stride)

    def to_frame(self, cells: NDArray[np.bool_], camera: Camera) -> NDArray[np.bool_]:
        """Return the pixels (H, W) of the camera image that are covered by `cells` (h, w)."""
        return self.crop.unwarp(cells.astype(np.uint8), camera, self.stride) > 0


class DenseEstimator(Protocol):
    """Source of dense estimates: the trained network, ground truth, or another model."""

    def estimate(self, frames: Frames, camera: Camera, crops: Mapping[int, Crop]) -> Iterator[tuple[int, GripperView]]:
        """Yield frame number and view of each of the `crops`, by frame number, of a video, in any order."""
        ...


@dataclass(frozen=True, slots=True)
class OverrideEstimator:
    """Estimator with its mask, its depth or both replaced by priors."""

    _base: DenseEstimator
    _priors: Priors

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
