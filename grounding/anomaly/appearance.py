"""Detectors of what no Franka hand looks like: one that vanishes, a second one, one of another shape."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.anomaly import Anomaly, AnomalyKind
from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert, transform_points
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.anomaly.detection import Detection, finite_median, sustained
from kinebench_drake.grounding.registration.hand_contour import HandShape
from kinebench_drake.grounding.registration.solver import NEAREST_M
from kinebench_drake.grounding.tracking.view import GripperView
from kinebench_drake.io.jsonl import Json
from kinebench_drake.models.gripper import PARTS, GripperModel
from kinebench_drake.segments import segments

# Set on planted faults in home renders of seen assets, and checked on clean ones:
# `python -m benchmarks planted-videos --out faulty`, then `python -m benchmarks evaluate faulty`.
_PRESENCE_FRAMES = 3
"""Fewest frames of a vanished or of a second gripper: fewer may be an occlusion."""
_ABSENT_CONFIDENCE = 0.01
"""Confidence of the pose below which a gripper is absent."""
_DUPLICATE_SHARE = 0.2
"""Least share of a second gripper's cells."""
_SIZE_FRAMES = 20
"""Fewest frames that measure the size of a hand."""
_MISFIT = 0.02
"""Least relative misfit of the shape of a deformation.

The excess of its residual must hold as well: the misfit alone gives false alarms where the gripper is seen edge-on."""
_EXCESS = 1.45
"""Least residual of a deformation against any rigid gripper, over the usual one of the video."""
_USUAL_RESIDUAL = 0.6
"""Greatest usual residual of a video: that of videos without a deformation [standard deviations]."""
_SHAPE_FRAMES = 5
"""Frames of the running median of the misfit, and fewest frames of an anomaly by contours."""
_CONTOUR_SIZE = 0.06
"""Least relative error of the size by contours of a hand that is too large or too small.

In clean videos of another simulator it is up to 0.051 (`python -m benchmarks footage`)."""
_CONTOUR_CHANGE = 0.15
"""Least relative change of the hand's contour of a deformation in an unfamiliar look."""
_CONTOUR_GAIN = 0.225
"""Least increase of the contour's agreement by another size or shape of the hand.

With both bounds the score of 32 clean clips of robosuite and PyBullet is at most 0.75. Of six hands of robosuite that
were stretched by 35 % for half a clip two are reported, and the others missed."""
_CONTOUR_WINDOW = 15
"""Frames of the running median of the contour's change."""
_WRONG_SIZE_SHARE = 0.5
"""Share of the frames with a hand of the wrong size above which the hand is not deformed."""
_MARGIN_CELLS = 2
"""Cells of the whole-image view around the tracked gripper that belong to it."""
_MIN_CELLS = 100
_PASSES = 4
_SIZE_ERROR_FRAMES = 10.0
"""Frames that an error of the measured size lasts."""


def find_vanishing(confidence: Array, explained: Array, expected: NDArray[np.bool_]) -> Detection:
    """Detect frames without a gripper that should be seen there; severity: their number.

    Absence is c0 / (c0 + confidence), one half at the threshold c0, or the same of the explained cells, whichever is
    larger; the score is twice the absence that as many consecutive frames reach as an anomaly needs. Series (T,) are
    those of `AnomalyEvidence`.
    """
    absence = np.maximum(
        _ABSENT_CONFIDENCE / (_ABSENT_CONFIDENCE + confidence),
        bounds.ABSENT_CELLS / (bounds.ABSENT_CELLS + explained),
    )
    score = 2.0 * sustained(absence * expected, _PRESENCE_FRAMES)
    anomalies = tuple(
        Anomaly(kind=AnomalyKind.VANISH, frame_start=r.start, frame_end=r.stop - 1, severity=float(r.stop - r.start))
        for r in segments(score > 1.0)
    )
    return Detection(kind=AnomalyKind.VANISH, score=score, anomalies=anomalies)


