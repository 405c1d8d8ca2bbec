"""Detection of the robot in the frames of a video whose camera is unknown: cells of the networks' views, in pixels.

Cells are correspondences between the image and points of the robot, the measurements of a calibration.

A crop is a homography of the image, so the pixel of a cell does not depend on the focal length that the crop was laid
out with; only the crop's shape does, a little.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Self

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.camera.lens import Lens
from kinebench_drake.grounding.registration.arm_model import MIN_CELLS
from kinebench_drake.grounding.registration.fit import UNSEEN_FINGER_M, HandFit, finger_or_default, fit
from kinebench_drake.grounding.registration.solver import NEAREST_M, Rows
from kinebench_drake.grounding.tracking.localization import PART_CELLS, find_region, likeliest_gripper
from kinebench_drake.grounding.tracking.tracker import PoseTracker
from kinebench_drake.grounding.tracking.view import CLOSE_MARGIN, CLOSE_SIZE, Crop, DenseEstimator, GripperView
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.gripper import X_HALF_TURN
from kinebench_drake.models.panda.description import ARM, GRIPPER, RobotPart
from kinebench_drake.models.robot import N_JOINTS
from kinebench_drake.segments import evenly

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
_SEARCHED = 36
"""Frames of which the best seen ones are used."""
_TRIED = 2
"""Frames tried for each one used."""
_ROUNDS = 2
"""Close views of a hand: where its frame shows it, then where another one does."""
_CLOSE_HAND_CELLS = 120
"""Cells of the hand in a close view from which it is surely a hand."""
_CLOSE_WEIGHT = 6.0
"""Visibility of a hand seen from close by, in parts of the arm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotPoints(Rows):
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
        alike = near & (cosine >= np.cos(_ALIKE_RAD))
        return np.asarray(np.maximum(1, alike.sum(axis=1))[self.frame, self.part])


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
        spread = lens.intrinsics.fx * self.sigma_m / np.maximum(np.abs(z), NEAREST_M)
        return np.asarray(np.hypot(floor * lens.intrinsics.unit_px, spread))

    @property
    def of_gripper(self) -> NDArray[np.bool_]:
        """(N,) cells that show hand or fingers."""
        return np.isin(self.part, GRIPPER)

    def flip(self, frames: NDArray[np.bool_]) -> Self:
        """Return the cells with the gripper rotated by 180 degrees about its axis in some `frames` (T,)."""
        changed = self.of_gripper & frames[self.frame]
        p_P = np.where(changed[:, None], self.p_P @ X_HALF_TURN[:3, :3].T, self.p_P)
        return replace(self, p_P=p_P, opening_sign=np.where(changed, -self.opening_sign, self.opening_sign))


def find_correspondences(views: Sequence[tuple[int, GripperView]], camera: Camera) -> CalibrationCorrespondences:
    """Extract the cells of several views that show the robot.

    Args:
        views: row of the frame and view; gripper cells are taken from close views alone.
        camera: camera of the crops.
    """
    close = {row for row, view in views if _is_close(view)}
    return CalibrationCorrespondences.join(
        [
            _part_cells(row, view, part, camera)
            for row, view in views
            for part in ((*GRIPPER, *ARM) if _is_close(view) or row not in close else ARM)
        ]
    )


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


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmDetections:
    """Robot in T frames of a video."""

    rows: NDArray[np.intp]
    """(T,) numbers of the frames."""
    cells: CalibrationCorrespondences
    """Cells of hand and arm; their frames are rows of `rows`."""
    finger_m: Array
    """(T,) opening of each finger [m]; a default where there is none."""
    robot: NDArray[np.bool_]
    """(H, W) pixels of the first of these frames that show the robot."""
    q: Array | None = None
    """(T, 7) postures for the assumed pose of the camera [rad], NaN where there is none; None if none are fitted."""


def find_robot(
    estimator: DenseEstimator, frames: Frames, camera: Camera, most: int, *, searched: int = _SEARCHED
) -> ArmDetections | None:
    """Return the cells of the frames that show hand and arm best; None if no frame shows a hand.

    Args:
        estimator: source of dense estimates.
        frames: (T, H, W, 3) RGB.
        camera: assumed camera; only its focal length matters, and little.
        most: greatest number of frames.
        searched: number of frames that these are chosen from.
    """
    numbers = evenly(len(frames), searched)
    whole = dict.fromkeys(numbers.tolist(), Crop.of_frame(camera))
    wide = dict(estimator.estimate(frames, camera, whole))
    # The region is sought in the frames searched alone, numbered from 0.
    region = find_region(estimator, frames[numbers], camera, {k: wide[row] for k, row in enumerate(numbers.tolist())})
    if region is not None:
        wide = dict(estimator.estimate(frames, camera, dict.fromkeys(whole, region)))
    hands = {row: hand for row, view in wide.items() if (hand := fit(likeliest_gripper(view))) is not None}
    close = _approach(estimator, frames, camera, wide, hands, _TRIED * most)
    # A hand that is not where the wide view found it shows few of its cells from close by.
    visibility = {row: _visibility(wide[row]) + _CLOSE_WEIGHT * _hand_share(close[row]) for row in close}
    chosen = _best_seen(visibility, len(frames), most)
    if not chosen:
        return None
    number = {row: k for k, row in enumerate(chosen)}
    views = [(number[row], views[row]) for views in (close, wide) for row in chosen]
    return ArmDetections(
        rows=np.array(chosen, dtype=np.intp),
        cells=find_correspondences(views, camera),
        finger_m=np.array([finger_or_default(hands[row].finger_m) for row in chosen]),
        robot=wide[chosen[0]].to_frame(wide[chosen[0]].part > RobotPart.BACKGROUND, camera),
    )


