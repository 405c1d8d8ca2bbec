"""Motion of the camera relative to the first frame, from features of the background."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, make_pose, orthonormalize
from kinebench_drake.grounding.anomaly.detection import Detection, sustained
from kinebench_drake.grounding.view import Frames
from kinebench_drake.types import AnomalyKind

MOVING_PX = 1.2
"""Least motion of a moving camera [px of an image 384 px wide]."""
LEAST_PX = 0.5
"""Largest motion below which the camera counts as fixed and nothing is compensated [px, likewise]."""
COMPENSABLE_PX = 8.0
"""Largest motion that is compensated; beyond it the base frame is lost [px, likewise]."""
MIN_FEATURES = 12
"""Least number of features for a measurement."""
SHARE = 0.3
"""Quantile of the features' displacements that counts as the motion: up to this share may be moved against it by the
robot, and up to the rest may be moved by the robot while the camera is fixed."""
MIN_FRAMES = 2
"""Least number of consecutive frames of a motion: a single one may have lost its features to the robot."""
_MAX_FEATURES = 200
_MARGIN_PX = 15  # features this near the robot's outline may move with it
_ROUND_TRIP_PX = 0.5  # largest error of a feature tracked forth and back
_ROTATION_PASSES = 8
_TUKEY_PX = 1.5  # residual beyond which a feature has no weight for the rotation
_MIN_AGREEING = 0.5  # least share of features that move according to the rotation


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraMotion:
    """Motion of the camera relative to the first frame."""

    px: Array
    """(T,) displacement of the background [px of the video]; NaN where too few features are tracked, or where they do
    not move according to one rotation."""
    R_AC: Array
    """(T, 3, 3) rotation of the camera in A, the camera frame of the first frame; the identity where unknown."""
    unit_px: float
    """Pixels of the video per pixel of an image 384 px wide."""

    @property
    def moves(self) -> bool:
        """True if the motion is large enough to be compensated."""
        return (self.largest_px or 0.0) >= LEAST_PX * self.unit_px

    @property
    def largest_px(self) -> float | None:
        """Largest displacement [px]; None if it is unknown in all frames."""
        return float(np.nanmax(self.px)) if np.isfinite(self.px).any() else None

    @property
    def lost(self) -> NDArray[np.bool_]:
        """(T,) frames whose motion is too large to be compensated."""
        return np.asarray(np.nan_to_num(self.px, nan=0.0) > COMPENSABLE_PX * self.unit_px)

    @property
    def X_AC(self) -> Array:
        """(T, 4, 4) pose of the camera in A [m]: a pure rotation, the identity if the camera counts as fixed.

        For the few pixels that are compensated, a translation of the camera looks nearly the same as a rotation.
        """
        R_AC = self.R_AC if self.moves else np.repeat(np.eye(3)[None], len(self.px), axis=0)
        return make_pose(R_AC, np.zeros(3))

    def stabilize(self, frames: Frames, camera: Camera) -> Frames:
        """Warp the frames (T, H, W, 3) into the camera of the first frame; lost frames stay as they are."""
        if not self.moves:
            return frames
        shift = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])  # OpenCV's pixel centres are integers
        K = np.linalg.inv(shift) @ camera.K
        stabilized = frames.copy()
        for i in np.flatnonzero(~self.lost & (np.nan_to_num(self.px) > 0)):
            homography = K @ self.R_AC[i] @ np.linalg.inv(K)
            stabilized[i] = cv2.warpPerspective(
                frames[i], homography, (camera.width, camera.height), borderMode=cv2.BORDER_REPLICATE
            )
        return stabilized


def measure_camera_motion(frames: Frames, robot: NDArray[np.bool_], camera: Camera) -> CameraMotion:
    """Measure the motion of the camera by tracking the background.

    Features (Shi and Tomasi 1994) off the robot are tracked by pyramidal Lucas-Kanade from the first frame to every
    other one, forth and back. Their displacement, at the quantile `SHARE`, is the motion of the camera if at least half
    of them move according to one rotation of the camera.

    Args:
        frames: (T, H, W, 3) RGB.
        robot: (H, W) pixels of the first frame that show the robot.
        camera: camera of the first frame.
    """
    n = len(frames)
    px, R_AC = np.full(n, np.nan), np.repeat(np.eye(3)[None], n, axis=0)
    grey = [cv2.cvtColor(f, cv2.COLOR_RGB2GRAY) for f in frames]
    margin = np.ones((_MARGIN_PX, _MARGIN_PX), np.uint8)
    mask = np.where(cv2.dilate(robot.astype(np.uint8), margin) > 0, 0, 255).astype(np.uint8)
    start = cv2.goodFeaturesToTrack(grey[0], _MAX_FEATURES, 0.01, 6, mask=mask)
    if start is not None and len(start) >= MIN_FEATURES:
        px[0] = 0.0
        for i, image in enumerate(grey[1:], 1):
            forth, ok, _ = cv2.calcOpticalFlowPyrLK(grey[0], image, start, None)
            back, ok_back, _ = cv2.calcOpticalFlowPyrLK(image, grey[0], forth, None)
            returned = np.linalg.norm((back - start)[:, 0], axis=1) < _ROUND_TRIP_PX
            good = (ok[:, 0] > 0) & (ok_back[:, 0] > 0) & returned
            if good.sum() >= MIN_FEATURES:
                first, now = (np.asarray(p[good, 0], dtype=np.float64) + 0.5 for p in (start, forth))
                R, share = _rotation(first, now, camera)
                moved = float(np.quantile(np.linalg.norm(now - first, axis=1), SHARE))
                if share >= _MIN_AGREEING or moved < LEAST_PX * camera.unit_px:
                    px[i], R_AC[i] = moved, R
    return CameraMotion(px=px, R_AC=R_AC, unit_px=camera.unit_px)


def _rotation(first: Array, now: Array, camera: Camera) -> tuple[Array, float]:
    """Return the rotation (3, 3) of the camera that moves features from `first` to `now` (N, 2) [px], and their share.

    Kabsch (1976) on lines of sight with Tukey's weights, so that moved objects have no influence. The share is that of
    the features that move according to the rotation.
    """
    lines = []
    for pixels in (first, now):
        rays = np.column_stack([(pixels - [camera.cx, camera.cy]) / [camera.fx, camera.fy], np.ones(len(pixels))])
        lines.append(rays / np.linalg.norm(rays, axis=1, keepdims=True))
    weight = np.ones(len(first))
    R, error_px = np.eye(3), np.zeros(len(first))
    for _ in range(_ROTATION_PASSES):
        R = orthonormalize((lines[0] * weight[:, None]).T @ lines[1])
        error_px = camera.fx * np.linalg.norm(lines[0] - lines[1] @ R.T, axis=1)
        cut = max(_TUKEY_PX, 3.0 * float(np.median(error_px)))
        weight = np.clip(1.0 - (error_px / cut) ** 2, 0.0, 1.0) ** 2 + 1e-9
    return R, float((error_px < 2.0 * _TUKEY_PX).mean())


def find_camera_motion(motion: CameraMotion) -> Detection:
    """Detect frames in which the camera is not in its first pose; severity: the largest motion [px of the video]."""
    px = sustained(motion.px, MIN_FRAMES)
    return Detection.from_score(AnomalyKind.CAMERA, px / (MOVING_PX * motion.unit_px), px)