def second_gripper(view: GripperView, X_CH: Array | None, camera: Camera, gripper: GripperModel) -> float:
    """Return the share of a second gripper: its cells over those that the tracked one should cover.

    Cells of the `view` of the whole image within the convex outline of the tracked gripper, at `X_CH` (4, 4) in the
    camera frame [m], and a margin around it belong to the tracked one; without a pose the largest component is that.
    """
    cells = view.gripper.astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(cells, connectivity=8)
    if count < 2:
        return 0.0
    if X_CH is None:
        sizes = np.sort(stats[1:, cv2.CC_STAT_AREA].astype(float))
        return float(sizes[-2] / sizes[-1]) if count > 2 else 0.0
    outline = _outline(view, X_CH, camera, gripper)
    covered = float(outline.sum())
    if covered == 0.0:
        return 0.0
    kernel = np.ones((2 * _MARGIN_CELLS + 1, 2 * _MARGIN_CELLS + 1), np.uint8)
    outside = (cv2.dilate(outline, kernel) == 0) & (cells > 0)
    shares = np.bincount(labels[outside], minlength=count)[1:] / covered
    return float(min(1.0, shares.max()))


@lru_cache(maxsize=4)
def _hull_corners_H(gripper: GripperModel) -> Array:
    """Return the corners (N, 3) of the open gripper's convex hulls in its frame [m]."""
    X_HB = gripper.open(np.tile(np.eye(4), (PARTS, 1, 1)), gripper.max_finger_m)
    return np.concatenate(
        [transform_points(X_HB[body], mesh.convex_hull.vertices) for body, mesh in gripper.meshes.items()]
    )


def _outline(view: GripperView, X_CH: Array, camera: Camera, gripper: GripperModel) -> NDArray[np.uint8]:
    """Return the cells (h, w) inside the convex outline of a gripper at `X_CH` (4, 4)."""
    n = view.part.shape[0]
    outline = np.zeros((n, n), np.uint8)
    p_C = transform_points(X_CH, _hull_corners_H(gripper))
    if p_C[:, 2].min() <= NEAREST_M:
        return outline
    pixel = np.column_stack([camera.project(p_C), np.ones(len(p_C))])
    cell = pixel @ np.linalg.inv(view.crop.homography(camera, view.stride)).T
    cv2.fillConvexPoly(outline, cv2.convexHull(np.round(cell[:, :2] / cell[:, 2:] - 0.5).astype(np.int32)), 1)
    return outline


def find_duplicates(share: Array) -> Detection:
    """Detect frames with a large `share` (T,) of a second gripper (`second_gripper`); severity: the largest."""
    size = sustained(share, _PRESENCE_FRAMES)
    return Detection.from_score(AnomalyKind.DUPLICATE, size / _DUPLICATE_SHARE, size)


def shape_misfit(view: GripperView, X_CH: Array, finger_m: float) -> float:
    """Return the systematic deviation of the gripper's cells from the rigid model, relative to its size.

    Lateral distances between the cells and their CAD points under the fitted model, e (N, 2), are fitted by
    e = a + B p + c z^2 with p = (x, y, z) the CAD point: a stretch, a shear, a bend. The noise of single cells averages
    out. The misfit is the root mean square of the fitted field over that of the points' distances from their centre,
    with Tukey's weights; NaN if too few cells are visible. Without a travel of the fingers (NaN) they are left out.
    """
    with_fingers = np.isfinite(finger_m)
    cells = view.gripper if with_fingers else view.gripper & (view.opening_sign == 0)
    if cells.sum() < _MIN_CELLS:
        return float("nan")
    p_H = view.coordinates_P[cells].copy()
    if with_fingers:
        p_H[:, 1] += view.opening_sign[cells] * finger_m
    p_V = transform_points(invert(view.crop.X_CV) @ X_CH, p_H)
    if p_V[:, 2].min() <= NEAREST_M:
        return float("nan")
    offset = (view.rays()[cells][:, :2] - p_V[:, :2] / p_V[:, 2:]) * p_V[:, 2:]
    unit = (p_H - p_H.mean(axis=0)) / 0.1
    design = np.column_stack([np.ones(len(unit)), unit, unit[:, 2] ** 2])
    weight = 1.0 / view.coordinates_sigma_m[cells] ** 2
    robust = np.ones(len(unit))
    field = np.zeros_like(offset)
    for _ in range(_PASSES):
        root = np.sqrt(weight * robust)[:, None]
        solution = np.linalg.lstsq(design * root, offset * root, rcond=None)[0]
        field = design @ solution - solution[0]
        residual = np.linalg.norm(offset - design @ solution, axis=1)
        robust = np.clip(1.0 - (residual / max(6.0 * float(np.median(residual)), 1e-4)) ** 2, 0.0, 1.0) ** 2
    total = weight * robust
    spread = (total * ((p_H - (total @ p_H) / total.sum()) ** 2).sum(axis=1)).sum()
    return float(np.sqrt((total * (field**2).sum(axis=1)).sum() / spread))


