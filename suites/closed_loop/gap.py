"""Difference between a generated clip and its execution, frame by frame."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.suites.rollout import RolloutVideo

GAP_METRICS = {
    "gap_robot_iou": "robot_iou",
    "gap_gripper_m": "distance_m",
    "gap_gripper_rad": "angle_rad",
}
"""Metrics of an episode and the fields of `Gap` that they average."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Gap:
    """Difference between the generated and the executed video of a clip."""

    robot_iou: Array
    """(T,) intersection over union of the robot's pixels; NaN where neither shows it."""
    distance_m: Array
    """(T,) distance of the two TCPs [m]; NaN where one is unknown."""
    angle_rad: Array
    """(T,) angle between their orientations [rad]."""


def measure_gap(generated_robot: NDArray[np.bool_], generated_X_BG: Array, executed: RolloutVideo) -> Gap:
    """Compare a generated clip with its execution, which may be shorter.

    Args:
        generated_robot: (T, H, W) pixels of the robot in its frames, scaled to the size of the executed ones.
        generated_X_BG: (T, 4, 4) panda_hand_tcp as grounded [m]; NaN where unknown.

    Raises:
        InputError: the execution has more frames than the clip.
    """
    frames = len(executed.rgb)
    if frames > len(generated_robot):
        raise InputError(f"{frames} frames were executed of {len(generated_robot)} generated ones")
    size = executed.rgb.shape[2], executed.rgb.shape[1]
    iou = np.empty(frames)
    for i in range(frames):
        robot = cv2.resize(generated_robot[i].astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
        union = int((robot | executed.robot[i]).sum())
        iou[i] = (robot & executed.robot[i]).sum() / union if union else np.nan
    distance, angle = pose_difference(generated_X_BG[:frames], executed.X_BG)
    return Gap(robot_iou=iou, distance_m=distance, angle_rad=angle)


def average_gaps(gaps: Sequence[Gap]) -> tuple[dict[str, float | None], dict[str, str]]:
    """Return the metrics of an episode's clips, and why some are None, by name.

    Means over all executed frames but each clip's first, which both videos share. Distance and angle of the grippers
    are None if the generated one is lost in any of these frames, since the mean over the others may be smaller.
    """
    metrics = dict[str, float | None]()
    reasons = dict[str, str]()
    for metric, name in GAP_METRICS.items():
        values = np.concatenate([np.empty(0), *(getattr(gap, name)[1:] for gap in gaps)])
        lost = int(np.isnan(values).sum())
        finite = values[np.isfinite(values)]
        metrics[metric] = None
        if not values.size:
            reasons[metric] = "nothing was executed"
        elif lost and name in ("distance_m", "angle_rad"):
            reasons[metric] = f"the generated gripper is lost in {lost} of {len(values)} executed frames"
        elif not finite.size:
            reasons[metric] = "no frame shows the robot"
        else:
            metrics[metric] = float(finite.mean())
    return metrics, reasons
