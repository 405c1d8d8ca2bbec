"""A joint trajectory beside the track that it is to follow, and what Drake finds along it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array, rotation_log
from kinebench_drake.kinematics.collision import TABLE, CollisionModel
from kinebench_drake.kinematics.newton import ROTATION_ARM_M
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.spline import SplineBasis
from kinebench_drake.kinematics.tube import LimitSet, Obstacle, PoseLinearisation

SAMPLES = 8
"""Samples a span of the spline in which a trajectory is verified."""
NEAR_M = 0.02
"""Distances up to this far above the least are sampled in full, and watched when a trajectory is moved [m]."""
KEPT = 1.0 + 1e-6
"""Ratio up to which a limit counts as kept."""

_WATCHED = 4  # pairs a sample, the nearest, that are watched
_MARGIN_M = 5e-4  # aimed at beyond the least distance


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryCheck:
    """A trajectory and what Drake finds along it, `SAMPLES` times a span of the spline."""

    knots_s: Array
    """(n + 4,) knots of its cubic B-spline, on the clock of the track [s]."""
    control: Array
    """(n, 7) control points [rad]."""
    position_error_max_m: float
    """Greatest distance of the TCP from the track at a frame [m]."""
    rotation_error_max_rad: float
    """Greatest angle from the track at a frame [rad]."""
    joint_limit_margin_min: float
    """Least distance from a joint limit / half the joint's range."""
    velocity_ratio_max: float
    """Greatest speed / limit."""
    acceleration_ratio_max: float | None
    """Greatest acceleration / limit; None where no limit is published."""
    jerk_ratio_max: float | None
    """Greatest jerk / limit; None where no limit is published."""
    torque_ratio_max: float
    """Greatest torque / limit, nothing in the hand."""
    self_distance_min_m: float | None
    """Least distance between two links [m]; None without a collision model."""
    table_distance_min_m: float | None
    """Least height over the table [m], negative: into it; None without a collision model."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Contact:
    """Where a trajectory comes nearest to itself or to the table."""

    table: bool
    """The table, else another link."""
    distance_m: float
    """Signed distance [m]."""
    least_m: float
    """What it must be at least [m]."""
    t_s: float
    """When, on the spline's clock [s]."""

    @property
    def broken(self) -> bool:
        """Whether the distance is too small."""
        return self.distance_m < self.least_m


@dataclass(frozen=True, kw_only=True)
class Course:
    """The track to follow, its clock set to 0 at the first frame."""

    plant: ArmPlant
    collision: CollisionModel | None
    """None leaves collisions out."""
    frames: NDArray[np.intp]
    """(T,) numbers of the frames in the track as it was given."""
    t_s: Array
    """(T,) [s], the first 0."""
    origin_s: float
    """The first frame's time in the track as it was given [s]."""
    X_BG: Array
    """(T, 4, 4) poses wanted of the TCP [m]."""
    q: Array
    """(T, 7) joint path to start from [rad]."""
    finger_width_m: Array | None
    """(T,) gap between the fingers [m]; None: as the plant has it."""
    table_tolerance_m: float
    """How far into the table the gripper may be [m]."""

    @cached_property
    def limits(self) -> LimitSet:
        """The plant's limits of joints and their rates."""
        rates = (self.plant.velocity_limits, self.plant.acceleration_limits, self.plant.jerk_limits)
        return LimitSet(lower=self.plant.lower, upper=self.plant.upper, rates=rates)

    def errors(self, q: Array) -> Array:
        """What `q` (T, 7) leaves to the poses (T, 6) [m]: rotation by its arm, position, expressed in B."""
        return self._errors(np.array([self.plant.forward(row) for row in q]))

    def _errors(self, X_now: Array) -> Array:
        e = np.empty((len(X_now), 6))
        turn = self.X_BG[:, :3, :3] @ np.swapaxes(X_now[:, :3, :3], -1, -2)
        e[:, :3] = ROTATION_ARM_M * rotation_log(turn)
        e[:, 3:] = self.X_BG[:, :3, 3] - X_now[:, :3, 3]
        return e

    def linearised(self, q: Array) -> PoseLinearisation:
        """The poses about the joint path `q` (T, 7) [rad]."""
        both = [self.plant.forward_and_jacobian(row) for row in q]
        J = np.array([J for _, J in both])
        J[:, :3] *= ROTATION_ARM_M
        return PoseLinearisation(t_s=self.t_s, q=q, J=J, e=self._errors(np.array([X for X, _ in both])))

    def nearest(self, t_s: float) -> int:
        """Number of the frame nearest to a time on the spline's clock."""
        return int(self.frames[np.argmin(np.abs(self.t_s - t_s))])

    def widths(self, t_s: Array) -> Array | None:
        """Finger gaps (N,) [m] at times (N,), between the frames in proportion."""
        if self.finger_width_m is None:
            return None
        known = np.isfinite(self.finger_width_m)
        return np.interp(t_s, self.t_s[known], self.finger_width_m[known]) if known.any() else None


