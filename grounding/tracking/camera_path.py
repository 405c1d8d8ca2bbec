"""Path of a slowly moving camera, from features of the background: rotation, then zoom, then place.

The simplest way of moving that explains the tracks of the features is taken. A rotation and a zoom need no depth. The
place does: features get depths of their own (bundle adjustment by turns of camera and depths), and the table top, on
which many of them lie, gives the scale.
"""

from dataclasses import dataclass, replace
from enum import Enum

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, make_pose, rotation_angle, rotation_exp
from kinebench_drake.grounding.registration.image import follow_points
from kinebench_drake.io.frames import Frames, Image, map_frames
from kinebench_drake.io.jsonl import Json

# Chosen by hand on own renders; checked by `python -m benchmarks evaluate` on these, by `footage` on others' videos.
_FOLLOWED_RAD = float(np.deg2rad(15.0))
"""Largest rotation from the first camera that is followed [rad]."""
_FOLLOWED_M = 0.15
"""Largest distance from the first camera that is followed [m]."""
_FOLLOWED_ZOOM = 0.2
"""Largest relative zoom from the first camera that is followed."""
_PATH_FEATURES = 16
"""Fewest features of a frame that follow the camera."""
_PATH_GAIN = 0.05
"""Least increase of the features' explained share by a less simple way of moving."""
_MIN_ON_TABLE = 0.3
"""Least share of the features with depth that lie on the table top and make it the scale."""
_EXPLAINED_SHARE = 0.5
"""Least share of a frame's features that the path of the camera explains."""
_AGREEING_PX = 1.0
"""Greatest residual of an explained feature; all lengths in pixels here are of an image 384 px wide."""
_MAX_FEATURES = 250
_SPACING_PX = 6.0
_ROBOT_MARGIN_PX = 11.0
_ROUND_TRIP_PX = 0.7
_DRIFT_PX = 2.0
_DETAIL_PX = 6.0
"""Scale of the details that are tracked [px]."""
_NOISE = 2.0
"""Contrast below which details are noise [grey levels of 255]."""
_RANSAC_PX = 3.0
"""Largest error of a feature that follows the homography of a plane [px]."""
_MIN_INLIERS = 0.3
"""Least share of the features that follow it."""
_TUKEY_PX = 2.5
_STEPS = 8
_SWEEPS = 40
_LEAST_MARGIN_PX = 16.0
"""Least margin by which stabilized images are extended [px]."""
_MAX_MARGIN = 0.25
"""Largest margin relative to the image."""
_FAR_M = 4.0
"""Depth of features that do not look at the table [m]; its inverse is a weak prior."""
_TABLE_SIGMA = 0.02
"""Relative standard deviation of the inverse depth of a feature on the table."""


class CameraWay(Enum):
    """How a camera moves."""

    FIXED = ""
    ROTATION = "rotation"
    ZOOM = "rotation and zoom"
    PLACE = "rotation and place"


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraPath:
    """Camera C of each frame in A, the camera of the reference image."""

    way: CameraWay
    R_AC: Array
    """(T, 3, 3) rotation; this and the following are those of a camera that has not moved where it was not followed."""
    p_AC: Array
    """(T, 3) place [m]."""
    zoom: Array
    """(T,) focal length over that of A."""
    followed: NDArray[np.bool_]
    """(T,) frames in which the camera was followed."""
    px: Array
    """(T,) median displacement of the features [px]; NaN where it was not followed."""

    @property
    def X_AC(self) -> Array:
        """(T, 4, 4) pose of the camera in A [m]."""
        return make_pose(self.R_AC, self.p_AC)

    def to_json(self) -> dict[str, Json]:
        """Serialize the largest changes from the first camera into `camera_path` of a row."""
        farthest = int(np.argmax(np.abs(self.zoom - 1.0)))
        return {
            "way": self.way.value,
            "turn_rad": round(float(rotation_angle(self.R_AC).max()), 5),
            "distance_m": round(float(np.linalg.norm(self.p_AC, axis=1).max()), 5),
            "zoom": round(float(self.zoom[farthest]), 5),
            "followed_fraction": round(float(self.followed.mean()), 4),
        }

    def stabilize(self, frames: Frames, camera: Camera, *, extends: bool = True) -> tuple[Frames, Camera]:
        """Warp the frames (T, H, W, 3) into cameras oriented like A, with its focal length.

        If `extends`, the images are extended at all sides, like their camera, where cameras show more than A does.
        """
        size = np.array([camera.width, camera.height])
        K = camera.K
        K_C = np.repeat(K[None], len(frames), axis=0)
        K_C[:, [0, 1], [0, 1]] *= self.zoom[:, None]
        M_AC = K @ self.R_AC @ np.linalg.inv(K_C)
        corners = np.array([[x, y, 1.0] for x in (0.0, size[0]) for y in (0.0, size[1])])
        shown = np.einsum("tij,nj->tni", M_AC[self.followed], corners)
        shown = shown[..., :2] / shown[..., 2:]
        over = max(0.0, float(-shown.min(initial=0.0)), float((shown - size).max(initial=0.0)))
        extends = extends and over > _LEAST_MARGIN_PX * camera.unit_px
        margin = int(np.ceil(min(over, _MAX_MARGIN * size.max()))) if extends else 0
        width = camera.width + 2 * margin
        height = camera.height + 2 * margin
        wide = replace(camera, width=width, height=height, cx=camera.cx + margin, cy=camera.cy + margin)
        half = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])  # OpenCV's pixel centres are integers
        shift = np.array([[1.0, 0.0, margin], [0.0, 1.0, margin], [0.0, 0.0, 1.0]])
        M = np.linalg.inv(half) @ shift @ M_AC @ half

        def warp(number: int, frame: Image) -> Image:
            warped = cv2.warpPerspective(frame, M[number], (width, height), borderMode=cv2.BORDER_REPLICATE)
            return np.asarray(warped, np.uint8)

        return map_frames(frames, warp), wide


