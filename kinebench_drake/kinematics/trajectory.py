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
from kinebench_drake.kinematics.tube import LimitSet, Obstacle, PoseLinearisation

SAMPLES = 8
"""Samples per span of the spline at which a trajectory is verified."""
NEAR_M = 0.02
"""Margin above the least distance within which distances are computed at every sample and linearised [m]."""
KEPT = 1.0 + 1e-6
"""Greatest ratio to a limit that counts as within it."""

_LINEARISED_PAIRS = 4  # nearest pairs per sample whose distances are linearised
_MARGIN_M = 5e-4  # added to the least distance in linearised bounds


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryCheck:
    """A trajectory and its verification in Drake, at `SAMPLES` samples per span of the spline."""

    knots_s: Array
    """(n + 4,) knots of the cubic B-spline, on the clock of the track [s]."""
    control: Array
    """(n, 7) control points [rad]."""
    position_error_max_m: float
    """Greatest position error of the TCP at a frame [m]."""
    rotation_error_max_rad: float
    """Greatest rotation error at a frame [rad]."""
    joint_limit_margin_min: float
    """Least distance from a joint limit / half the joint's range."""
    velocity_ratio_max: float
    """Greatest speed / limit."""
    acceleration_ratio_max: float | None
    """Greatest acceleration / limit; None if no limit is published."""
    jerk_ratio_max: float | None
    """Greatest jerk / limit; None if no limit is published."""
    torque_ratio_max: float
    """Greatest torque / limit, without payload."""
    self_distance_min_m: float | None
    """Least distance between two links [m]; None without a collision model."""
    table_distance_min_m: float | None
    """Least height above the table [m], negative below its surface; None without a collision model."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Contact:
    """Least distance of a trajectory from itself or from the table."""

    table: bool
    """True for the table, False for two links."""
    distance_m: float
    """Signed distance [m]."""
    least_m: float
    """Least allowed distance [m]."""
    t_s: float
    """Time on the clock of the spline [s]."""

    @property
    def violated(self) -> bool:
        """True if the distance is below the least allowed one."""
        return self.distance_m < self.least_m


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
    """(T, 7) initial joint path [rad]."""
    finger_width_m: Array | None
    """(T,) gap between the finger pads [m]; None for the plant's default."""
    table_tolerance_m: float
    """Allowed penetration of the table [m]."""

    @cached_property
    def limits(self) -> LimitSet:
        """Limits of the plant."""
        rates = (self.plant.velocity_limits, self.plant.acceleration_limits, self.plant.jerk_limits)
        return LimitSet(lower=self.plant.lower, upper=self.plant.upper, rates=rates)

    def errors(self, q: Array) -> Array:
        """Return the pose errors (T, 6) [m] of `q` (T, 7) [rad]: rotation by its arm, position, expressed in B."""
        return self._errors(self.plant.forward_path(q))

    def _errors(self, X_now: Array) -> Array:
        e = pose_twists(X_now, self.X_BG)
        e[:, :3] *= ROTATION_ARM_M
        return e

    def linearise(self, q: Array) -> PoseLinearisation:
        """Linearise the poses about the joint path `q` (T, 7) [rad]."""
        both = [self.plant.forward_and_jacobian(row) for row in q]
        J = np.array([J for _, J in both])
        J[:, :3] *= ROTATION_ARM_M
        return PoseLinearisation(t_s=self.t_s, q=q, J=J, e=self._errors(np.array([X for X, _ in both])))

    def nearest_frame(self, t_s: float) -> int:
        """Return the number of the frame nearest to a time on the clock of the spline [s]."""
        return int(self.frames[np.argmin(np.abs(self.t_s - t_s))])

    def widths(self, t_s: Array) -> Array | None:
        """Return finger gaps (N,) [m] at times (N,) [s], interpolated linearly."""
        if self.finger_width_m is None:
            return None
        finite = np.isfinite(self.finger_width_m)
        return np.interp(t_s, self.t_s[finite], self.finger_width_m[finite]) if finite.any() else None