def _approach(
    estimator: DenseEstimator,
    frames: Frames,
    camera: Camera,
    wide: Mapping[int, GripperView],
    hands: dict[int, HandFit],
    most: int,
) -> dict[int, GripperView]:
    """Return close views of hands: where the wide view finds one, then where it stands in a frame nearby.

    Args:
        estimator: source of dense estimates.
        frames: (T, H, W, 3) RGB.
        camera: assumed camera.
        wide: wide views by frame.
        hands: fits to them by frame; those to the close views replace them.
        most: greatest number of frames whose hand is looked at first.
    """
    first = _best_seen({row: _visibility(wide[row]) for row in hands}, len(frames), most)
    close: dict[int, GripperView] = {}
    for number in range(2 * _ROUNDS):
        own = number < _ROUNDS
        sure = [row for row, view in close.items() if _hand_share(view) == 1.0]
        starts = first if own else [row for row in wide if sure and row not in sure]
        nearest = {row: row if own else min(sure, key=lambda other: abs(other - row)) for row in starts}
        crops = {row: Crop.of_gripper(hands[at].X_CH, CLOSE_MARGIN, CLOSE_SIZE) for row, at in nearest.items()}
        for row, view in estimator.estimate(frames, camera, crops):
            hand = fit(view)
            if hand is not None and (own or row not in close or _hand_share(view) > _hand_share(close[row])):
                close[row] = view
                hands[row] = hand
    return close


def detect_all(estimator: DenseEstimator, frames: Frames, camera: Camera) -> ArmDetections:
    """Return the robot in all frames (T, H, W, 3) that show hand and arm, whatever the camera; no postures.

    Raises:
        UnmeasurableError: no frame shows a hand.
    """
    robot = find_robot(estimator, frames, camera, len(frames), searched=len(frames))
    if robot is None:
        raise UnmeasurableError(
            f"no gripper is seen in the {len(frames)} frames used: is it a Panda with the Franka hand?"
        )
    return robot


def find_links(
    estimator: DenseEstimator, frames: Frames, rows: NDArray[np.intp], camera: Camera, most: int
) -> ArmDetections:
    """Return the cells of links in the frames that show most of them, whatever gripper the arm carries.

    Args:
        estimator: source of dense estimates.
        frames: (T, H, W, 3) RGB.
        rows: numbers of the frames searched.
        camera: assumed camera; only its intrinsics matter, and little.
        most: greatest number of frames.

    Raises:
        UnmeasurableError: too few frames show links.
    """
    searched = rows[evenly(len(rows), _TRIED * most)]
    views = [
        pair
        for crop in Crop.tiles(camera)
        for pair in estimator.estimate(frames, camera, dict.fromkeys(searched.tolist(), crop))
    ]
    cells = find_correspondences(views, camera)
    cells = cells.take(np.isin(cells.part, ARM))
    count = np.bincount(cells.frame, minlength=len(frames))
    chosen = _best_seen({int(row): float(count[row]) for row in np.flatnonzero(count >= MIN_CELLS)}, len(frames), most)
    if len(chosen) < MIN_FRAMES:
        raise UnmeasurableError(
            f"links of the arm are seen in {len(chosen)} of {len(searched)} frames, at least {MIN_FRAMES} are needed"
        )
    own = [view.to_frame(view.part > RobotPart.BACKGROUND, camera) for row, view in views if row == chosen[0]]
    return ArmDetections(
        rows=np.array(chosen, dtype=np.intp),
        cells=cells.of_frames(np.array(chosen, dtype=np.intp)),
        finger_m=np.zeros(len(chosen)),
        robot=np.any(own, axis=0),
    )


def track_all(tracker: PoseTracker, frames: Frames, camera: Camera) -> ArmDetections:
    """Return the robot in all frames (T, H, W, 3) with the postures by a tracker, given the pose of the camera."""
    tracked = tracker.track(frames, camera)
    close = [(row, pose.view) for row, pose in enumerate(tracked.poses) if pose is not None]
    finger_m = [np.nan if pose is None else pose.finger_m for pose in tracked.poses]
    arms = [None if pose is None else pose.arm for pose in tracked.poses]
    return ArmDetections(
        rows=np.arange(len(frames)),
        cells=find_correspondences([*close, *enumerate(tracked.wide)], camera),
        finger_m=np.nan_to_num(np.array(finger_m), nan=UNSEEN_FINGER_M),
        robot=tracked.robot,
        q=np.stack([np.full(N_JOINTS, np.nan) if arm is None else arm.q for arm in arms]),
    )


def _visibility(view: GripperView) -> float:
    """Return how much of the robot a view shows: its parts, the gripper twice."""
    cells = np.bincount(view.part.ravel(), minlength=len(RobotPart))
    parts = (np.minimum(cells[list(ARM)], PART_CELLS) / PART_CELLS).sum()
    return float(parts + 2 * min(int(view.gripper.sum()), PART_CELLS) / PART_CELLS)


def _hand_share(view: GripperView) -> float:
    """Return how much of the hand a close view shows, 0..1."""
    return min(1.0, int((view.part == RobotPart.HAND).sum()) / _CLOSE_HAND_CELLS)


def _best_seen(visibility: Mapping[int, float], frames: int, most: int) -> list[int]:
    """Return the frames that show most in each of `most` stretches of a video of so many frames."""
    bounds = np.linspace(0, frames, most + 1)
    stretches = [[row for row in visibility if low <= row < high] for low, high in pairwise(bounds)]
    return [max(rows, key=lambda row: (visibility[row], -row)) for rows in stretches if rows]
