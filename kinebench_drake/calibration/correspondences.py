"""Correspondences between image cells and points of the robot: the measurements of a calibration."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.crop import CLOSE_SIZE
from kinebench_drake.grounding.flips import X_HALF_TURN
from kinebench_drake.grounding.registration.fit import UNSEEN_FINGER_M
from kinebench_drake.grounding.tracker import PoseTracker
from kinebench_drake.grounding.view import Frames, GripperView
from kinebench_drake.models.panda.robot import ARM, GRIPPER, RobotPart
from kinebench_drake.models.robot import N_JOINTS

PART_CELLS = 60
"""Cells taken of one part in one view at most."""
INDEPENDENT = 8.0
"""Independent measurements that the cells of one part in one view are worth at most: they err alike."""
LINK_SIGMAS = 3.0
"""Standard deviation of a link's cells over what the network says: of the arm it is surer than it is right."""
_ALIKE_M, _ALIKE_RAD = 0.01, np.deg2rad(2.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationCorrespondences:
    """N cells of several frames of one camera."""

    frame: NDArray[np.intp]
    """(N,) row of the frame among those looked at."""
    uv_px: Array
    """(N, 2) where the cell lies in the frame [px]."""
    part: NDArray[np.uint8]
    """(N,) values of `Part`."""
    p_P: Array
    """(N, 3) point seen in the frame of its part [m]; see `GripperView.coordinates_P`."""
    sigma_m: Array
    """(N,) standard deviation of each of its coordinates [m]."""
    opening_sign: Array
    """(N,) where the cell goes along the hand's y axis as the gripper opens: 1, -1 or, but for fingers, 0."""
    weight: Array
    """(N,) how many independent measurements it is worth in its frame."""
    repeats: Array
    """(N,) frames in which its part stands where it stands in this one, so that it errs alike."""

    def __len__(self) -> int:
        """Number of cells."""
        return len(self.frame)

    def take(self, chosen: NDArray[np.generic]) -> "CalibrationCorrespondences":
        """Some of the cells, by index or mask."""
        return CalibrationCorrespondences(**{f.name: getattr(self, f.name)[chosen] for f in fields(self)})

    def of_frames(self, rows: NDArray[np.intp]) -> "CalibrationCorrespondences":
        """The cells of some frames, which are counted anew from 0."""
        number = {int(row): i for i, row in enumerate(rows)}
        chosen = self.take(np.isin(self.frame, rows))
        return replace(chosen, frame=np.array([number[int(f)] for f in chosen.frame], dtype=np.intp))

    def thinned(self, every: int) -> "CalibrationCorrespondences":
        """One of so many cells, which stands for the others."""
        chosen = self.take(np.arange(0, len(self), every))
        return replace(chosen, weight=np.minimum(1.0, chosen.weight * every))

    @property
    def of_gripper(self) -> NDArray[np.bool_]:
        """(N,) cells that show hand or fingers."""
        return np.isin(self.part, GRIPPER)

    def turned(self, frames: NDArray[np.bool_]) -> "CalibrationCorrespondences":
        """The same with the gripper read as turned by 180 degrees about its axis in some `frames` (T,)."""
        changed = self.of_gripper & frames[self.frame]
        p_P = np.where(changed[:, None], self.p_P @ X_HALF_TURN[:3, :3].T, self.p_P)
        sign = np.where(changed, -self.opening_sign, self.opening_sign)
        return replace(self, p_P=p_P, opening_sign=sign)

    def repeated(self, X_BP: Array) -> "CalibrationCorrespondences":
        """The same, knowing which parts stand where they stood in other frames.

        Args:
            X_BP: (T, PARTS, 4, 4) poses of the parts in B.
        """
        p, R = X_BP[..., :3, 3], X_BP[..., :3, :3]
        near = np.linalg.norm(p[:, None] - p[None], axis=-1) <= _ALIKE_M
        cosine = (np.einsum("spij,tpij->stp", R, R) - 1.0) / 2.0
        alike = np.maximum(1, (near & (cosine >= np.cos(_ALIKE_RAD))).sum(axis=1))
        return replace(self, repeats=alike[self.frame, self.part].astype(np.float64))


def find_correspondences(views: Sequence[tuple[int, GripperView]], camera: Camera) -> CalibrationCorrespondences:
    """The cells of several views of frames that show the robot.

    Args:
        views: row of the frame and view; the gripper is taken from close views alone.
        camera: with what the views were cut out.
    """
    close = {row for row, view in views if _is_close(view)}
    found = []
    for row, view in views:
        parts = (*GRIPPER, *ARM) if _is_close(view) or row not in close else ARM
        found += [_of_part(row, view, part, camera) for part in parts]
    return _joined(found)


def points(sightings: CalibrationCorrespondences, X_BP: Array, finger_m: Array) -> Array:
    """Where the points (N, 3) of the cells are in B [m]; NaN where their part is not known.

    Args:
        sightings: the cells of T frames.
        X_BP: (T, PARTS, 4, 4) frames of the parts' CAD coordinates in B [m].
        finger_m: (T,) opening of each finger [m].
    """
    X = X_BP[sightings.frame, sightings.part]
    opened_P = sightings.p_P.copy()
    opened_P[:, 1] += sightings.opening_sign * finger_m[sightings.frame]
    return np.asarray(np.einsum("nij,nj->ni", X[:, :3, :3], opened_P) + X[:, :3, 3])


def _is_close(view: GripperView) -> bool:
    return view.crop.size == CLOSE_SIZE


def _of_part(row: int, view: GripperView, part: RobotPart, camera: Camera) -> CalibrationCorrespondences:
    v, u = np.nonzero(view.part == part)
    if len(v) > PART_CELLS:
        chosen = np.linspace(0, len(v) - 1, PART_CELLS).astype(int)
        v, u = v[chosen], u[chosen]
    n = len(v)
    return CalibrationCorrespondences(
        frame=np.full(n, row, dtype=np.intp),
        uv_px=camera.project(view.rays()[v, u] @ view.crop.R_CV.T),
        part=view.part[v, u],
        p_P=view.coordinates_P[v, u],
        sigma_m=view.coordinates_sigma_m[v, u] * (LINK_SIGMAS if part in ARM else 1.0),
        opening_sign=view.opening_sign[v, u],
        weight=np.full(n, min(1.0, INDEPENDENT / max(1, n))),
        repeats=np.ones(n),
    )


def _joined(several: Sequence[CalibrationCorrespondences]) -> CalibrationCorrespondences:
    return CalibrationCorrespondences(
        **{f.name: np.concatenate([getattr(s, f.name) for s in several]) for f in fields(CalibrationCorrespondences)}
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class LensView:
    """What T frames show of the robot."""

    cells: CalibrationCorrespondences
    """Cells of all frames."""
    finger_m: Array
    """(T,) opening of each finger as seen [m]; a usual one where it is not."""
    q: Array
    """(T, 7) the arm that goes with the hand if the camera stands where it was taken to stand [rad]; NaN where none."""
    robot: NDArray[np.bool_]
    """(H, W) pixels of the first of the frames that show the robot."""

    def of_frames(self, rows: NDArray[np.intp]) -> "LensView":
        """What some of the frames show."""
        return replace(self, cells=self.cells.of_frames(rows), finger_m=self.finger_m[rows], q=self.q[rows])


class ViewEstimator(Protocol):
    """What looks: the tracker's networks, or in tests the truth."""

    def look(self, frames: Frames, camera: Camera) -> LensView:
        """Look at `frames` (T, H, W, 3), taken with about this camera."""
        ...


class NetworkViewEstimator:
    """The networks of the tracker."""

    def __init__(self, tracker: PoseTracker) -> None:
        """Look with a tracker; its poses matter little, its views are what is used."""
        self._tracker = tracker

    @classmethod
    def create(cls) -> "NetworkViewEstimator":
        """With the shipped weights.

        Raises:
            SetupError: weights, meshes or native libraries are missing.
        """
        from kinebench_drake.grounding.estimator import NetworkEstimator
        from kinebench_drake.grounding.tracker import CadTracker
        from kinebench_drake.models.perception.weights import load_network

        return cls(CadTracker(NetworkEstimator(load_network())))

    def look(self, frames: Frames, camera: Camera) -> LensView:
        """See `Eye`."""
        seen = self._tracker.track(frames, camera)
        close = [(row, pose.view) for row, pose in enumerate(seen.poses) if pose is not None]
        finger_m = [np.nan if pose is None else pose.finger_m for pose in seen.poses]
        arms = [None if pose is None else pose.arm for pose in seen.poses]
        return LensView(
            cells=find_correspondences([*close, *enumerate(seen.wide)], camera),
            finger_m=np.nan_to_num(np.array(finger_m), nan=UNSEEN_FINGER_M),
            q=np.stack([np.full(N_JOINTS, np.nan) if arm is None else arm.q for arm in arms]),
            robot=seen.robot,
        )