@dataclass(frozen=True, slots=True, kw_only=True)
class _Fit:
    """Cameras of all frames, and inverse depths of the features."""

    cameras: Array
    """(T, 7) rotation vector, place, logarithm of the zoom."""
    inverse_depth: Array
    """(N,) [1/m]."""
    residual: Array
    """(T, N) distance of the features from their prediction [px]; NaN where they are not tracked."""


def follow_camera(
    frames: Frames, reference: Image, robot: NDArray[np.bool_], camera: Camera, table_height_m: float = 0.0
) -> CameraPath:
    """Follow the camera from the reference image (H, W, 3) of `camera`, A, through the frames (T, H, W, 3).

    The reference image shows the `robot` at some pixels (H, W); the height of the table top is in the robot base frame.
    """
    start, now = _track_features(frames, reference, robot, camera)
    n = len(frames)
    cameras = np.zeros((n, 7))
    followed = np.zeros(n, dtype=bool)
    way = CameraWay.FIXED
    enough = np.isfinite(now[..., 0]).sum(axis=1) >= _PATH_FEATURES
    if enough.any():
        problem = _Problem(start, now, camera, table_height_m)
        fit = problem.fit(CameraWay.ROTATION)
        way = CameraWay.ROTATION
        share = problem.explained(fit)
        for other in (CameraWay.ZOOM, CameraWay.PLACE):
            rival = problem.fit(other, fit)
            more = problem.explained(rival)
            is_better = more[enough].mean() > share[enough].mean() + _PATH_GAIN
            if is_better and (other is not CameraWay.PLACE or problem.has_scale(rival)):
                way = other
                fit = rival
                share = more
        turn, move = (np.linalg.norm(fit.cameras[:, part], axis=1) for part in (slice(3), slice(3, 6)))
        within = (
            (turn <= _FOLLOWED_RAD) & (move <= _FOLLOWED_M) & (np.abs(np.expm1(fit.cameras[:, 6])) <= _FOLLOWED_ZOOM)
        )
        followed = enough & (share >= _EXPLAINED_SHARE) & within
        cameras[followed] = fit.cameras[followed]
    px = np.full(n, np.nan)
    px[followed] = np.nanmedian(np.linalg.norm(now - start, axis=2)[followed], axis=1)
    return CameraPath(
        way=way,
        R_AC=rotation_exp(cameras[:, :3]),
        p_AC=cameras[:, 3:6],
        zoom=np.exp(cameras[:, 6]),
        followed=followed,
        px=px,
    )


