"""Detectors of a deformed gripper and of one that changes its size."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.geometry import Array, invert, transform_points
from kinebench_drake.grounding.anomaly.detection import Detection, finite_median
from kinebench_drake.grounding.tracking.view import GripperView

MISFIT = 0.02
"""Least relative misfit of the shape of a deformation; `EXCESS` must hold, too.

The misfit alone is unreliable where the gripper is seen edge-on.
"""
EXCESS = 1.45
"""Least residual of a deformation against any rigid gripper, over the usual one of the video."""
USUAL = 0.6
"""Greatest usual residual of a video: that of videos without a deformation [standard deviations]."""
SHAPE_WINDOW = 5
"""Frames of the running median of misfit and residual."""
OFF = 0.035
"""Least relative error of the size of an anomaly."""
SCALE_WINDOW = 21
"""Frames of the running median of the size: its errors last some ten frames, a gripper of the wrong size keeps it."""
_MIN_CELLS = 100
_PASSES = 4


def shape_misfit(view: GripperView, X_CH: Array, finger_m: float) -> float:
    """Return the systematic deviation of the gripper's cells from the rigid model, relative to its size.

    Lateral distances between the cells and their CAD points under the fitted model, e (N, 2), are fitted by
    e = a + B p + c z^2 with p = (x, y, z) the CAD point: a stretch, a shear, a bend. The noise of single cells averages
    out of the fit. The misfit is the root mean square of the fitted field over that of the points' distances from their
    centre, with Tukey's weights; NaN if too few cells are visible.

    Args:
        view: view of the gripper's crop.
        X_CH: (4, 4) pose fitted to it [m].
        finger_m: travel of each finger fitted to it [m]; NaN to leave the fingers out.
    """
    with_fingers = np.isfinite(finger_m)
    cells = view.gripper if with_fingers else view.gripper & (view.opening_sign == 0)
    if cells.sum() < _MIN_CELLS:
        return float("nan")
    p_H = view.coordinates_P[cells].copy()
    if with_fingers:
        p_H[:, 1] += view.opening_sign[cells] * finger_m
    p_V = transform_points(invert(view.crop.X_CV) @ X_CH, p_H)
    if p_V[:, 2].min() <= 0.05:
        return float("nan")
    offset = (view.rays()[cells][:, :2] - p_V[:, :2] / p_V[:, 2:]) * p_V[:, 2:]
    unit = (p_H - p_H.mean(axis=0)) / 0.1
    design = np.column_stack([np.ones(len(unit)), unit, unit[:, 2] ** 2])
    sigma = view.coordinates_sigma_m[cells]
    weight = 1.0 / sigma**2
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


def find_deformations(misfit: ArrayLike, residual: ArrayLike) -> Detection:
    """Detect frames with a deformed gripper; severity: the largest median misfit.

    Args:
        misfit: (T,) relative misfit of the shape (`shape_misfit`); NaN where unknown.
        residual: (T,) residual of the cells against the rigid gripper [standard deviations]; NaN where unknown.
    """
    misfit, residual = np.asarray(misfit, dtype=np.float64), np.asarray(residual, dtype=np.float64)
    finite = residual[np.isfinite(residual)]
    usual = min(float(np.median(finite)), USUAL) if finite.size else USUAL
    excess = residual / (EXCESS * usual)
    score = np.nan_to_num(finite_median(np.minimum(misfit / MISFIT, excess), SHAPE_WINDOW), nan=0.0)
    size = np.nan_to_num(finite_median(misfit, SHAPE_WINDOW), nan=0.0)
    return Detection.from_score(AnomalyKind.DEFORMATION, score, size)


def find_scale_drift(scale: ArrayLike) -> Detection:
    """Detect frames in which the gripper has the wrong size; severity: the largest relative error.

    Args:
        scale: (T,) apparent size of the hand over its size at the distance given by the arm; NaN where unknown.
    """
    scale = np.asarray(scale, dtype=np.float64)
    median = finite_median(np.log(scale, where=scale > 0, out=np.full(len(scale), np.nan)), SCALE_WINDOW)
    size = np.abs(np.nan_to_num(median, nan=0.0))
    detection = Detection.from_score(AnomalyKind.SCALE, size / OFF, size)
    anomalies = tuple(replace(a, severity=float(np.expm1(a.severity))) for a in detection.anomalies)
    return replace(detection, anomalies=anomalies)
