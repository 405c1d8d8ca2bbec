"""Motion of the camera against the first frame, from features of the background."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, make_pose, orthonormalize
from kinebench_drake.grounding.anomaly.detection import Detection, detection_segments, sustained
from kinebench_drake.grounding.view import Frames
from kinebench_drake.types import Anomaly, AnomalyKind

MOVING_PX = 1.2
"""From this motion on [px of a picture 384 px wide] the camera is called moving."""
LEAST_PX = 0.5
"""A camera whose largest motion is less than this stands still: nothing is compensated."""
COMPENSABLE_PX = 8.0
"""Up to this motion poses are carried back to the first frame's camera; beyond it the base is lost."""
MIN_FEATURES = 12
"""Fewer tell nothing."""
SHARE = 0.3
"""The motion is what all but this share of the features exceed: so many may be moved by the robot the other way, and up
to the rest of them may be moved by it where the camera stands still."""
MIN_FRAMES = 2
"""Frames in a row that must say so: one may have lost its features to the robot."""
_MAX_FEATURES = 200
_MARGIN_PX = 15  # features this near the robot's outline may move with it
_ROUND_TRIP_PX = 0.5  # a feature followed there and back must return this close
_ROTATION_PASSES = 8
_TUKEY_PX = 1.5  # features off by more than this do not count for the rotation
_MIN_AGREEING = 0.5  # share of the features that must move as the rotation has it


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraMotion:
    """How the camera moves."""

    px: Array
    """(T,) displacement of the background against the first frame, in pixels of the video; NaN where too few features
    can be followed, or where they do not move as one."""
    R_AC: Array
    """(T, 3, 3) the camera's axes in those of the first frame's camera, A; the identity where unknown."""
    unit_px: float
    """Pixels of the video that make one of a picture 384 px wide."""

    @property
    def moves(self) -> bool:
        """Whether there is something to compensate."""
        return (self.largest_px or 0.0) >= LEAST_PX * self.unit_px

    @property
    def largest_px(self) -> float | None:
        """Largest displacement [px]; None where nothing can be said."""
        return float(np.nanmax(self.px)) if np.isfinite(self.px).any() else None

    @property
    def lost(self) -> NDArray[np.bool_]:
        """(T,) frames whose motion is too large to be compensated."""
        return np.asarray(np.nan_to_num(self.px, nan=0.0) > COMPENSABLE_PX * self.unit_px)

    @property
    def X_AC(self) -> Array:
        """(T, 4, 4) the camera in the frame of the first frame's camera [m].

        What moves the background is taken for a turn about the camera's centre: for the few pixels that are compensated
        a shift of the camera looks nearly the same. A camera that stands still is left where it is.
        """
        R_AC = self.R_AC if self.moves else np.repeat(np.eye(3)[None], len(self.px), axis=0)
        return make_pose(R_AC, np.zeros(3))

    def steadied(self, frames: Frames, camera: Camera) -> Frames:
        """The frames (T, H, W, 3) as the first frame's camera would have seen them; those that are lost as they are."""
        if not self.moves:
            return frames
        shift = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])  # OpenCV's pixel centres are integers
        K = np.linalg.inv(shift) @ camera.K
        steady = frames.copy()
        for i in np.flatnonzero(~self.lost & (np.nan_to_num(self.px) > 0)):
            turned = K @ self.R_AC[i] @ np.linalg.inv(K)
            steady[i] = cv2.warpPerspective(
                frames[i], turned, (camera.width, camera.height), borderMode=cv2.BORDER_REPLICATE
            )
        return steady


def measure_camera_motion(frames: Frames, robot: NDArray[np.bool_], camera: Camera) -> CameraMotion:
    """Follow the background through a video.

    Features (Shi and Tomasi 1994) off the robot are followed by pyramidal Lucas-Kanade from the first frame to every
    other one, there and back. What most of them exceed is the motion of the camera, if at least half of them move as
    the background does when a camera turns.

    Args:
        frames: (T, H, W, 3) RGB.
        robot: (H, W) pixels of the first frame to leave out.
        camera: that of the first frame.
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
            there, ok, _ = cv2.calcOpticalFlowPyrLK(grey[0], image, start, None)
            back, ok_back, _ = cv2.calcOpticalFlowPyrLK(image, grey[0], there, None)
            returned = np.linalg.norm((back - start)[:, 0], axis=1) < _ROUND_TRIP_PX
            good = (ok[:, 0] > 0) & (ok_back[:, 0] > 0) & returned
            if good.sum() >= MIN_FEATURES:
                first, now = (np.asarray(p[good, 0], dtype=np.float64) + 0.5 for p in (start, there))
                R, share = _turn(first, now, camera)
                moved = float(np.quantile(np.linalg.norm(now - first, axis=1), SHARE))
                if share >= _MIN_AGREEING or moved < LEAST_PX * camera.unit_px:
                    px[i], R_AC[i] = moved, R
    return CameraMotion(px=px, R_AC=R_AC, unit_px=camera.unit_px)


def _turn(first: Array, now: Array, camera: Camera) -> tuple[Array, float]:
    """The rotation (3, 3) of a camera that sees `now` (N, 2) what it saw at `first` [px], and who agrees with it.

    Kabsch (1976) on lines of sight, reweighted after Tukey: things that were moved do not count.
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
    """Frames in which the camera is not where it was; severity: by how much at most [px of the video]."""
    px = sustained(motion.px, MIN_FRAMES)
    score = px / (MOVING_PX * motion.unit_px)
    anomalies = tuple(
        Anomaly(kind=AnomalyKind.CAMERA, frame_start=a, frame_end=b, severity=float(px[a : b + 1].max()))
        for a, b in detection_segments(score >= 1.0)
    )
    return Detection(kind=AnomalyKind.CAMERA, score=score, anomalies=anomalies)
