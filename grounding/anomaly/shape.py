"""A gripper that loses its shape: what a rigid CAD model leaves unexplained in common."""

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.geometry import Array, invert, transform_points
from kinebench_drake.grounding.anomaly.detection import Detection, detection_segments, finite_median
from kinebench_drake.grounding.view import GripperView
from kinebench_drake.types import Anomaly, AnomalyKind

MISFIT = 0.02
"""Relative misfit of the shape that counts as a deformation ..."""
EXCESS = 1.45
"""... where the cells disagree with any rigid gripper by so many times what is usual ..."""
USUAL = 0.6
"""... in the video, or at the most in videos without a deformation [standard deviations]. A misfit alone tells little
where the gripper is seen from its narrow side."""
WINDOW = 5
"""Frames whose median counts."""
_MIN_CELLS = 100
_PASSES = 4


def shape_misfit(view: GripperView, X_CH: Array, finger_m: float) -> float:
    """How far the gripper's cells lie off the rigid model in common, over its size; NaN where too little is seen.

    Sideways distances between where cells are and where the fitted model puts their CAD points, e (N, 2), are fitted
    by e = a + B p + c z^2 with p = (x, y, z) the CAD point: a stretch, a shear, a bend. The noise of single cells
    averages out of the fit. The misfit is the root mean square of what the field explains over that of the points'
    distances from their centre, weighed after Tukey.

    Args:
        view: the close view.
        X_CH: (4, 4) pose fitted to it [m].
        finger_m: opening of each finger fitted to it [m]; NaN leaves the fingers out.
    """
    opened = np.isfinite(finger_m)
    cells = view.gripper if opened else view.gripper & (view.opening_sign == 0)
    if cells.sum() < _MIN_CELLS:
        return float("nan")
    p_H = view.coordinates_P[cells].copy()
    if opened:
        p_H[:, 1] += view.opening_sign[cells] * finger_m
    p_V = transform_points(invert(view.crop.X_CV) @ X_CH, p_H)
    if p_V[:, 2].min() <= 0.05:
        return float("nan")
    off = (view.rays()[cells][:, :2] - p_V[:, :2] / p_V[:, 2:]) * p_V[:, 2:]
    unit = (p_H - p_H.mean(axis=0)) / 0.1
    design = np.column_stack([np.ones(len(unit)), unit, unit[:, 2] ** 2])
    sigma = view.coordinates_sigma_m[cells]
    weight = 1.0 / sigma**2
    robust = np.ones(len(unit))
    field = np.zeros_like(off)
    for _ in range(_PASSES):
        root = np.sqrt(weight * robust)[:, None]
        solution = np.linalg.lstsq(design * root, off * root, rcond=None)[0]
        field = design @ solution - solution[0]
        left = np.linalg.norm(off - design @ solution, axis=1)
        robust = np.clip(1.0 - (left / max(6.0 * float(np.median(left)), 1e-4)) ** 2, 0.0, 1.0) ** 2
    counts = weight * robust
    spread = (counts * ((p_H - (counts @ p_H) / counts.sum()) ** 2).sum(axis=1)).sum()
    return float(np.sqrt((counts * (field**2).sum(axis=1)).sum() / spread))


def find_deformations(misfit: ArrayLike, residual: ArrayLike) -> Detection:
    """Frames with a deformed gripper; severity: the largest median misfit.

    Args:
        misfit: (T,) relative misfit of the shape (`shape_misfit`); NaN where unknown.
        residual: (T,) of the cells against the rigid gripper [standard deviations]; NaN where unknown.
    """
    misfit, residual = np.asarray(misfit, dtype=np.float64), np.asarray(residual, dtype=np.float64)
    known = residual[np.isfinite(residual)]
    usual = min(float(np.median(known)), USUAL) if known.size else USUAL
    excess = residual / (EXCESS * usual)
    score = np.nan_to_num(finite_median(np.minimum(misfit / MISFIT, excess), WINDOW), nan=0.0)
    steady = np.nan_to_num(finite_median(misfit, WINDOW), nan=0.0)
    anomalies = tuple(
        Anomaly(kind=AnomalyKind.DEFORMATION, frame_start=a, frame_end=b, severity=float(steady[a : b + 1].max()))
        for a, b in detection_segments(score >= 1.0)
    )
    return Detection(kind=AnomalyKind.DEFORMATION, score=score, anomalies=anomalies)


OFF = 0.035
"""Relative error of the size that counts."""
SCALE_WINDOW = 13
"""Frames whose median counts."""


def find_scale_drift(scale: ArrayLike) -> Detection:
    """Frames in which the gripper has the wrong size; severity: by what part at most.

    Args:
        scale: (T,) apparent size of the hand over the size that it has where the arm puts it; NaN where unknown.
    """
    scale = np.asarray(scale, dtype=np.float64)
    steady = finite_median(np.log(scale, where=scale > 0, out=np.full(len(scale), np.nan)), SCALE_WINDOW)
    size = np.abs(np.nan_to_num(steady, nan=0.0))
    score = size / OFF
    anomalies = tuple(
        Anomaly(kind=AnomalyKind.SCALE, frame_start=a, frame_end=b, severity=float(np.expm1(size[a : b + 1].max())))
        for a, b in detection_segments(score >= 1.0)
    )
    return Detection(kind=AnomalyKind.SCALE, score=score, anomalies=anomalies)
