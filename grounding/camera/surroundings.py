"""Straight lines around the robot, which say how the camera is turned where they run along the axes of the base.

Tables, walls, tiles and pedestals mostly stand square to the robot that is mounted on them. Lines along three
perpendicular axes determine rotation and focal length (Caprile and Torre, "Using vanishing points for camera
calibration", 1990). The arm decides whether they are the axes of the base: it knows these within a few degrees.
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, rotation_exp, rotation_z
from kinebench_drake.grounding.camera.lens import UNKNOWNS, Lens
from kinebench_drake.grounding.registration.edges import EdgeMatcher
from kinebench_drake.grounding.registration.solver import CAUCHY, Rows
from kinebench_drake.io.frames import Frames

_LEAST_LENGTH = 0.05
"""Least length of a line over the larger side of the image."""
_LEAST_LINES = 8
_TURNS_RAD = np.deg2rad(np.arange(-45.0, 45.0, 0.5))
_WIDTH_RAD = np.deg2rad(1.5)
"""Angle within which a line runs along an axis, at the camera that the arm shows [rad]."""
_LEAST_SHARE = 0.3
"""Least share of the lines' length along the axes."""
_LEAST_RATIO = 2.0
"""Least ratio of this share to that at any other turn."""
_OTHER_TURN_RAD = np.deg2rad(10.0)
"""Least difference of another turn [rad]."""
_SIGMAS = 2.5
"""Standard deviations of the arm's turn about the vertical within which the axes are those of the base."""
_LARGEST_TURN_RAD = np.deg2rad(6.0)
"""Largest turn of the axes against those that the arm shows [rad]."""
_PASS_RAD = np.deg2rad(4.0)
"""Angle to its axis beyond which a line is left out [rad]."""
_SIGMA_PX = 0.3
"""Standard deviation of a line's ends [px]."""
_SIGMA_RAD = np.deg2rad(0.15)
"""Standard deviation of a line's direction [rad]."""
_ASKEW_RAD = np.deg2rad(0.2)
"""Standard deviation of each angle between surroundings and base [rad]."""
_ASKEW_PASSES = 6
_DIFFERENCE = 1e-5
_INDEPENDENT = 8.0
"""Independent lines that those along one axis count as at most."""
_ALONG = np.array([0.1, 0.5, 0.9])
"""Places on a line that are compared with the robot."""
_ON_ROBOT = 0.2
"""Share of these places, all frames together, that the robot covers."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lines(Rows):
    """Straight lines of an image."""

    ends_px: Array
    """(N, 2, 2) their end points [px]."""

    def __len__(self) -> int:
        """Return the number of lines."""
        return len(self.ends_px)

    @property
    def length_px(self) -> Array:
        """(N,) lengths [px]."""
        return np.asarray(np.linalg.norm(self.ends_px[:, 1] - self.ends_px[:, 0], axis=1))

    def offsets(self, lens: Lens, axes_B: Array) -> Array:
        """Return how far ends lie off the lines from their middles to the vanishing points of directions in B (K, 3).

        Distances (N, K) are signed [px].
        """
        one = np.ones((len(self), 1))
        end = np.hstack([self.ends_px[:, 1], one])
        middle = np.hstack([self.ends_px.mean(axis=1), one])
        line = np.cross(middle[:, None], axes_B @ lens.X_CB[:3, :3].T @ lens.intrinsics.K.T)
        along = np.maximum(np.linalg.norm(line[..., :2], axis=-1), 1e-12)
        return np.asarray(np.einsum("nkj,nj->nk", line, end) / along)

    def angles(self, lens: Lens, axes_B: Array) -> Array:
        """Return the angles (N, K) between lines and directions (K, 3) in the image [rad], 0 to pi/2."""
        return np.asarray(np.arcsin(np.clip(2 * np.abs(self.offsets(lens, axes_B)) / self.length_px[:, None], 0, 1)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Surroundings:
    """Lines that run along the axes of the base: a term of the bundle adjustment."""

    lines: Lines
    axis: NDArray[np.intp]
    """(N,) axis of the base that each runs along: 0, 1 or 2."""

    def linearize(self, lens: Lens) -> tuple[float, Array, Array]:
        """Return cost, normal matrix (9, 9) and gradient (9,) in the camera's unknowns; the place has no part in it.

        The surroundings may stand a little askew to the base: three angles, which are eliminated.
        """
        sigma = np.hypot(_SIGMA_PX, _SIGMA_RAD * self.lines.length_px / 2)
        weight = np.minimum(1.0, _INDEPENDENT / np.bincount(self.axis)[self.axis])
        rows = np.arange(len(self.axis))
        askew = np.zeros(3)
        stiff = np.eye(3) / _ASKEW_RAD**2

        def residual(step: Array, askew: Array) -> Array:
            offsets = self.lines.offsets(lens.displace(step), rotation_exp(askew).T)
            return np.asarray(offsets[rows, self.axis] / sigma)

        still = np.zeros(UNKNOWNS)
        for _ in range(_ASKEW_PASSES):
            here = residual(still, askew)
            W = weight / (1.0 + here**2 / CAUCHY**2)
            A = _slopes(lambda x: residual(still, x), askew)
            askew = askew - np.linalg.solve(A.T @ (W[:, None] * A) + stiff, A.T @ (W * here) + stiff @ askew)
        here = residual(still, askew)
        W = weight / (1.0 + here**2 / CAUCHY**2)
        J = _slopes(lambda x: residual(x, askew), still)
        A = _slopes(lambda x: residual(still, x), askew)
        WJ = W[:, None] * J
        WA = W[:, None] * A
        H = J.T @ WJ - J.T @ WA @ np.linalg.solve(A.T @ WA + stiff, A.T @ WJ)
        cost = float((weight * CAUCHY**2 * np.log1p(here**2 / CAUCHY**2)).sum() + askew @ stiff @ askew)
        return cost, H, J.T @ (W * here)


def _slopes(function: Callable[[Array], Array], x: Array) -> Array:
    """Return the derivatives (N, K) of a function of `x` (K,) by central differences."""
    steps = _DIFFERENCE * np.eye(len(x))
    return np.stack([(function(x + h) - function(x - h)) / (2 * _DIFFERENCE) for h in steps], axis=1)


def find_lines(frames: Frames, camera: Camera, X_CP: Array, matcher: EdgeMatcher) -> Lines:
    """Find straight lines off the robot in the median of frames (T, H, W, 3) of a static camera.

    `X_CP` (N, PARTS, 4, 4) are poses of the robot in some of them, in the camera frame [m].
    """
    gray = cv2.cvtColor(np.median(np.asarray(frames), axis=0).astype(np.uint8), cv2.COLOR_RGB2GRAY)
    detected = cv2.createLineSegmentDetector(cv2.LSD_REFINE_ADV).detect(gray)[0]
    if detected is None:
        return Lines(ends_px=np.zeros((0, 2, 2)))
    lines = Lines(ends_px=np.asarray(detected, np.float64).reshape(-1, 2, 2) + 0.5)
    lines = lines.take(lines.length_px > _LEAST_LENGTH * max(gray.shape))
    place = (lines.ends_px[:, :1] + _ALONG[:, None] * np.diff(lines.ends_px, axis=1)).reshape(-1, 2)
    ray = np.column_stack([(place - [camera.cx, camera.cy]) / [camera.fx, camera.fy], np.ones(len(place))])
    covered = np.mean([np.isfinite(matcher.caster.first_hits(X, ray)[0]) for X in X_CP], axis=0)
    return lines.take(covered.reshape(len(lines), -1).mean(axis=1) < _ON_ROBOT)


def find_surroundings(lines: Lines, lens: Lens, turn_sigma_rad: float) -> Surroundings | None:
    """Return the lines along the axes of the base; None if they are few, or run along other axes.

    `turn_sigma_rad` is the standard deviation of the camera that the arm shows about the base's vertical axis [rad].
    """
    if len(lines) < _LEAST_LINES:
        return None
    share = np.array([_share_along(lines, lens, turn) for turn in _TURNS_RAD])
    best = int(share.argmax())
    apart = np.abs((_TURNS_RAD - _TURNS_RAD[best] + np.pi / 4) % (np.pi / 2) - np.pi / 4) > _OTHER_TURN_RAD
    near = abs(_TURNS_RAD[best]) <= min(_SIGMAS * turn_sigma_rad, _LARGEST_TURN_RAD) + _WIDTH_RAD
    if not near or share[best] < max(_LEAST_SHARE, _LEAST_RATIO * share[apart].max()):
        return None
    angle = lines.angles(lens, rotation_z(float(_TURNS_RAD[best])).T)
    axis = angle.argmin(axis=1)
    along = angle.min(axis=1) <= _PASS_RAD
    return Surroundings(lines=lines.take(along), axis=axis[along]) if along.sum() >= _LEAST_LINES else None


def _share_along(lines: Lines, lens: Lens, turn_rad: float) -> float:
    """Return the share of the lines' length along the horizontal axes of a base turned by an angle [rad]."""
    angle = lines.angles(lens, rotation_z(turn_rad).T[:2]).min(axis=1)
    return float(np.average(np.exp(-0.5 * (angle / _WIDTH_RAD) ** 2), weights=lines.length_px))
