"""Points of the robot's surface followed from one frame to the next by optical flow.

Between two frames the look of a surface hardly changes, whatever it is; what a network has learnt does not matter.
Corners inside the robot's outline are followed (Lucas-Kanade in a pyramid, forwards and back), and the CAD points that
the posture of the first frame places there are matched with where they have gone.
"""

import cv2
import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert
from kinebench_drake.grounding.registration.correspondences import Correspondences, line_frames
from kinebench_drake.grounding.registration.edges import GradientImage
from kinebench_drake.models.panda.cad import PartCaster
from kinebench_drake.models.panda.robot import GRIPPER

_CORNERS, _QUALITY, _SPACING_PX = 200, 0.005, 4.0
_MASK_PX, _MARGIN_PX = 4, 5  # step of the rays that find the robot, and distance of the corners from its outline
_WINDOW_PX, _LEVELS = 15, 4
_RETURN_PX = 1.0  # largest distance of a point from its origin after it was followed forwards and back
_LEAST_POINTS = 8
_SIGMA_PX = 1.5
_INDEPENDENT = 60.0  # independent measurements that the points of an image count as at most


def follow_surface(
    caster: PartCaster, X_CP: Array, before: GradientImage, after: GradientImage
) -> Correspondences | None:
    """Return correspondences of the CAD model with the points of its surface in the next image; None if too few.

    Args:
        caster: ray caster of the parts of the robot.
        X_CP: (PARTS, 4, 4) poses of the parts in the camera frame in the first image [m].
        before: first image.
        after: next image, of the same camera.
    """
    corners = cv2.goodFeaturesToTrack(
        before.gray, _CORNERS, _QUALITY, _SPACING_PX, mask=_inner_mask(caster, X_CP, before.camera)
    )
    if corners is None:
        return None
    options = {"winSize": (_WINDOW_PX, _WINDOW_PX), "maxLevel": _LEVELS}
    moved, status, _ = cv2.calcOpticalFlowPyrLK(before.gray, after.gray, corners, None, **options)  # type: ignore[call-overload]
    back, status_back, _ = cv2.calcOpticalFlowPyrLK(after.gray, before.gray, moved, None, **options)  # type: ignore[call-overload]
    returned = np.linalg.norm((back - corners)[:, 0], axis=1) < _RETURN_PX
    kept = returned & (status[:, 0] == 1) & (status_back[:, 0] == 1)
    rays = _rays(corners[kept, 0] + 0.5, before.camera)
    depth, part = caster.first_hits(X_CP, rays)
    hit = np.isfinite(depth) & ~np.isin(part, GRIPPER[1:])  # fingers move in the hand
    if hit.sum() < _LEAST_POINTS:
        return None
    rays, depth, part = rays[hit], depth[hit], part[hit]
    X_PC = invert(X_CP)[part]
    towards = _rays(moved[kept, 0][hit] + 0.5, before.camera)
    sigma_m = _SIGMA_PX / before.camera.fx * depth
    n = len(depth)
    return Correspondences(
        R_LC=line_frames(towards / np.linalg.norm(towards, axis=1, keepdims=True)),
        range_m=np.ones(n),
        range_sigma=np.full(n, np.inf),
        p_P=np.einsum("nij,nj->ni", X_PC[:, :3, :3], rays * depth[:, None]) + X_PC[:, :3, 3],
        sigma_m=np.column_stack([sigma_m, sigma_m]),
        part=part,
        opening_sign=np.zeros(n),
        weight=np.full(n, min(1.0, _INDEPENDENT / n)),
    )


def _inner_mask(caster: PartCaster, X_CP: Array, camera: Camera) -> Array:
    """Return the pixels (H, W) that show the robot, away from its outline."""
    u, v = np.meshgrid(*(np.arange(_MASK_PX / 2, side, _MASK_PX) for side in (camera.width, camera.height)))
    depth, _ = caster.first_hits(X_CP, _rays(np.column_stack([u.ravel(), v.ravel()]), camera))
    robot = np.isfinite(depth).reshape(u.shape).astype(np.uint8)
    mask = cv2.resize(robot, (camera.width, camera.height), interpolation=cv2.INTER_NEAREST)
    return np.asarray(cv2.erode(mask, np.ones((_MARGIN_PX, _MARGIN_PX), np.uint8)))


def _rays(pixel: Array, camera: Camera) -> Array:
    """Return the directions (N, 3) of pixels (N, 2), of depth 1."""
    return np.column_stack([(pixel - [camera.cx, camera.cy]) / [camera.fx, camera.fy], np.ones(len(pixel))])