class JointTrajectory:
    """Cubic B-spline in joint space with cached quantities along it."""

    def __init__(self, problem: TubeProblem, basis: SplineBasis, control: Array) -> None:
        """Set the control points (n, 7) [rad]."""
        self.problem, self.basis, self.control = problem, basis, control

    @cached_property
    def q(self) -> Array:
        """(T, 7) joint angles at the frames [rad]."""
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
        """|Control points| (n - k, 7) of speed, acceleration and jerk over their limits; None without a limit."""
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
        """Joint angles [rad], speeds [rad/s] and accelerations [rad/s^2] (N, 7) at the samples."""
        q, v, a = (self.basis.evaluate(self.control, self.samples_s, order) for order in range(3))
        return q, v, a

    @cached_property
    def torque(self) -> Array:
        """Joint torques (N, 7) [N m] at the samples."""
        return self.problem.plant.chain.torques(*self.motion)

    @cached_property
    def _distances(self) -> tuple[Array, Array]:
        """Distances (N,) of the arm from itself, NaN where not computed, and from the table [m], at the samples.

        The distance from the table is computed at every sample; that from itself, which costs more, twice per span and
        elsewhere only where it may be the least or below `NEAR_M`: others are of no interest.
        """
        collision = self.problem.collision
        t, q = self.samples_s, self.motion[0]
        if collision is None:
            return np.full(len(t), np.nan), np.full(len(t), np.nan)
        widths = self.problem.widths(t)
        own = collision.least_self_distances(q, widths, SAMPLES // 2, NEAR_M)
        return own, collision.table_distance(q, widths).distance_m

    @cached_property
    def contacts(self) -> tuple[Contact, ...]:
        """Least distances of the arm from itself and from the table; empty without a collision model."""
        both = zip(self._distances, (False, True), (0.0, -self.problem.table_tolerance_m), strict=True)
        return tuple(
            Contact(
                table=table, distance_m=float(np.nanmin(d)), least_m=least, t_s=float(self.samples_s[np.nanargmin(d)])
            )
            for d, table, least in both
            if np.isfinite(d).any()
        )

    @property
    def worst_contact(self) -> Contact | None:
        """Contact with the least margin to its allowed distance."""
        return min(self.contacts, key=lambda contact: contact.distance_m - contact.least_m, default=None)

    def obstacles(self) -> list[Obstacle]:
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
            for near in near_pairs[:_LINEARISED_PAIRS]:
                least = -self.problem.table_tolerance_m if near.link_b == TABLE else 0.0
                obstacles.append(
                    Obstacle(
                        t_s=float(self.samples_s[k]),
                        offset_m=near.distance_m - float(near.gradient @ q),
                        gradient=near.gradient,
                        least_m=least + _MARGIN_M,
                    )
                )
        return obstacles

    def check(self) -> TrajectoryCheck:
        """Return the verification of the trajectory."""
        plant, (q, v, a) = self.problem.plant, self.motion
        distance = {contact.table: contact.distance_m for contact in self.contacts}
        jerk = self.usage[2]  # constant in every span
        return TrajectoryCheck(
            knots_s=self.basis.knots + self.problem.origin_s,
            control=self.control,
            position_error_max_m=self.deviations[0],
            rotation_error_max_rad=self.deviations[1],
            joint_limit_margin_min=float(limit_margin(plant, q).min()),
            velocity_ratio_max=float(np.abs(v / plant.velocity_limits).max()),
            acceleration_ratio_max=(
                None if plant.acceleration_limits is None else float(np.abs(a / plant.acceleration_limits).max())
            ),
            jerk_ratio_max=None if jerk is None else float(jerk.max()),
            torque_ratio_max=float(np.abs(self.torque / plant.effort_limits).max()),
            self_distance_min_m=distance.get(False),
            table_distance_min_m=distance.get(True),
        )
