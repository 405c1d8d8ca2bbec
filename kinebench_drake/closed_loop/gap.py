"""What was imagined beside what was executed, frame by frame."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.suites.rollout import RolloutVideo

_RANGE = 255


@dataclass(frozen=True, slots=True, kw_only=True)
class Gap:
    """How far two films of one clip are apart."""

    robot_iou: Array
    """(T,) intersection over union of the robot's pixels; NaN where neither film shows it."""
    distance_m: Array
    """(T,) between the two grippers' TCPs [m]; NaN where one is not known."""
    angle_rad: Array
    """(T,) between their orientations [rad]."""
    psnr_db: Array
    """(T,) peak signal-to-noise ratio; infinite where the frames are equal."""
    ssim: Array
    """(T,) structural similarity of the grey frames (Wang et al., IEEE Trans. Image Processing 13, 2004)."""


def measure_gap(
    imagined: NDArray[np.uint8], imagined_robot: NDArray[np.bool_], imagined_X_BG: Array, executed: RolloutVideo
) -> Gap:
    """Hold the frames of an imagined clip against those of its execution, as far as that went.

    Args:
        imagined: (T, H, W, 3) frames; of another size than the executed ones they are scaled.
        imagined_robot: (T, H, W) their pixels that show the robot.
        imagined_X_BG: (T, 4, 4) panda_hand_tcp as read from them [m]; NaN where unknown.
        executed: the video of the execution, of T frames or less.

    Raises:
        InputError: the execution has more frames than what was imagined.
    """
    frames = len(executed.rgb)
    if frames > len(imagined):
        raise InputError(f"{frames} frames were executed of {len(imagined)} imagined ones")
    size = executed.rgb.shape[2], executed.rgb.shape[1]
    iou, psnr, ssim = (np.empty(frames) for _ in range(3))
    for i in range(frames):
        picture = cv2.resize(imagined[i], size, interpolation=cv2.INTER_AREA)
        robot = cv2.resize(imagined_robot[i].astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
        union = int((robot | executed.robot[i]).sum())
        iou[i] = (robot & executed.robot[i]).sum() / union if union else np.nan
        with np.errstate(divide="ignore"):
            psnr[i] = peak_signal_noise_ratio(executed.rgb[i], picture, data_range=_RANGE)
        grey = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (executed.rgb[i], picture)]
        ssim[i] = structural_similarity(*grey, data_range=_RANGE)
    distance, angle = pose_difference(imagined_X_BG[:frames], executed.X_BG)
    return Gap(robot_iou=iou, distance_m=distance, angle_rad=angle, psnr_db=psnr, ssim=ssim)
