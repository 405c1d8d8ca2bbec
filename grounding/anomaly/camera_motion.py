"""Motion of the camera relative to the first frame, from features of the background."""

from dataclasses import dataclass, replace
from itertools import pairwise

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, make_pose, orthonormalize
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.anomaly.detection import Detection, sustained
from kinebench_drake.grounding.registration.image import follow_points
from kinebench_drake.grounding.tracking.camera_path import CameraPath, CameraWay
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.progress import count_steps

# Set on planted faults in home renders of seen assets, and checked on clean ones:
# `python -m benchmarks planted-videos --out faulty`, then `python -m benchmarks evaluate faulty`.
_CLEAR_PX = 2.0
"""Motion from which on a camera is followed before anything else is measured [px of an image 384 px wide]."""
_MOTION_QUANTILE = 0.3
"""Quantile of the features' displacements that is the motion.

Up to this share may be moved against it by the robot, up to the rest may be moved by the robot of a fixed camera."""
_MOTION_FEATURES = 12
"""Fewest features of a measured motion."""
_MOTION_FRAMES = 2
"""Fewest consecutive frames of a motion: a single one may have lost its features to the robot."""
_UNKNOWN_SHARE = 0.5
"""Share of the frames without a measured motion above which the motion of the camera is unknown."""
_ROTATION_SHARE = 0.5
"""Least share of the features that move as one rotation of the camera, of a motion of the camera."""

_MAX_FEATURES = 100
"""Features that are tracked at once."""
_ENOUGH_FEATURES = 40
"""Tracked features in a mask from which on no others are looked for."""
_LK_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.03)
"""End of the iterations of Lucas-Kanade: their number, and least step [px]."""
_MARGIN_PX = 15
"""Width of the margin of the robot's outline in which features may move with it [px]."""
_ROUND_TRIP_PX = 0.5
"""Largest error of a feature tracked forth and back [px]."""
_ROTATION_PASSES = 8
_TUKEY_PX = 1.5
"""Residual beyond which a feature has no weight for the rotation [px]."""

