"""Correspondences between image cells and points of the robot, the measurements of a calibration."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.camera.lens import Lens
from kinebench_drake.grounding.registration.solver import NEAREST_M
from kinebench_drake.grounding.tracking.crop import CLOSE_SIZE
from kinebench_drake.grounding.tracking.markov import X_HALF_TURN
from kinebench_drake.grounding.tracking.view import GripperView
from kinebench_drake.models.panda.description import ARM, GRIPPER, RobotPart

MIN_FRAMES = 3
"""Least number of frames that must show hand and arm if postures are estimated."""
LINK_SIGMAS = 3.0
"""Factor of the network's standard deviations for cells of links, of which it is overconfident."""
PIXEL_SIGMA = 0.5
"""Least standard deviation of a cell in an image 384 px wide [px]: the raster of the views."""
_THIN = 3
"""One of so many cells is used where postures are estimated."""
_PART_CELLS = 60
"""Greatest number of cells of one part in one view."""
_ALIKE_M = 0.010
"""Distance between poses of a part that count as one [m]."""
_ALIKE_RAD = np.deg2rad(2.0)
"""Angle between poses of a part that count as one [rad]."""
_INDEPENDENT = 8.0
"""Independent measurements that cells of one part in one view count as at most: their errors correlate."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotPoints:
    """N points of the robot, each seen in one of T frames of one camera."""

    frame: NDArray[np.intp]
    """(N,) row of the frame."""
    part: NDArray[np.uint8]
    """(N,) values of `RobotPart`."""
    p_P: Array
    """(N, 3) point in the frame of its part, fingers closed [m]."""
    opening_sign: Array
    """(N,) direction along the hand's y axis as the gripper opens: 1 or -1 for fingers, else 0."""
    uv_px: Array
    """(N, 2) where the image shows it [px]."""
    weight: Array
    """(N,) weight in independent measurements within its frame."""

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.frame)

    def take(self, chosen: NDArray[np.generic]) -> Self:
        """Select points by index or mask."""
        return type(self)(**{f.name: getattr(self, f.name)[chosen] for f in fields(self)})

    @classmethod
    def join(cls, parts: Sequence[Self]) -> Self:
        """Concatenate points in the same frames."""
        return cls(**{f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)})

    def locate(self, X_BP: Array, finger_m: Array) -> Array:
        """Return the points (N, 3) in B at poses (T, PARTS, 4, 4) and openings of each finger (T,) [m]; NaN without."""
        X = X_BP[self.frame, self.part]
        opened_P = self.p_P.copy()
        opened_P[:, 1] += self.opening_sign * finger_m[self.frame]
        return np.asarray(np.einsum("nij,nj->ni", X[:, :3, :3], opened_P) + X[:, :3, 3])

    def count_repeats(self, X_BP: Array) -> NDArray[np.intp]:
        """Count for each point (N,) the frames in which its part has the same pose `X_BP` (T, PARTS, 4, 4) [m].

        The errors of such points correlate.
        """
        p = X_BP[..., :3, 3]
        R = X_BP[..., :3, :3]
        near = np.linalg.norm(p[:, None] - p[None], axis=-1) <= _ALIKE_M
        cosine = (np.einsum("spij,tpij->stp", R, R) - 1.0) / 2.0
        alike = np.maximum(1, (near & (cosine >= np.cos(_ALIKE_RAD))).sum(axis=1))
        return np.asarray(alike[self.frame, self.part])


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationCorrespondences(RobotPoints):
    """N cells of the network's output grid in several frames of one camera, with the robot points that they show."""

    sigma_m: Array
    """(N,) standard deviation of each coordinate of the point [m]."""
    depth_per_px: Array
    """(N,) estimated depth over the focal length of the assumed camera [m/px]: it scales with the true one."""

    def of_frames(self, rows: NDArray[np.intp]) -> Self:
        """Select the cells of some frames, renumbered from 0."""
        number = {int(row): i for i, row in enumerate(rows)}
        chosen = self.take(np.isin(self.frame, rows))
        return replace(chosen, frame=np.array([number[int(f)] for f in chosen.frame], dtype=np.intp))

    def thin(self) -> Self:
        """Keep one of `_THIN` cells, with the weight of the others."""
        chosen = self.take(np.arange(0, len(self), _THIN))
        return replace(chosen, weight=np.minimum(1.0, chosen.weight * _THIN))

    def sigma_px(self, lens: Lens, p_B: Array, floor: float = PIXEL_SIGMA) -> Array:
        """Return the standard deviation (N,) of the reprojection of the points `p_B` (N, 3) in B [px].

        It is `floor` at least in an image 384 px wide.
        """
        _, z = lens.project(p_B)
        spread = lens.camera.fx * self.sigma_m / np.maximum(np.abs(z), NEAREST_M)
        return np.asarray(np.hypot(floor * lens.camera.unit_px, spread))

    @property
    def of_gripper(self) -> NDArray[np.bool_]:
        """(N,) cells that show hand or fingers."""
        return np.isin(self.part, GRIPPER)

    def flip(self, frames: NDArray[np.bool_]) -> Self:
        """Return the cells with the gripper rotated by 180 degrees about its axis in some `frames` (T,)."""
        changed = self.of_gripper & frames[self.frame]
        p_P = np.where(changed[:, None], self.p_P @ X_HALF_TURN[:3, :3].T, self.p_P)
        sign = np.where(changed, -self.opening_sign, self.opening_sign)
        return replace(self, p_P=p_P, opening_sign=sign)


def find_correspondences(views: Sequence[tuple[int, GripperView]], camera: Camera) -> CalibrationCorrespondences:
    """Extract the cells of several views that show the robot.

    Args:
        views: row of the frame and view; gripper cells are taken from close views alone.
        camera: camera of the crops.
    """
    close = {row for row, view in views if _is_close(view)}
    cells = []
    for row, view in views:
        parts = (*GRIPPER, *ARM) if _is_close(view) or row not in close else ARM
        cells += [_part_cells(row, view, part, camera) for part in parts]
    return CalibrationCorrespondences.join(cells)


def _is_close(view: GripperView) -> bool:
    return view.crop.size == CLOSE_SIZE


def _part_cells(row: int, view: GripperView, part: RobotPart, camera: Camera) -> CalibrationCorrespondences:
    v, u = np.nonzero(view.part == part)
    if len(v) > _PART_CELLS:
        chosen = np.linspace(0, len(v) - 1, _PART_CELLS).astype(int)
        v = v[chosen]
        u = u[chosen]
    n = len(v)
    rays = view.rays()[v, u] @ view.crop.R_CV.T
    return CalibrationCorrespondences(
        frame=np.full(n, row, dtype=np.intp),
        uv_px=camera.project(rays),
        part=view.part[v, u],
        p_P=view.coordinates_P[v, u],
        sigma_m=view.coordinates_sigma_m[v, u] * (LINK_SIGMAS if part in ARM else 1.0),
        opening_sign=view.opening_sign[v, u],
        depth_per_px=rays[:, 2] * view.depth_m[v, u] / camera.fx,
        weight=np.full(n, min(1.0, _INDEPENDENT / max(1, n))),
    )