def _track_features(frames: Frames, reference: Image, robot: NDArray[np.bool_], camera: Camera) -> tuple[Array, Array]:
    """Return the features (N, 2) of the reference image and their tracks (T, N, 2) [px]; NaN where lost.

    Each feature is tracked from the frame before, and from the reference image, which leaves no drift, near there. Lost
    ones are looked for where the homography of the others predicts them.
    """
    unit = camera.unit_px
    first = _even_contrast(reference, unit)
    margin = 2 * round(_ROBOT_MARGIN_PX * unit) + 1
    free = cv2.dilate(robot.astype(np.uint8), np.ones((margin, margin), np.uint8)) == 0
    corners = cv2.goodFeaturesToTrack(first, _MAX_FEATURES, 0.005, _SPACING_PX * unit, mask=free.astype(np.uint8) * 255)
    start = np.empty((0, 2), np.float32) if corners is None else corners[:, 0]
    tracks = np.full((len(frames), len(start), 2), np.nan)
    if len(start) < _PATH_FEATURES:
        return np.asarray(start + 0.5, np.float64), tracks
    before = first
    last = start.copy()
    alive = np.ones(len(start), dtype=bool)
    for i, frame in enumerate(frames):
        image = _even_contrast(frame, unit)
        chained, steady = _flow(before, image, last, last, unit)
        steady &= alive
        H = _homography(start[steady], chained[steady], unit) if steady.sum() >= _PATH_FEATURES else None
        if H is None:  # a jump
            steady = np.zeros(len(start), dtype=bool)
            H = _matched_homography(first, image, free, unit)
        if H is None:
            continue
        near = np.asarray(cv2.perspectiveTransform(start[:, None], H)[:, 0], np.float32)
        near[steady] = chained[steady]
        now, good = _flow(first, image, start, near, unit)
        good &= np.linalg.norm(now - near, axis=1) < np.where(steady, _DRIFT_PX, _RANSAC_PX) * unit
        now = np.where(good[:, None], now, near)
        before = image
        last = now
        alive = good | steady
        tracks[i, alive] = now[alive] + 0.5
    return start.astype(np.float64) + 0.5, tracks


def _even_contrast(frame: Image, unit: float) -> Image:
    """Return the grey image (H, W) with the same contrast everywhere, so that faint textures count, too."""
    grey = cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY).astype(np.float32)
    detail = cv2.GaussianBlur(grey, (0, 0), 0.7 * unit) - cv2.GaussianBlur(grey, (0, 0), _DETAIL_PX * unit)
    contrast = np.sqrt(cv2.GaussianBlur(detail**2, (0, 0), 2 * _DETAIL_PX * unit))
    return np.asarray(np.clip(128.0 + 48.0 * detail / (contrast + _NOISE), 0, 255), np.uint8)


