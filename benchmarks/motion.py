"""Joint motions as smooth splines, and the proof that the arm can execute one."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from benchmarks.body import Body
from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.robot import Robot

PROOF_HZ = 500.0
"""Rate at which a motion is compared with every limit [Hz]."""
CLEARANCE_M = 0.001
"""Least distance between links that may not touch [m]."""

_FAR_M = 0.05
"""Distance of two links beyond which it is not computed [m]."""
_DEGREE = 5
"""Degree of the splines: the fourth derivative is continuous, so acceleration and jerk are exact, not differences."""


class Arm:
    """The robot as Drake's plant, and a vectorised copy of its geometry."""

    def __init__(self, robot: Robot | None = None) -> None:
        """Load a robot, the Panda by default."""
        self.plant = ArmPlant(robot)
        self.body = Body(self.plant)
        self.acceleration_limits = np.asarray(self.plant.acceleration_limits, dtype=np.float64)
        """(7,) greatest joint accelerations [rad/s^2]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """A joint path over time; at rest at both ends if it was made by `through`."""

    spline: BSpline
    """Joint angles (7,) [rad] over time [s], four times differentiable."""
    duration_s: float
    """End of the motion, which begins at 0 [s]."""
    t_width_s: Array
    """(K,) times of the finger widths [s]."""
    finger_width_m: Array
    """(K,) gap between the pads at those times [m]; linear in between."""

    @classmethod
    def through(cls, t_s: Array, q: Array, finger_width_m: Array) -> "Motion":
        """Fit the motion through postures `q` (K, 7) [rad] at times `t_s` (K,) [s] from 0, from rest to rest."""
        rest = [(1, np.zeros(7)), (2, np.zeros(7))]
        spline = make_interp_spline(t_s, q, k=_DEGREE, bc_type=(rest, rest))
        return cls(spline=spline, duration_s=float(t_s[-1]), t_width_s=t_s, finger_width_m=finger_width_m)

    def q(self, t_s: Array, derivative: int = 0) -> Array:
        """Return joint angles (N, 7) [rad], or a derivative of them, at times (N,) [s]."""
        return np.asarray(self.spline(t_s, nu=derivative))

    def width(self, t_s: Array) -> Array:
        """Return the gap between the pads (N,) [m] at times (N,) [s]."""
        return np.asarray(np.interp(t_s, self.t_width_s, self.finger_width_m))


@dataclass(frozen=True, slots=True, kw_only=True)
class Proof:
    """Comparison of a motion with every limit, at `PROOF_HZ`."""

    position_margin_rad: float
    """Least distance to a joint limit [rad]; negative outside."""
    velocity_ratio: float
    """Greatest joint speed / its limit; the next three likewise."""
    acceleration_ratio: float
    jerk_ratio: float
    torque_ratio: float
    self_distance_m: float
    """Least distance between links that may not touch [m], at most 0.05; negative inside. NaN where not needed."""
    table_distance_m: float
    """Height of the lowest point of all links but the base over the table [m]."""

    @property
    def holds(self) -> bool:
        """True if the arm can execute the motion."""
        ratios = (self.velocity_ratio, self.acceleration_ratio, self.jerk_ratio, self.torque_ratio)
        return (
            self.position_margin_rad >= 0.0
            and all(ratio <= 1.0 for ratio in ratios)
            and self.self_distance_m >= CLEARANCE_M
            and self.table_distance_m >= 0.0
        )


def prove(arm: Arm, motion: Motion, start_s: float, end_s: float, self_distance_m: float | None = None) -> Proof:
    """Compare a motion between two times with the limits of position, speed, acceleration, jerk, torque and distance.

    The derivatives are the spline's own. The expensive checks are omitted (NaN) if a cheap one fails. A least distance
    between links that is already known, of an arm of the same shape, is not computed again.
    """
    t_s = np.linspace(start_s, end_s, max(2, round((end_s - start_s) * PROOF_HZ) + 1))
    plant = arm.plant
    body = arm.body
    q, v, a, j = (motion.q(t_s, order) for order in range(4))
    width = motion.width(t_s)
    margin = float(np.minimum(q - plant.lower, plant.upper - q).min())
    ratios = [
        float((np.abs(x) / limit).max())
        for x, limit in ((v, plant.robot.limits.speeds(q, v)), (a, arm.acceleration_limits), (j, plant.jerk_limits))
    ]
    height = float(body.lowest(q, width).min())
    torque = distance = np.nan
    if margin >= 0.0 and max(ratios) <= 1.0 and height >= 0.0:
        tau = np.array([plant.torque(*state) for state in zip(q, v, a, strict=True)])
        torque = float((np.abs(tau) / plant.effort_limits).max())
        distance = float(self_distance(arm, q, width).min()) if self_distance_m is None else self_distance_m
    return Proof(
        position_margin_rad=margin,
        velocity_ratio=ratios[0],
        acceleration_ratio=ratios[1],
        jerk_ratio=ratios[2],
        torque_ratio=torque,
        self_distance_m=distance,
        table_distance_m=height,
    )


def self_distance(arm: Arm, q: Array, finger_width_m: Array) -> Array:
    """Return the least distance (N,) [m] between links that may not touch at postures (N, 7) [rad], at most 0.05."""
    return np.array(
        [
            min((pair.distance for pair in _pairs(arm, *state)), default=_FAR_M)
            for state in zip(q, finger_width_m, strict=True)
        ]
    )


def _pairs(arm: Arm, q: Array, width: float) -> Any:
    return arm.plant.query(q, width).ComputeSignedDistancePairwiseClosestPoints(_FAR_M)
