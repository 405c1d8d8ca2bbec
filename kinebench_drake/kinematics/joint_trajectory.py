"""A joint trajectory of a tube problem, verified in Drake: pose errors, limits, torques and distances along it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.collision import TABLE, CollisionModel
from kinebench_drake.kinematics.newton import ROTATION_ARM_M, pose_twists
from kinebench_drake.kinematics.path import limit_margin
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.spline import SplineBasis
from kinebench_drake.kinematics.tube import DistanceBound, LimitSet, PoseLinearisation
from kinebench_drake.violation import COLLISIONS, Violation, ViolationKind

SAMPLES = 8
"""Samples per span of the spline at which a trajectory is verified."""
NEAREST_PAIRS = 4
"""Nearest pairs of solids at a sample whose distances are linearised."""
NEAR_M = 0.02
"""Margin above the least distance within which distances are computed at every sample and linearised [m]."""
KEPT = 1.0 + 1e-6
"""Greatest ratio to a limit that counts as within it."""
DISTANCE_RESERVE_M = 5e-4
"""Length added to the least distance in linearised bounds, which the curvature may use up [m]."""


@dataclass(frozen=True, kw_only=True)
class TubeProblem:
    """Track of poses with its initial joint path; the clock is 0 at the first frame."""

    plant: ArmPlant
    collision: CollisionModel | None
    """Collision model; None ignores collisions."""
    frames: NDArray[np.intp]
    """(T,) numbers of the frames in the original track."""
    t_s: Array
    """(T,) times [s], the first 0."""
    origin_s: float
    """Time of the first frame in the original track [s]."""
    X_BG: Array
    """(T, 4, 4) poses of the TCP in the base [m]."""
    q: Array
    """(T, J) initial joint path [rad]."""
    finger_width_m: Array | None
    """(T,) gap between the finger pads [m]; None for the plant's default."""
    table_tolerance_m: float
    """Allowed penetration of the table [m]."""

    @cached_property
    def limits(self) -> LimitSet:
        """Limits of the plant."""
        return LimitSet(lower=self.plant.lower, upper=self.plant.upper, rates=self.plant.rate_limits)

    def errors(self, q: Array) -> Array:
        """Return the pose errors (T, 6) [m] of `q` (T, J) [rad]: rotation by its arm, position, expressed in B."""
        return self._errors(self.plant.forward_path(q))

    def _errors(self, X_now: Array) -> Array:
        e = pose_twists(X_now, self.X_BG)
        e[:, :3] *= ROTATION_ARM_M
        return e

    def linearise(self, q: Array) -> PoseLinearisation:
        """Linearise the poses about the joint path `q` (T, J) [rad]."""
        both = [self.plant.forward_and_jacobian(row) for row in q]
        J = np.array([J for _, J in both])
        J[:, :3] *= ROTATION_ARM_M
        return PoseLinearisation(t_s=self.t_s, q=q, J=J, e=self._errors(np.array([X for X, _ in both])))

    def nearest_frame(self, t_s: float) -> int:
        """Return the number of the frame nearest to a time on the clock of the spline [s]."""
        return int(self.frames[np.argmin(np.abs(self.t_s - t_s))])

    def allowed_distance(self, kind: ViolationKind) -> float:
        """Return the least allowed distance [m] for a kind of collision."""
        return -self.table_tolerance_m if kind is ViolationKind.TABLE_COLLISION else 0.0

    def widths(self, t_s: Array) -> Array | None:
        """Return finger gaps (N,) [m] at times (N,) [s], interpolated linearly."""
        if self.finger_width_m is None:
            return None
        finite = np.isfinite(self.finger_width_m)
        return np.interp(t_s, self.t_s[finite], self.finger_width_m[finite]) if finite.any() else None


