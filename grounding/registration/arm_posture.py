"""Posture of the arm behind a pose of the hand: the closed-form inverse kinematics that matches the links best."""

from dataclasses import replace

import numpy as np

from kinebench_drake.geometry import Array, invert
from kinebench_drake.grounding.registration.arm_model import OVER_LIMIT_RAD, ArmHandModel, ArmModel
from kinebench_drake.grounding.registration.correspondences import Correspondences
from kinebench_drake.grounding.registration.solver import CellRows
from kinebench_drake.kinematics.analytic import analytic_ik

INDEPENDENT = 30.0
"""Independent measurements that the arm cells of a view count as."""
EVIDENCE_CAP = 6.0
"""Greatest log-likelihood ratio of a pose against its flip."""
_LAST_ANGLES = np.linspace(-np.pi, np.pi, 32, endpoint=False)
_SHOULDER_SIGMA_RAD = 1.0  # of joints 1 and 3 about zero: half a turn of both, joint 2 reversed, looks alike
_COST_CAP = 25.0  # cap of a cell's squared residual
_SCORED_CELLS = 48


def find_posture(
    model: ArmModel, X_CH: Array, links: Correspondences, X_CB: Array
) -> tuple[Array, float, float] | None:
    """Return the inverse kinematics solution (7,) that matches the links best, its cost and that of the flip.

    The flipped hand, rotated by 180 degrees about its axis, has the same postures except for the last joint.
    """
    X_BF = invert(X_CB) @ X_CH @ model.X_HF
    q = analytic_ik(X_BF, _LAST_ANGLES).reshape(-1, 7)
    q = q[np.isfinite(q).all(axis=1)]
    flipped = q.copy()
    flipped[:, 6] = (flipped[:, 6] + 2 * np.pi) % (2 * np.pi) - np.pi
    best: list[tuple[float, Array | None]] = []
    scored = subsample(links)
    for postures in (q, flipped):
        lower, upper = model.lower - OVER_LIMIT_RAD, model.upper + OVER_LIMIT_RAD
        candidates = postures[((postures >= lower) & (postures <= upper)).all(axis=1)]
        if not len(candidates):
            best.append((_COST_CAP, None))
            continue
        costs = posture_costs(model, candidates, scored, X_CB) + _shoulder_cost(candidates)
        best.append((float(costs.min()), candidates[costs.argmin()]))
    (cost, posture), (flipped_cost, _) = best
    if posture is None:
        return None
    return posture, cost, flipped_cost


def posture_costs(model: ArmModel, q: Array, cells: Correspondences, X_CB: Array) -> Array:
    """Return the mean capped squared residual (M,) of the cells for postures `q` (M, 7)."""
    rows = CellRows.of(Correspondences.stack([cells]))
    p_L = rows.in_line_frames(rows.place_closed(X_CB @ model.poses(q)))
    square = (p_L[:, :2] ** 2).sum(axis=1) * rows.inverse_sigma[:, 0] ** 2
    return np.asarray(np.where(p_L[:, 2] > 0, np.minimum(square, _COST_CAP), _COST_CAP).mean(axis=1))


def half_turn(arm: ArmHandModel) -> ArmHandModel:
    """Return the arm with its last joint turned by 180 degrees."""
    q = arm.q + np.pi * (np.arange(7) == 6) * np.where(arm.q[:, 6:] < 0, 1.0, -1.0)
    return replace(arm, q=q, q_start=q)


def _shoulder_cost(q: Array) -> Array:
    """Return the cost (M,) of how far the shoulder is turned at postures `q` (M, 7), in the unit of a cell's."""
    return np.asarray(((q[:, [0, 2]] / _SHOULDER_SIGMA_RAD) ** 2).sum(axis=1) / INDEPENDENT)


def subsample(links: Correspondences) -> Correspondences:
    """Return as many cells as are compared with many postures."""
    return links.take(np.linspace(0, len(links) - 1, _SCORED_CELLS).astype(int))


def flip_evidence(cost: float, flipped_cost: float) -> float:
    """Return the log-likelihood ratio of a pose against its flip from their mean squared residuals."""
    return float(np.clip(0.5 * (flipped_cost - cost), -EVIDENCE_CAP, EVIDENCE_CAP))
