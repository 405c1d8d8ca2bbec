"""Images for registration: gradients and edges of one, and points of the robot's surface followed to the next.

Between two frames the look of a surface hardly changes, whatever it is; what a network has learnt does not matter.
Corners inside the robot's outline are followed (Lucas-Kanade in a pyramid, forwards and back), and the CAD points that
the posture of the first frame places there are matched with where they have gone.
"""

from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert
from kinebench_drake.grounding.registration.solver import BATCH, POINTS_INDEPENDENT, Correspondences, line_frames
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.panda.cad import PartCaster
from kinebench_drake.models.panda.description import GRIPPER, RobotPart

_KEPT_PIXELS = 12_000_000
"""Greatest total number of pixels of images whose gradients are kept, at 9 bytes each."""
_LARGEST_PX = 640
"""Longer side to which larger images are reduced [px]."""
_SMOOTHING_PX = 0.8
_STEP_PX = 0.5
_BAND_PX = 4.0
"""Greatest distance of an outline outside of a stronger edge [px]."""
_OUTER_SHARE = 0.45
"""Least gradient of an outline next to a stronger edge, over that of this edge."""
_RIM_SIGMAS = 5.0
"""Standard deviations from a segmented rim beyond which nothing is near it."""
_OFF_RIM = 0.1
"""Weight of edges of the hand far from its segmented rim."""
_CORNERS = 200
_QUALITY = 0.005
_SPACING_PX = 4.0
_MASK_PX = 4
"""Step of the rays that find the robot in an image [px]."""
_MARGIN_PX = 5
"""Least distance of followed corners from the robot's outline [px]."""
_WINDOW_PX = 15
"""Width of the window in which a corner is followed [px]."""
_LEVELS = 4
"""Highest level of the image pyramid in which it is followed."""
RETURN_PX = 1.0
"""Largest distance of a point from its origin after it was followed forwards and back."""
_LEAST_POINTS = 8
_SIGMA_PX = 1.5


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgePoints:
    """Visible points on the edges of the robot in an image."""

    part: NDArray[np.uint8]
    """(N,) values of `RobotPart`."""
    p_P: Array
    """(N, 3) points in the frame of the part, fingers closed [m]."""
    p_C: Array
    """(N, 3) points in the camera frame [m]."""
    pixel: Array
    """(N, 2) their places in the image [px]."""
    normal: Array
    """(N, 2) unit vectors across the edge in the image, away from the surface."""

    def moved(self, X_CP: Array, camera: Camera) -> "EdgePoints":
        """Return the points after a small motion of the parts to `X_CP` (PARTS, 4, 4) [m], visible as before."""
        X = X_CP[self.part]
        p_C = (X[:, :3, :3] @ self.p_P[..., None])[..., 0] + X[:, :3, 3]
        return replace(self, p_C=p_C, pixel=camera.project(p_C))