def _flow(
    first: Image,
    image: Image,
    start: NDArray[np.float32],
    near: NDArray[np.float32],
    unit: float,
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the pixels (N, 2) of features `start` (N, 2) in another image, from `near` on, and which were tracked."""
    moved, good = follow_points(first, image, start, _ROUND_TRIP_PX * unit, near)
    return moved, good & ((moved > 4) & (moved < np.array(image.shape[::-1]) - 5)).all(axis=1)


def _homography(first: NDArray[np.float32], now: NDArray[np.float32], unit: float) -> Array | None:
    """Return the homography that most features (N, 2) follow; None if too few do."""
    H, inlier = cv2.findHomography(first, now, cv2.RANSAC, _RANSAC_PX * unit)
    enough = H is not None and inlier.sum() >= max(_PATH_FEATURES, _MIN_INLIERS * len(first))
    return np.asarray(H) if enough else None


def _matched_homography(first: Image, image: Image, free: NDArray[np.bool_], unit: float) -> Array | None:
    """Return the homography of most matches of SIFT features (Lowe 2004) off the robot; None without enough."""
    sift = cv2.SIFT_create(600)  # type: ignore[attr-defined]
    points, descriptors = sift.detectAndCompute(first, free.astype(np.uint8) * 255)
    others, other_descriptors = sift.detectAndCompute(image, None)
    if descriptors is None or other_descriptors is None or min(len(points), len(others)) < _PATH_FEATURES:
        return None
    pairs = cv2.BFMatcher().knnMatch(descriptors, other_descriptors, k=2)
    good = [m for m, n in (p for p in pairs if len(p) == 2) if m.distance < 0.75 * n.distance]
    if len(good) < _PATH_FEATURES:
        return None
    a = np.array([points[m.queryIdx].pt for m in good])
    b = np.array([others[m.trainIdx].pt for m in good])
    return _homography(a.astype(np.float32), b.astype(np.float32), unit)


class _Problem:
    """Tracks of features, and the cameras that explain them."""

    def __init__(self, start: Array, now: Array, camera: Camera, table_height_m: float) -> None:
        self._now = now
        self._camera = camera
        self._unit = camera.unit_px
        self._seen = np.isfinite(now[..., 0])
        self._rays = np.column_stack([(start - [camera.cx, camera.cy]) / [camera.fx, camera.fy], np.ones(len(start))])
        down = self._rays @ camera.X_BC[2, :3]  # change of height per metre of depth
        with np.errstate(divide="ignore"):
            depth_m = (table_height_m - camera.X_BC[2, 3]) / down
        self._on_table = np.isfinite(depth_m) & (depth_m > 0.05) & (depth_m < _FAR_M)
        self._table = np.where(self._on_table, 1.0 / np.where(self._on_table, depth_m, 1.0), 1.0 / _FAR_M)

    def fit(self, way: CameraWay, start: _Fit | None = None) -> _Fit:
        """Fit the cameras of all frames."""
        cameras = np.zeros((len(self._now), 7)) if start is None else start.cameras.copy()
        has_place = way is CameraWay.PLACE
        if has_place:
            cameras[:, 6] = 0.0
        rho = self._table if has_place else np.zeros(len(self._table))  # without a place depths do not count
        free = {CameraWay.ROTATION: [0, 1, 2], CameraWay.ZOOM: [0, 1, 2, 6]}.get(way, [0, 1, 2, 3, 4, 5])
        for sweep in range(_SWEEPS if has_place else _STEPS):
            reach = _TUKEY_PX * self._unit * max(1.0, 64.0 * 0.4**sweep)
            cameras = self._step_cameras(cameras, rho, free, reach)
            if has_place and sweep >= _STEPS:
                rho = self._step_depths(cameras, rho, reach)
        return _Fit(cameras=cameras, inverse_depth=rho, residual=np.linalg.norm(self._error(cameras, rho), axis=2))

    def explained(self, fit: _Fit) -> Array:
        """Return the share (T,) of the tracked features that lie where the cameras predict them."""
        near = (np.nan_to_num(fit.residual, nan=np.inf) < _AGREEING_PX * self._unit).sum(axis=1)
        return np.asarray(near / np.maximum(self._seen.sum(axis=1), 1))

    def has_scale(self, fit: _Fit) -> bool:
        """Return whether enough features that look at the table have its depth."""
        used = self._seen.any(axis=0) & self._on_table
        near = np.abs(fit.inverse_depth / self._table - 1.0) < 3 * _TABLE_SIGMA
        return bool(used.sum() >= _PATH_FEATURES and near[used].mean() >= _MIN_ON_TABLE)

    def _error(self, cameras: Array, rho: Array) -> Array:
        """Return predicted less tracked pixels (T, N, 2)."""
        R_AC = rotation_exp(cameras[:, :3])
        p_C = np.einsum("tji,tnj->tni", R_AC, self._rays[None] - rho[None, :, None] * cameras[:, None, 3:6])
        c = self._camera
        scaled = np.exp(cameras[:, 6])[:, None, None] * [c.fx, c.fy]
        return np.asarray(scaled * p_C[..., :2] / np.maximum(p_C[..., 2:], 1e-3) + [c.cx, c.cy] - self._now)

    def _weight(self, error: Array, reach_px: float) -> Array:
        """Return Tukey's weights (T, N); 0 where a feature is not tracked."""
        r = np.nan_to_num(np.linalg.norm(error, axis=2), nan=np.inf) / reach_px
        return np.where(r < 1.0, np.clip(1.0 - np.minimum(r, 1.0) ** 2, 0.0, 1.0) ** 2, 0.0)

    def _step_cameras(self, cameras: Array, rho: Array, free: list[int], reach_px: float) -> Array:
        error = self._error(cameras, rho)
        weight = self._weight(error, reach_px)
        step = 1e-5
        J = np.stack([(self._error(cameras + step * np.eye(7)[k], rho) - error) / step for k in free], axis=-1)
        J = np.nan_to_num(J)
        error = np.nan_to_num(error)
        H = np.einsum("tn,tnia,tnib->tab", weight, J, J) + 1e-3 * np.eye(len(free))
        g = np.einsum("tn,tnia,tni->ta", weight, J, error)
        updated = cameras.copy()
        updated[:, free] -= np.linalg.solve(H, g[..., None])[..., 0]
        return updated

    def _step_depths(self, cameras: Array, rho: Array, reach_px: float) -> Array:
        """Return inverse depths (N,) one step on; the table is a robust prior (Geman and McClure 1987)."""
        error = self._error(cameras, rho)
        weight = self._weight(error, reach_px) / self._unit**2
        step = 1e-5
        J = np.nan_to_num((self._error(cameras, rho + step) - error) / step)
        error = np.nan_to_num(error)
        sigma = np.where(self._on_table, _TABLE_SIGMA, 1.0) * self._table
        off = (rho - self._table) / sigma
        prior = np.where(self._on_table, 1.0 / (1.0 + (off / 3.0) ** 2) ** 2, 1.0) / sigma**2
        H = np.einsum("tn,tni,tni->n", weight, J, J) + prior
        g = np.einsum("tn,tni,tni->n", weight, J, error) + prior * (rho - self._table)
        return np.asarray(np.clip(rho - g / H, 0.0, 10.0))
