"""Detection of the robot in the frames of a video whose camera is unknown: cells of the networks' views, in pixels.

A crop is a homography of the image, so the pixel of a cell does not depend on the focal length that the crop was laid
out with; only the crop's shape does, a little.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.camera.robot_points import CalibrationCorrespondences, find_correspondences
from kinebench_drake.grounding.registration.fit import UNSEEN_FINGER_M, HandFit, finger_or_default, fit
from kinebench_drake.grounding.tracking.crop import CLOSE_MARGIN, CLOSE_SIZE, Crop
from kinebench_drake.grounding.tracking.localization import PART_CELLS, find_region, likeliest_gripper
from kinebench_drake.grounding.tracking.tracker import PoseTracker
from kinebench_drake.grounding.tracking.view import DenseEstimator, GripperView
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.panda.description import ARM, RobotPart
from kinebench_drake.models.robot import N_JOINTS
from kinebench_drake.segments import evenly

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

    def count_cells(self, part: RobotPart) -> NDArray[np.intp]:
        """Return the number (T,) of cells that show a part."""
        return np.bincount(self.cells.frame[self.cells.part == part], minlength=len(self.rows))


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
        unsure = [row for row in wide if row not in sure] if sure else []
        starts = first if own else unsure
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