def find_deformations(misfit: Array, residual: Array) -> Detection:
    """Detect frames with a deformed gripper; severity: the largest median misfit.

    The `misfit` (T,) of the shape (`shape_misfit`) counts with the `residual` (T,) of cells against the rigid gripper
    [standard deviations].
    """
    finite = residual[np.isfinite(residual)]
    usual = min(float(np.median(finite)), _USUAL_RESIDUAL) if finite.size else _USUAL_RESIDUAL
    excess = residual / (_EXCESS * usual)
    score = np.nan_to_num(finite_median(np.minimum(misfit / _MISFIT, excess), _SHAPE_FRAMES), nan=0.0)
    size = np.nan_to_num(finite_median(misfit, _SHAPE_FRAMES), nan=0.0)
    return Detection.from_score(AnomalyKind.DEFORMATION, score, size)


@dataclass(frozen=True, slots=True, kw_only=True)
class HandSize:
    """Size of the hand by the arm behind it. It decides nothing: a hand that is 10 % too large often looks right."""

    error: float
    """Relative error of the size: 0.1 for a hand that is a tenth too large."""
    sigma: float
    """Standard error of it."""

    def to_json(self) -> dict[str, Json]:
        """Serialize into `hand_size_error` and `hand_size_sigma` of samples.jsonl."""
        return {"hand_size_error": round(self.error, 4), "hand_size_sigma": round(self.sigma, 4)}


def measure_size(scale: Array) -> HandSize | None:
    """Return the size of the hand: the median of its `scale` (T,), relative to the right one; NaN where unknown.

    None if too few frames show it. Errors of the size last some frames, so that neighbours count as one.
    """
    sizes = scale[np.isfinite(scale)]
    if len(sizes) < _SIZE_FRAMES:
        return None
    median = float(np.median(sizes))
    scatter = 1.4826 * float(np.median(np.abs(sizes - median)))
    independent = len(sizes) / _SIZE_ERROR_FRAMES
    return HandSize(error=median - 1.0, sigma=float(np.sqrt(np.pi / 2.0 / independent)) * scatter)


def find_misshapen(shapes: Sequence[HandShape | None]) -> Detection:
    """Detect deformations by the `shapes` (T,) of the hand's contour; severity: the largest change.

    A contour that fits no better with another shape is right. A hand of the wrong size in most frames is not deformed.
    """
    log_scale, stretch, gain = np.array(
        [(np.nan,) * 3 if s is None else (s.log_scale, s.stretch, s.gain) for s in shapes]
    ).T

    def median(values: Array) -> Array:
        return np.nan_to_num(finite_median(values, _CONTOUR_WINDOW), nan=0.0)

    def lasting(off: Array) -> Array:
        return sustained(np.minimum(off, median(gain) / _CONTOUR_GAIN), _SHAPE_FRAMES)

    change = median(np.hypot(log_scale, stretch))
    score = lasting(change / _CONTOUR_CHANGE)
    if (lasting(np.abs(median(log_scale)) / _CONTOUR_SIZE) >= 1.0).mean() > _WRONG_SIZE_SHARE:
        score = np.zeros(len(shapes))
    return Detection.from_score(AnomalyKind.DEFORMATION, score, change)
