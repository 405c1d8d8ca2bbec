"""Difference between a generated clip and its execution, frame by frame."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.suites.rollout import RolloutVideo

_RANGE = 255
_WINDOW = 7  # of structural similarity [px]
GAP_METRICS = {
    "gap_robot_iou": "robot_iou",
    "gap_gripper_m": "distance_m",
    "gap_gripper_rad": "angle_rad",
    "gap_psnr_db": "psnr_db",
    "gap_ssim": "ssim",
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
    psnr_db: Array
    """(T,) peak signal-to-noise ratio; infinite where the frames are equal."""
    ssim: Array
    """(T,) structural similarity of the grey frames (Wang et al., IEEE Trans. Image Processing 13, 2004)."""


def measure_gap(
    generated: NDArray[np.uint8], generated_robot: NDArray[np.bool_], generated_X_BG: Array, executed: RolloutVideo
) -> Gap:
    """Compare a generated clip with its execution, which may be shorter.

    Args:
        generated: (T, H, W, 3) frames, scaled to the size of the executed ones.
        generated_robot: (T, H, W) pixels of the robot in them.
        generated_X_BG: (T, 4, 4) panda_hand_tcp as grounded [m]; NaN where unknown.

    Raises:
        InputError: the execution has more frames than the clip.
    """
    frames = len(executed.rgb)
    if frames > len(generated):
        raise InputError(f"{frames} frames were executed of {len(generated)} generated ones")
    size = executed.rgb.shape[2], executed.rgb.shape[1]
    iou, psnr, ssim = (np.empty(frames) for _ in range(3))
    for i in range(frames):
        image = cv2.resize(generated[i], size, interpolation=cv2.INTER_AREA)
        robot = cv2.resize(generated_robot[i].astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
        union = int((robot | executed.robot[i]).sum())
        iou[i] = (robot & executed.robot[i]).sum() / union if union else np.nan
        psnr[i] = signal_noise_ratio_db(executed.rgb[i], image)
        ssim[i] = structural_similarity(*(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY) for rgb in (executed.rgb[i], image)))
    distance, angle = pose_difference(generated_X_BG[:frames], executed.X_BG)
    return Gap(robot_iou=iou, distance_m=distance, angle_rad=angle, psnr_db=psnr, ssim=ssim)


def signal_noise_ratio_db(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
    """Return the peak signal-to-noise ratio [dB] of two images; infinite where they are equal."""
    with np.errstate(divide="ignore"):
        return float(10.0 * np.log10(np.float64(_RANGE**2 * a.size) / cv2.norm(a, b, cv2.NORM_L2SQR)))


def structural_similarity(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
    """Return the mean structural similarity of two grey images (H, W) over all windows of 7 x 7 px in them."""
    n = _WINDOW**2
    edge = _WINDOW // 2
    x = a.astype(np.float64)
    y = b.astype(np.float64)

    def mean(image: Array) -> Array:
        return np.asarray(cv2.boxFilter(image, -1, (_WINDOW, _WINDOW)))[edge:-edge, edge:-edge]

    mean_x = mean(x)
    mean_y = mean(y)
    product = mean_x * mean_y
    squares = mean_x**2 + mean_y**2
    covariance = n / (n - 1) * (mean(x * y) - product)
    variances = n / (n - 1) * (mean(x * x + y * y) - squares)
    c_1 = (0.01 * _RANGE) ** 2
    c_2 = (0.03 * _RANGE) ** 2
    return float(((2.0 * product + c_1) * (2.0 * covariance + c_2) / ((squares + c_1) * (variances + c_2))).mean())


def average_gaps(gaps: Sequence[Gap]) -> tuple[dict[str, float | None], dict[str, str]]:
    """Return the metrics of an episode's clips, and why some are None, by name.

    Means over all executed frames but each clip's first, which both videos share. Distance and angle of the grippers
    are None if the generated one is lost in any of these frames, since the mean over the others may be smaller. Frames
    that are equal to the last pixel, whose signal-to-noise ratio is infinite, are left out of its mean.
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
            reasons[metric] = "the videos are equal" if not lost else "no frame shows the robot"
        else:
            metrics[metric] = float(finite.mean())
    return metrics, reasons
