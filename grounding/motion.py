"""Motion of the camera, from features of the background."""

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.grounding.view import Frames

_MAX_FEATURES = 200
_MIN_FEATURES = 12
_MARGIN_PX = 15  # features this near the robot's outline may move with it
_ROUND_TRIP_PX = 0.5  # a feature followed there and back must return this close


def camera_motion_px(frames: Frames, robot: NDArray[np.bool_]) -> float | None:
    """Largest median displacement [px] of background features against the first frame.

    Features (Shi and Tomasi 1994) off the robot are followed by pyramidal Lucas-Kanade from the first frame to every
    other one; the median over the features leaves out what the robot moves. None when fewer than 12 can be followed.

    Args:
        frames: (T, H, W, 3) RGB.
        robot: (H, W) pixels of the first frame to leave out.
    """
    grey = [cv2.cvtColor(f, cv2.COLOR_RGB2GRAY) for f in frames]
    robot = np.asarray(cv2.dilate(robot.astype(np.uint8), np.ones((_MARGIN_PX, _MARGIN_PX), np.uint8)))
    mask = np.where(robot > 0, 0, 255).astype(np.uint8)
    start = cv2.goodFeaturesToTrack(grey[0], _MAX_FEATURES, 0.01, 6, mask=mask)
    if start is None or len(start) < _MIN_FEATURES:
        return None
    motion = []
    for image in grey[1:]:
        there, ok, _ = cv2.calcOpticalFlowPyrLK(grey[0], image, start, None)
        back, ok_back, _ = cv2.calcOpticalFlowPyrLK(image, grey[0], there, None)
        good = (ok[:, 0] > 0) & (ok_back[:, 0] > 0) & (np.linalg.norm((back - start)[:, 0], axis=1) < _ROUND_TRIP_PX)
        if good.sum() >= _MIN_FEATURES:
            motion.append(float(np.median(np.linalg.norm((there - start)[good, 0], axis=1))))
    return max(motion) if motion else None