class JointTrajectory:
    """Cubic B-spline in joint space with cached quantities along it."""

    def __init__(self, problem: TubeProblem, basis: SplineBasis, control: Array) -> None:
        """Set the control points (n, J) [rad]."""
        self.problem = problem
        self.basis = basis
        self.control = control

    @cached_property
    def q(self) -> Array:
        """(T, J) joint angles at the frames [rad]."""
        return np.asarray(self.basis.values(self.problem.t_s) @ self.control)

    @cached_property
    def deviations(self) -> tuple[float, float]:
        """Greatest position error [m] and rotation error [rad] at a frame."""
        e = np.linalg.norm(self.problem.errors(self.q).reshape(-1, 2, 3), axis=-1).max(axis=0)
        return float(e[1]), float(e[0] / ROTATION_ARM_M)

    @property
    def radius_m(self) -> float:
        """Radius of the smallest tube that contains the trajectory [m]."""
        position, rotation = self.deviations
        return max(position, rotation * ROTATION_ARM_M)

    @cached_property
    def usage(self) -> tuple[Array | None, ...]:
        """|Control points| (n - k, J) of speed, acceleration and jerk over their limits; None without a limit."""
        return tuple(
            None if limit is None else np.abs(D @ self.control) / limit
            for D, limit in zip(self.basis.derivatives[1:], self.problem.limits.rates, strict=True)
        )

    @property
    def keeps_limits(self) -> bool:
        """True if joint angles, speeds, accelerations and jerks are within their limits at all times."""
        limits = self.problem.limits
        inside = bool((self.control >= limits.lower).all() and (self.control <= limits.upper).all())
        return inside and all(ratio is None or ratio.max() <= KEPT for ratio in self.usage)

    @cached_property
    def samples_s(self) -> Array:
        """(N,) times of the samples on the clock of the spline [s]: `SAMPLES` per span, breaks included."""
        spans = len(self.basis.breaks_s) - 1
        return np.interp(np.arange(SAMPLES * spans + 1) / SAMPLES, np.arange(spans + 1), self.basis.breaks_s)

    @cached_property
    def motion(self) -> tuple[Array, Array, Array]:
        """Joint angles [rad], speeds [rad/s] and accelerations [rad/s^2] (N, J) at the samples."""
        q, v, a = (self.basis.evaluate(self.control, self.samples_s, order) for order in range(3))
        return q, v, a

    @cached_property
    def torque(self) -> Array:
        """Joint torques (N, J) [N m] at the samples."""
        return self.problem.plant.chain.torques(*self.motion)

    @cached_property
    def _distances(self) -> tuple[Array, Array]:
        """Distances (N,) of the arm from itself, NaN where not computed, and from the table [m], at the samples.

        Those from itself, which cost more, are computed twice per span and where they may be the least or below
        `NEAR_M`.
        """
        collision = self.problem.collision
        t = self.samples_s
        q = self.motion[0]
        if collision is None:
            return np.full(len(t), np.nan), np.full(len(t), np.nan)
        widths = self.problem.widths(t)
        own = collision.least_distances(q, widths, SAMPLES // 2, NEAR_M)
        return own, collision.table_distance(q, widths).distance_m

    @cached_property
    def least_distances(self) -> dict[ViolationKind, tuple[float, int]]:
        """Least distances from itself or an obstacle, and from the table [m], with their samples, by kind.

        Empty without a collision model.
        """
        least = {
            kind: (float(np.nanmin(distance)), int(np.nanargmin(distance)))
            for kind, distance in zip(COLLISIONS, self._distances, strict=True)
            if np.isfinite(distance).any()
        }
        own = least.get(ViolationKind.SELF_COLLISION)
        collision = self.problem.collision
        if own is not None and collision is not None and collision.obstacles:
            widths = self.problem.widths(self.samples_s)
            at = slice(own[1], own[1] + 1)
            obstacle = collision.obstacle_distance(self.motion[0][at], None if widths is None else widths[at])
            if obstacle.distance_m[0] <= own[0]:
                least[ViolationKind.OBSTACLE_COLLISION] = least.pop(ViolationKind.SELF_COLLISION)
        return least

    @property
    def contact(self) -> Violation | None:
        """Distance farthest below the least allowed one; None if both are kept."""
        worst = None
        least_margin = 0.0
        for kind, (distance, sample) in self.least_distances.items():
            limit = self.problem.allowed_distance(kind)
            if distance - limit < least_margin:
                frame = self.problem.nearest_frame(float(self.samples_s[sample]))
                least_margin = distance - limit
                worst = Violation.at(kind, frame, None, distance, limit)
        return worst

    @property
    def overload(self) -> Violation | None:
        """Torque farthest beyond its limit; None if all are within limits."""
        plant = self.problem.plant
        ratio = np.abs(self.torque / plant.effort_limits)
        k, j = np.unravel_index(np.argmax(ratio), ratio.shape)
        if ratio[k, j] <= 1.0:
            return None
        frame = self.problem.nearest_frame(float(self.samples_s[k]))
        value = float(self.torque[k, j])
        return Violation.at(ViolationKind.TORQUE, frame, plant.robot.joints[j], value, float(plant.effort_limits[j]))

    @property
    def speeding(self) -> Violation | None:
        """Speed farthest beyond a limit that depends on the position, at the samples; None if all are within limits."""
        limits = self.problem.plant.robot.limits
        (q, v, _) = self.motion
        bounds = limits.speeds(q, v)
        k, j = np.unravel_index(np.argmax(np.abs(v) / bounds), v.shape)
        if limits.deceleration is None or abs(v[k, j]) <= KEPT * bounds[k, j]:
            return None
        frame = self.problem.nearest_frame(float(self.samples_s[k]))
        joint = self.problem.plant.robot.joints[j]
        return Violation.at(ViolationKind.VELOCITY, frame, joint, float(v[k, j]), float(bounds[k, j]))

    def obstacles(self) -> list[DistanceBound]:
        """Linearise distances below `NEAR_M`, twice per span and at local minima: the few least at each sample."""
        collision = self.problem.collision
        if collision is None:
            return []
        obstacles = []
        widths = self.problem.widths(self.samples_s)
        chosen = {*range(0, len(self.samples_s), SAMPLES // 2)}
        for distance in self._distances:
            d = np.nan_to_num(distance, nan=np.inf)
            chosen |= {*np.flatnonzero((d[1:-1] < NEAR_M) & (d[1:-1] <= d[:-2]) & (d[1:-1] <= d[2:])) + 1}
        for k in sorted(chosen):
            q = self.motion[0][k]
            near_pairs = collision.near_pairs(q, NEAR_M, None if widths is None else float(widths[k]))
            for near in near_pairs[:NEAREST_PAIRS]:
                kind = ViolationKind.TABLE_COLLISION if near.link_b == TABLE else ViolationKind.SELF_COLLISION
                obstacles.append(
                    DistanceBound(
                        t_s=float(self.samples_s[k]),
                        offset_m=near.distance_m - float(near.gradient @ q),
                        gradient=near.gradient,
                        least_m=self.problem.allowed_distance(kind) + DISTANCE_RESERVE_M,
                    )
                )
        return obstacles

    def figures(self) -> dict[str, float | None]:
        """Return the greatest errors at the frames and, at the samples, the extremes of all that has a limit, by name.

        Ratios are those of values to their limits; None where no limit is published, or without a collision model.
        """
        plant = self.problem.plant
        (q, v, a) = self.motion
        # the jerk is constant in every span
        accelerations = plant.acceleration_limits
        jerk = self.usage[2]
        own, table = (self.least_distances.get(kind) for kind in COLLISIONS)
        return {
            "position_error_max_m": self.deviations[0],
            "rotation_error_max_rad": self.deviations[1],
            "joint_limit_margin_min": float(limit_margin(plant, q).min()),
            "velocity_ratio_max": float(np.abs(v / plant.robot.limits.speeds(q, v)).max()),
            "acceleration_ratio_max": None if accelerations is None else float(np.abs(a / accelerations).max()),
            "jerk_ratio_max": None if jerk is None else float(jerk.max()),
            "torque_ratio_max": float(np.abs(self.torque / plant.effort_limits).max()),
            "self_distance_min_m": own and own[0],
            "table_distance_min_m": table and table[0],
        }