class GradientImage:
    """Gradients of an image, reduced to at most `_LARGEST_PX` pixels."""

    def __init__(self, image: NDArray[np.uint8], camera: Camera) -> None:
        """Compute the gradients of `image` (H, W, 3), taken by `camera`."""
        scale = min(1.0, _LARGEST_PX / max(camera.width, camera.height))
        if scale < 1.0:
            width = round(camera.width * scale)
            height = round(camera.height * scale)
            image = np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)
            camera = camera.resized(width, height)
        self.camera = camera
        self.gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        self._dx, self._dy = _gradient(image)
        self._near_rim: NDArray[np.float32] | None = None

    def with_hand(self, gripper: NDArray[np.bool_], sigma_px: float) -> "GradientImage":
        """Return the image with the segmented gripper, whose rim decides between several edges near the hand.

        The frame shows the `gripper` at some pixels (H, W); `sigma_px` is the standard deviation of their rim.
        """
        image = copy(self)
        size = (self.camera.width, self.camera.height)
        mask = np.asarray(cv2.resize(gripper.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST))
        sigma = sigma_px * size[0] / gripper.shape[1]
        u, v, width, height = cv2.boundingRect(mask)
        image._near_rim = None
        if width:
            margin = int(np.ceil(_RIM_SIGMAS * sigma))
            near = slice(max(0, v - margin), v + height + margin), slice(max(0, u - margin), u + width + margin)
            inside, outside = (cv2.distanceTransform(m, cv2.DIST_L2, 5) for m in (mask[near], 1 - mask[near]))
            image._near_rim = np.zeros(mask.shape, np.float32)
            image._near_rim[near] = np.exp(-0.5 * ((inside + outside) / sigma) ** 2)
        return image

    def find_edges(self, points: EdgePoints, reach_px: float) -> tuple[Array, Array]:
        """Return offsets (N,) along the normals of `points` to the image's edges [px], and their gradients (N,).

        The strongest edge within `reach_px` wins unless another is much nearer. Surfaces darken or shine towards their
        outlines, so the strongest edge often lies a little inside: an outline is the outermost edge next to it.
        """
        offset = np.arange(-reach_px, reach_px + _STEP_PX / 2, _STEP_PX)
        place = points.pixel[:, None] + offset[:, None] * points.normal[:, None] - 0.5
        u = place[..., 0].astype(np.float32)
        v = place[..., 1].astype(np.float32)
        dx, dy = (self._sample(d, u, v) for d in (self._dx, self._dy))
        gradient = np.abs(dx * points.normal[:, None, 0] + dy * points.normal[:, None, 1]).astype(np.float64)
        likely = gradient * np.exp(-0.5 * (offset / (0.6 * reach_px)) ** 2)
        if self._near_rim is not None:
            hand = points.part == RobotPart.HAND
            likely[hand] *= _OFF_RIM + self._sample(self._near_rim, u, v)[hand]
        rows = np.arange(len(gradient))
        best = likely[:, 1:-1].argmax(axis=1) + 1
        is_peak = np.zeros(gradient.shape, bool)
        inner = gradient[:, 1:-1]
        is_peak[:, 1:-1] = (inner >= gradient[:, :-2]) & (inner > gradient[:, 2:])
        ahead = offset - offset[best][:, None]
        outer = is_peak & (ahead > 0) & (ahead <= _BAND_PX) & (gradient >= _OUTER_SHARE * gradient[rows, best][:, None])
        last = outer.shape[1] - 1 - outer[:, ::-1].argmax(axis=1)
        best = np.where(outer.any(axis=1), last, best)
        before = gradient[rows, best - 1]
        peak = gradient[rows, best]
        after = gradient[rows, best + 1]
        curvature = before - 2 * peak + after
        shift = np.where(curvature < 0, 0.5 * (before - after) / np.minimum(curvature, -1e-9), 0.0).clip(-1, 1)
        return np.asarray(offset[best] + _STEP_PX * shift), np.asarray(peak)

    @staticmethod
    def _sample(values: NDArray[np.float32], u: NDArray[np.float32], v: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.asarray(cv2.remap(values, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT), np.float32)


class GradientImages:
    """Gradients of the frames of a video, computed when they are asked for; those asked for last are kept."""

    def __init__(self, frames: Frames, camera: Camera) -> None:
        """Serve the images of `frames` (T, H, W, 3), taken by `camera`."""
        self._frames = frames
        self._camera = camera
        self._kept: dict[int, GradientImage] = {}

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, number: int) -> GradientImage:
        """Return the image of a frame."""
        image = self._kept.pop(number, None) or GradientImage(self._frames[number], self._camera)
        self._kept[number] = image
        if len(self._kept) > max(BATCH, _KEPT_PIXELS // image.gray.size):
            del self._kept[next(iter(self._kept))]
        return image


def _gradient(image: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the derivatives (H, W) of an image (H, W, 3) along x and y [1/px], in the channel of the largest."""
    strongest: list[NDArray[np.float32]] = []
    for channel in cv2.split(image):
        smooth = cv2.GaussianBlur(channel.astype(np.float32), (0, 0), _SMOOTHING_PX)
        dx, dy = (cv2.Sobel(smooth, cv2.CV_32F, *order, ksize=3, scale=0.125) for order in ((1, 0), (0, 1)))
        derivatives = [np.asarray(values, np.float32) for values in (dx, dy, dx * dx + dy * dy)]
        if not strongest:
            strongest = derivatives
            continue
        stronger = cv2.compare(derivatives[2], strongest[2], cv2.CMP_GT)
        for kept, values in zip(strongest, derivatives, strict=True):
            cv2.copyTo(values, stronger, kept)
    return strongest[0], strongest[1]


def find_corners(image: NDArray[np.uint8], mask: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the strongest corners (N, 2) of a grey image (Shi and Tomasi 1994) where `mask` (H, W) is not 0 [px]."""
    corners = cv2.goodFeaturesToTrack(image, _CORNERS, _QUALITY, _SPACING_PX, mask=mask)
    return np.empty((0, 2), np.float32) if corners is None else np.asarray(corners[:, 0], np.float32)


def follow_points(
    before: NDArray[np.uint8],
    after: NDArray[np.uint8],
    points: NDArray[np.float32],
    return_px: float,
    near: NDArray[np.float32] | None = None,
    **options: Any,
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return where points (N, 2) of a grey image are in another one [px], and which (N,) return within `return_px`.

    Pyramidal Lucas-Kanade forth and back, with `options` of OpenCV, from the points `near` (N, 2) on or from the same.
    """
    start = points[:, None]
    forth_from = None
    back_from = None
    if near is not None:
        options["flags"] = cv2.OPTFLOW_USE_INITIAL_FLOW
        forth_from = near[:, None].copy()
    forth, status, _ = cv2.calcOpticalFlowPyrLK(before, after, start, forth_from, **options)
    if near is not None:
        back_from = start + forth - near[:, None]
    back, status_back, _ = cv2.calcOpticalFlowPyrLK(after, before, forth, back_from, **options)
    returned = np.linalg.norm((back - start)[:, 0], axis=1) < return_px
    return forth[:, 0], (status[:, 0] > 0) & (status_back[:, 0] > 0) & returned


def follow_surface(
    caster: PartCaster, X_CP: Array, before: GradientImage, after: GradientImage
) -> Correspondences | None:
    """Return correspondences of the CAD model with the points of its surface in the next image; None if too few.

    In the image before, of the same camera, the parts of `caster` are at `X_CP` (PARTS, 4, 4) [m].
    """
    corners = find_corners(before.gray, _inner_mask(caster, X_CP, before.camera))
    if not len(corners):
        return None
    moved, kept = follow_points(
        before.gray, after.gray, corners, RETURN_PX, winSize=(_WINDOW_PX, _WINDOW_PX), maxLevel=_LEVELS
    )
    rays = _rays(corners[kept] + 0.5, before.camera)
    depth, part = caster.first_hits(X_CP, rays)
    hit = np.isfinite(depth) & ~np.isin(part, GRIPPER[1:])  # fingers move in the hand
    if hit.sum() < _LEAST_POINTS:
        return None
    rays = rays[hit]
    depth = depth[hit]
    part = part[hit]
    X_PC = invert(X_CP)[part]
    towards = _rays(moved[kept][hit] + 0.5, before.camera)
    return Correspondences.without_range(
        line_frames(towards / np.linalg.norm(towards, axis=1, keepdims=True)),
        np.einsum("nij,nj->ni", X_PC[:, :3, :3], rays * depth[:, None]) + X_PC[:, :3, 3],
        np.repeat((_SIGMA_PX / before.camera.fx * depth)[:, None], 2, axis=1),
        part,
        POINTS_INDEPENDENT,
    )


def _inner_mask(caster: PartCaster, X_CP: Array, camera: Camera) -> NDArray[np.uint8]:
    """Return the pixels (H, W) that show the robot, away from its outline."""
    u, v = np.meshgrid(*(np.arange(_MASK_PX / 2, side, _MASK_PX) for side in (camera.width, camera.height)))
    depth, _ = caster.first_hits(X_CP, _rays(np.column_stack([u.ravel(), v.ravel()]), camera))
    robot = np.isfinite(depth).reshape(u.shape).astype(np.uint8)
    mask = cv2.resize(robot, (camera.width, camera.height), interpolation=cv2.INTER_NEAREST)
    return np.asarray(cv2.erode(mask, np.ones((_MARGIN_PX, _MARGIN_PX), np.uint8)), np.uint8)


def _rays(pixel: NDArray[np.floating], camera: Camera) -> Array:
    """Return the directions (N, 3) of pixels (N, 2), of depth 1."""
    return np.column_stack([(pixel - [camera.cx, camera.cy]) / [camera.fx, camera.fy], np.ones(len(pixel))])
