"""A second gripper in the picture."""

from functools import cache

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, transform_points
from kinebench_drake.grounding.anomaly.detection import Detection, detection_segments, sustained
from kinebench_drake.grounding.view import GripperView
from kinebench_drake.models.panda.cad import part_meshes
from kinebench_drake.models.panda.robot import OPENING_SIGN
from kinebench_drake.types import Anomaly, AnomalyKind

SHARE = 0.2
"""So much of a gripper, seen away from the one that is tracked, is a second one ..."""
MIN_FRAMES = 3
"""... if so many frames in a row show it."""
_MARGIN_CELLS = 2  # of the whole-frame view: what lies this near the tracked gripper's outline belongs to it
_FINGER_M = 0.04


@cache
def _outline_H() -> Array:
    """(N, 3) corners of the open gripper's convex hulls in the hand frame [m]."""
    corners = []
    for part, mesh in part_meshes().items():
        hull = np.asarray(mesh.convex_hull.vertices, dtype=np.float64)
        corners.append(hull + np.array([0.0, OPENING_SIGN[part] * _FINGER_M, 0.0]))
    return np.concatenate(corners)


def second_gripper(view: GripperView, X_CH: Array | None, camera: Camera) -> float:
    """Cells of the whole-frame view that show a gripper apart from the tracked one, over those that it should cover.

    Cells that touch the tracked gripper's own are its own, up to a margin about its outline.

    Args:
        view: of the whole frame.
        X_CH: (4, 4) pose of the tracked gripper in the camera frame, None where there is none: then the largest
            patch of cells stands for it.
        camera: of the frame.
    """
    cells = view.gripper.astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(cells, connectivity=8)
    if count < 2:
        return 0.0
    sizes = stats[1:, cv2.CC_STAT_AREA].astype(float)
    if X_CH is None:
        own = 1 + int(sizes.argmax())
        return float(np.sort(sizes)[-2] / sizes.max()) if count > 2 and own else 0.0
    outline = _outline(view, X_CH, camera)
    wanted = float(outline.sum())
    if wanted == 0.0:
        return 0.0
    kernel = np.ones((2 * _MARGIN_CELLS + 1, 2 * _MARGIN_CELLS + 1), np.uint8)
    outside = (cv2.dilate(outline, kernel) == 0) & (cells > 0)
    shares = np.bincount(labels[outside], minlength=count)[1:] / wanted
    return float(min(1.0, shares.max()))


def _outline(view: GripperView, X_CH: Array, camera: Camera) -> NDArray[np.uint8]:
    """(h, w) cells inside the convex outline of a gripper at `X_CH`."""
    n = view.part.shape[0]
    outline = np.zeros((n, n), np.uint8)
    p_C = transform_points(X_CH, _outline_H())
    if p_C[:, 2].min() <= 0.05:
        return outline
    pixel = np.column_stack([camera.project(p_C), np.ones(len(p_C))])
    cell = pixel @ np.linalg.inv(view.crop.homography(camera, view.stride)).T
    corners = np.round(cell[:, :2] / cell[:, 2:] - 0.5).astype(np.int32)
    cv2.fillConvexPoly(outline, cv2.convexHull(corners), 1)
    return outline


def find_duplicates(other: ArrayLike) -> Detection:
    """Frames that show a second gripper; severity: how much of it, over a whole one.

    Args:
        other: (T,) share of a gripper seen apart from the tracked one (`second_gripper`); NaN where unknown.
    """
    seen = sustained(other, MIN_FRAMES)
    score = seen / SHARE
    anomalies = tuple(
        Anomaly(kind=AnomalyKind.DUPLICATE, frame_start=a, frame_end=b, severity=float(seen[a : b + 1].max()))
        for a, b in detection_segments(score >= 1.0)
    )
    return Detection(kind=AnomalyKind.DUPLICATE, score=score, anomalies=anomalies)