class JointTrajectory:
    """A cubic B-spline in joint space and, computed once when asked for, how it follows its course."""

    def __init__(self, course: Course, basis: SplineBasis, control: Array) -> None:
        """Take the control points (n, 7) [rad]."""
        self.course, self.basis, self.control = course, basis, control

    @cached_property
    def q(self) -> Array:
        """(T, 7) joint angles at the frames [rad]."""
        return np.asarray(self.basis.values(self.course.t_s) @ self.control)

    @cached_property
    def deviations(self) -> tuple[float, float]:
        """Greatest distance [m] and angle [rad] from the track at a frame."""
        e = np.linalg.norm(self.course.errors(self.q).reshape(-1, 2, 3), axis=-1).max(axis=0)
        return float(e[1]), float(e[0] / ROTATION_ARM_M)

    @property
    def radius_m(self) -> float:
        """Radius of the tube that it needs [m]."""
        position, rotation = self.deviations
        return max(position, rotation * ROTATION_ARM_M)

    @cached_property
    def usage(self) -> tuple[Array | None, Array | None, Array | None]:
        """|Control points| (n - k, 7) of speed, acceleration and jerk over their limits; None where there is none."""
        ratios = [
            None if limit is None else np.abs(D @ self.control) / limit
            for D, limit in zip(self.basis.derivatives[1:], self.course.limits.rates, strict=True)
        ]
        return ratios[0], ratios[1], ratios[2]

    @property
    def keeps_limits(self) -> bool:
        """Whether joints, speeds, accelerations and jerks are within their limits at all times."""
        limits = self.course.limits
        inside = bool((self.control >= limits.lower).all() and (self.control <= limits.upper).all())
        return inside and all(ratio is None or ratio.max() <= KEPT for ratio in self.usage)

    @cached_property
    def samples_s(self) -> Array:
        """(N,) times of the samples on the spline's clock [s]: `SAMPLES` a span, breaks included."""
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
        return np.array([self.course.plant.torque(*rows) for rows in zip(*self.motion, strict=True)])

    @cached_property
    def _distances(self) -> tuple[Array, Array]:
        """Distances (N,) of the arm from itself, NaN where not looked at, and from the table [m], at the samples.

        The table is looked at in every sample; the arm itself, which costs more, twice a span, and in every sample
        of those spans that come within `NEAR_M` of the least distance.
        """
        collision = self.course.collision
        t, q = self.samples_s, self.motion[0]
        own, table = np.full(len(t), np.nan), np.full(len(t), np.nan)
        if collision is None:
            return own, table
        widths = self.course.widths(t)

        def look(samples: NDArray[np.intp]) -> None:
            own[samples] = collision.self_distance(q[samples], None if widths is None else widths[samples]).distance_m

        half = np.arange(0, len(t), SAMPLES // 2)
        look(half)
        if np.isfinite(own[half]).any():
            near = own[half] <= np.nanmin(own) + NEAR_M
            within = np.repeat(near[:-1] | near[1:], SAMPLES // 2)
            look(np.flatnonzero(within & np.isnan(own[:-1])))
        return own, collision.table_distance(q, widths).distance_m

    @cached_property
    def contacts(self) -> tuple[Contact, ...]:
        """The least distance of the arm from itself and that from the table; none without a collision model."""
        both = zip(self._distances, (False, True), (0.0, -self.course.table_tolerance_m), strict=True)
        return tuple(
            Contact(
                table=table, distance_m=float(np.nanmin(d)), least_m=least, t_s=float(self.samples_s[np.nanargmin(d)])
            )
            for d, table, least in both
            if np.isfinite(d).any()
        )

    @property
    def worst_contact(self) -> Contact | None:
        """The contact whose distance falls short most, or exceeds least, what it must be."""
        return min(self.contacts, key=lambda contact: contact.distance_m - contact.least_m, default=None)

    def obstacles(self) -> list[Obstacle]:
        """The distances below `NEAR_M`, linearised, twice a span and where they are least: of each the few least."""
        collision = self.course.collision
        if collision is None:
            return []
        found = []
        widths = self.course.widths(self.samples_s)
        watched = {*range(0, len(self.samples_s), SAMPLES // 2)}
        for distance in self._distances:
            d = np.nan_to_num(distance, nan=np.inf)
            watched |= {*np.flatnonzero((d[1:-1] < NEAR_M) & (d[1:-1] <= d[:-2]) & (d[1:-1] <= d[2:])) + 1}
        for k in sorted(watched):
            q = self.motion[0][k]
            near_pairs = collision.near_pairs(q, NEAR_M, None if widths is None else float(widths[k]))
            for near in near_pairs[:_WATCHED]:
                least = -self.course.table_tolerance_m if near.link_b == TABLE else 0.0
                found.append(
                    Obstacle(
                        t_s=float(self.samples_s[k]),
                        offset_m=near.distance_m - float(near.gradient @ q),
                        gradient=near.gradient,
                        least_m=least + _MARGIN_M,
                    )
                )
        return found

    def check(self) -> TrajectoryCheck:
        """Everything found along it."""
        plant, (q, v, a) = self.course.plant, self.motion
        margin = np.minimum(q - plant.lower, plant.upper - q) / (0.5 * (plant.upper - plant.lower))
        distance = {contact.table: contact.distance_m for contact in self.contacts}
        jerk = self.usage[2]  # constant in every span
        return TrajectoryCheck(
            knots_s=self.basis.knots + self.course.origin_s,
            control=self.control,
            position_error_max_m=self.deviations[0],
            rotation_error_max_rad=self.deviations[1],
            joint_limit_margin_min=float(margin.min()),
            velocity_ratio_max=float(np.abs(v / plant.velocity_limits).max()),
            acceleration_ratio_max=(
                None if plant.acceleration_limits is None else float(np.abs(a / plant.acceleration_limits).max())
            ),
            jerk_ratio_max=None if jerk is None else float(jerk.max()),
            torque_ratio_max=float(np.abs(self.torque / plant.effort_limits).max()),
            self_distance_min_m=distance.get(False),
            table_distance_min_m=distance.get(True),
        )