# Set on 103 films of 14 sources, fixed, moving and wrist cameras, in none of which a cut is found, and on joins of two
# of one size: of 87 it is found in 60, and not where both show one scene or a camera in motion begins or ends.
_CUT_SIZE_PX = (48, 36)
"""Width and height of the pictures that are compared [px]."""
_CUT_GREY = 6.0
"""Change of a pixel's grey value of 255 from which on it counts."""
_CUT_SHARE = 0.4
"""Least share of changed pixels of a cut."""
_CUT_RATIO = 2.0
"""Least ratio of this share to the greatest one around it."""
_CUT_WINDOW = 4
"""Frames before and after that are around it: frames may be repeated."""
_CUT_CORRELATION = 0.6
"""Correlation of the pictures before and after from which on only brightness or contrast has changed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraMotion:
    """Motion of the camera relative to the first frame."""

    px: Array
    """(T,) displacement of the background [px of the video]; NaN where too few features are tracked, or where they do
    not move according to one rotation."""
    R_AC: Array
    """(T, 3, 3) rotation of the camera in A, the camera of the first frame; the identity where unknown, and if it does
    not move."""
    unit_px: float
    """Pixels of the video per pixel of an image 384 px wide."""
    path: CameraPath | None = None
    """Camera of each frame, followed; None for a fixed camera, or one that could not be followed."""

    @property
    def moves(self) -> bool:
        """True if the motion is large enough to be compensated."""
        return (self.largest_px or 0.0) >= bounds.FIXED_PX * self.unit_px

    @property
    def is_clear(self) -> bool:
        """True if the camera clearly moves, or its motion is unknown."""
        return self.is_unknown or (self.largest_px or 0.0) >= _CLEAR_PX * self.unit_px

    @property
    def is_unknown(self) -> bool:
        """True if the background is lost in most frames, though the first one has features."""
        return bool(np.isfinite(self.px[0]) and np.isnan(self.px).mean() > _UNKNOWN_SHARE)

    @property
    def largest_px(self) -> float | None:
        """Largest displacement [px]; None if it is unknown in all frames but the first, which is its own reference."""
        others = self.px[1:] if len(self.px) > 1 else self.px
        return float(np.nanmax(self.px)) if np.isfinite(others).any() else None

    @property
    def lost(self) -> NDArray[np.bool_]:
        """(T,) frames whose camera is unknown, as it moved too far and was not followed."""
        far = np.asarray(np.nan_to_num(self.px, nan=0.0) > bounds.COMPENSABLE_PX * self.unit_px)
        return far if self.path is None else (far | np.isnan(self.px)) & ~self.path.followed

    @property
    def X_AC(self) -> Array:
        """(T, 4, 4) pose of the camera in A [m]; the identity if the camera counts as fixed.

        Where the camera was not followed it is a pure rotation: for the few pixels that are compensated, a translation
        of the camera looks nearly the same.
        """
        X_AC = make_pose(self.R_AC if self.moves else np.tile(np.eye(3), (len(self.px), 1, 1)), np.zeros(3))
        if self.path is not None:
            X_AC[self.path.followed] = self.path.X_AC[self.path.followed]
        return X_AC

    @property
    def X_AS(self) -> Array:
        """(T, 4, 4) pose in A of S, the camera of the stabilized frames: a translation [m]."""
        return make_pose(np.eye(3), np.zeros((len(self.px), 3)) if self.path is None else self.path.p_AC)

    @property
    def places(self) -> Array | None:
        """(T, 3) places of S in A [m]; None if the camera only turns."""
        return None if self.path is None or not self.path.p_AC.any() else self.path.p_AC

    def with_path(self, path: CameraPath) -> "CameraMotion":
        """Return the motion with the camera followed where that was possible, unless it hardly moves."""
        px = np.where(np.isnan(self.px) & path.followed, path.px, self.px)
        far = np.nanmax(np.where(path.followed, path.px, 0.0), initial=0.0) >= bounds.FIXED_PX * self.unit_px
        return replace(self, px=px, path=path) if far else self

    def stabilize(self, frames: Frames, camera: Camera) -> tuple[Frames, Camera]:
        """Warp the frames (T, H, W, 3) into the orientation of the first camera; lost frames stay as they are.

        Returns:
            The frames, and their camera: that of the first frame, at larger images where the camera turns far.
        """
        if self.path is not None:
            R_AC = np.where((self.path.followed | self.lost)[:, None, None], self.path.R_AC, self.R_AC)
            return replace(self.path, R_AC=R_AC).stabilize(frames, camera)
        if not self.moves:
            return frames, camera
        still = self.lost | (np.nan_to_num(self.px) <= 0)
        n = len(frames)
        R_AC = np.where(still[:, None, None], np.eye(3), self.R_AC)
        path = CameraPath(
            way=CameraWay.ROTATION, R_AC=R_AC, p_AC=np.zeros((n, 3)), zoom=np.ones(n), followed=~still, px=self.px
        )
        return path.stabilize(frames, camera)


def find_cuts(frames: Frames) -> list[int]:
    """Return the frames (T, H, W, 3) before which the whole picture changes at once and for good: another clip begins.

    A change of brightness is none, nor is a single frame that differs from both its neighbours.
    """
    grey = (cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in frames)
    small = [cv2.resize(image, _CUT_SIZE_PX, interpolation=cv2.INTER_AREA).ravel() for image in grey]
    pictures = np.array(small, dtype=np.float64)
    share = np.array([_changed_share(*pair) for pair in pairwise(pictures)])
    padded = np.pad(share, _CUT_WINDOW)
    around = np.delete(sliding_window_view(padded, 2 * _CUT_WINDOW + 1), _CUT_WINDOW, axis=1).max(axis=1)
    sudden = np.flatnonzero(share >= np.maximum(_CUT_SHARE, _CUT_RATIO * around)) + 1
    return [k for k in sudden.tolist() if k + 1 < len(frames) and _is_cut(*pictures[k - 1 : k + 2])]


def _is_cut(before: Array, after: Array, later: Array) -> bool:
    """Return whether a picture is of another scene than the one before, and the next one as well."""
    if not after.std() or not before.std():  # a black picture shows no scene
        return False
    is_other = float(np.corrcoef(before, after)[0, 1]) < _CUT_CORRELATION
    return is_other and _changed_share(before, later) >= _CUT_SHARE


def _changed_share(before: Array, after: Array) -> float:
    """Return the share of the pixels of a picture whose grey value changes, up to a change of all of them."""
    change = after - before
    return float((np.abs(change - np.median(change)) > _CUT_GREY).mean())


class FeatureTracks:
    """Features of a video's first frame, tracked to every other one; each once, whatever the mask."""

    def __init__(self, frames: Frames) -> None:
        """Create the tracks of `frames` (T, H, W, 3), RGB; none is computed yet."""
        self._frames = frames
        self._first = cv2.cvtColor(frames[0], cv2.COLOR_RGB2GRAY)
        self._column: dict[tuple[float, float], int] = {}
        self._now = np.zeros((len(frames) - 1, 0, 2), np.float32)
        self._good = np.zeros(self._now.shape[:2], dtype=bool)

    def __len__(self) -> int:
        """Return the number T of frames."""
        return len(self._frames)

    def track(self, mask: NDArray[np.uint8]) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Track the features (Shi and Tomasi 1994) in `mask` (H, W) by pyramidal Lucas-Kanade, forth and back.

        Returns:
            Places (N, 2) in the first frame and (T - 1, N, 2) in the others [px]; whether (T - 1, N) they are there.
        """
        places = [(u, v) for u, v in self._column if mask[int(v), int(u)]]
        if len(places) < _ENOUGH_FEATURES:
            corners = cv2.goodFeaturesToTrack(self._first, _MAX_FEATURES, 0.01, 6, mask=mask)
            places = [] if corners is None else [(float(u), float(v)) for u, v in corners[:, 0]]
        start = np.array(places, np.float32).reshape(-1, 2)
        new = [k for k, place in enumerate(places) if place not in self._column]
        if new and len(self) > 1:
            self._column.update({places[k]: len(self._column) + n for n, k in enumerate(new)})
            frames = count_steps(self._frames[1:], "frames compared with the first", len(self) - 1)
            others = (cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in frames)
            points = start[new]
            tracked = [follow_points(self._first, im, points, _ROUND_TRIP_PX, criteria=_LK_CRITERIA) for im in others]
            self._now = np.concatenate([self._now, np.stack([now for now, _ in tracked])], axis=1)
            self._good = np.concatenate([self._good, np.stack([good for _, good in tracked])], axis=1)
        columns = [self._column[place] for place in places] if len(self) > 1 else []
        first = np.asarray(start, dtype=np.float64) + 0.5
        return first, np.asarray(self._now[:, columns], dtype=np.float64) + 0.5, self._good[:, columns]


def measure_camera_motion(tracks: FeatureTracks, robot: NDArray[np.bool_], camera: Camera) -> CameraMotion:
    """Measure the motion of the camera by tracking the background.

    A quantile of the displacements of features off the robot is the motion of the camera if at least half of them move
    according to one rotation of the camera. The first frame shows the `robot` at some (H, W) pixels.
    """
    n = len(tracks)
    px = np.full(n, np.nan)
    R_AC = np.repeat(np.eye(3)[None], n, axis=0)
    margin = np.ones((_MARGIN_PX, _MARGIN_PX), np.uint8)
    mask = np.where(cv2.dilate(robot.astype(np.uint8), margin) > 0, 0, 255).astype(np.uint8)
    start, there, good = tracks.track(mask)
    if len(start) >= _MOTION_FEATURES:
        px[0] = 0.0
        places: dict[int, tuple[Array, Array]] = {}
        for i in (1 + np.flatnonzero(good.sum(axis=1) >= _MOTION_FEATURES)).tolist():
            first = start[good[i - 1]]
            now = there[i - 1, good[i - 1]]
            px[i] = np.quantile(np.linalg.norm(now - first, axis=1), _MOTION_QUANTILE)
            places[i] = first, now
        if np.nanmax(px) >= bounds.FIXED_PX * camera.unit_px:  # else it counts as fixed
            for i, (first, now) in places.items():
                R, share = _rotation(first, now, camera)
                if share >= _ROTATION_SHARE or px[i] < bounds.FIXED_PX * camera.unit_px:
                    R_AC[i] = R
                else:
                    px[i] = np.nan
    return CameraMotion(px=px, R_AC=R_AC, unit_px=camera.unit_px)


def _rotation(first: Array, now: Array, camera: Camera) -> tuple[Array, float]:
    """Return the rotation (3, 3) of the camera that moves features from `first` to `now` (N, 2) [px], and their share.

    Kabsch (1976) on lines of sight with Tukey's weights, so that moved objects have no influence. The share is that of
    the features that move according to the rotation.
    """
    one = np.ones(len(first))
    rays = [np.column_stack([(px - [camera.cx, camera.cy]) / [camera.fx, camera.fy], one]) for px in (first, now)]
    lines = [ray / np.linalg.norm(ray, axis=1, keepdims=True) for ray in rays]
    weight = np.ones(len(first))
    R = np.eye(3)
    error_px = np.zeros(len(first))
    for _ in range(_ROTATION_PASSES):
        R = orthonormalize((lines[0] * weight[:, None]).T @ lines[1])
        error_px = camera.fx * np.linalg.norm(lines[0] - lines[1] @ R.T, axis=1)
        cut = max(_TUKEY_PX, 3.0 * float(np.median(error_px)))
        weight = np.clip(1.0 - (error_px / cut) ** 2, 0.0, 1.0) ** 2 + 1e-9
    return R, float((error_px < 2.0 * _TUKEY_PX).mean())


def find_camera_motion(motion: CameraMotion) -> Detection:
    """Detect frames in which the camera is not in its first pose; severity: the largest motion [px of the video]."""
    px = sustained(motion.px, _MOTION_FRAMES)
    return Detection.from_score(AnomalyKind.CAMERA, px / (bounds.MOVING_PX * motion.unit_px), px)
