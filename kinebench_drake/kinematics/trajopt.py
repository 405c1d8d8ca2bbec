"""Is there a smooth joint trajectory along a track? The smallest tube about the track that holds one, and a witness."""

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array, orthonormalize, rotation_log
from kinebench_drake.kinematics.collision import TABLE, CollisionModel
from kinebench_drake.kinematics.newton import ROTATION_ARM_M, newton
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.spline import SplineBasis
from kinebench_drake.kinematics.tube import LimitSet, Obstacle, PoseLinearisation, TubeSolution, solve_tube
from kinebench_drake.models.robot import N_JOINTS

SMALLEST_M = 1e-4
"""Radius that needs no smaller one [m]."""
LARGEST_M = 0.1
"""Radius beyond which a trajectory is no longer along the track [m]."""
RATIO = 1.25
"""The smallest radius is known to this ratio."""
SAMPLES = 8
"""Samples a span of the spline in which a trajectory is verified."""

_KEPT = 1.0 + 1e-6  # ratio up to which a limit counts as kept
_PROXIMITY = 0.5  # see solve_tube: the first weight; raised where a step went wrong
_PROGRAMS = 6  # programs at most that let the radius free
_BISECTIONS = 3  # and after them, programs with the radius given
_ROUNDS = 4  # rounds of pushing a trajectory out of collisions
_NEAR_M = 0.02  # distances watched while doing so
_MARGIN_M = 5e-4  # aimed at beyond the least distance
_TIGHTENINGS = 2  # attempts to save torque by accelerating less
_REFINED_FRAMES = 200  # tracks up to this long are tried again on a spline twice as fine before they are given up
_STATIC = 10  # worst frames whose posture is looked at for itself


class TubeFailure(Enum):
    """Which requirement no trajectory within the tube meets."""

    UNREACHABLE = "unreachable"
    JOINT_LIMIT = "joint_limit"
    VELOCITY = "velocity"
    ACCELERATION = "acceleration"
    JERK = "jerk"
    SELF_COLLISION = "self_collision"
    TABLE_COLLISION = "table_collision"
    TORQUE = "torque"


_RATES = (TubeFailure.VELOCITY, TubeFailure.ACCELERATION, TubeFailure.JERK)


@dataclass(frozen=True, slots=True, kw_only=True)
class TubeViolation:
    """The requirement that the best trajectory breaks, where it breaks it most."""

    kind: TubeFailure
    frame: int
    """The frame nearest to it."""
    joint: str | None
    """Name of the joint; None if no single joint is at fault."""
    value: float
    """What is asked for there: error [m], angle [rad], speed [rad/s], ..., distance [m], torque [N m]."""
    limit: float
    """What it may be, in the same unit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TubeCertificate:
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
class TubeResult:
    """The smallest tube about a track in which the robot can move, or why there is none."""

    radius_m: float | None
    """Smallest radius found feasible [m], `SMALLEST_M` at least; None if none up to `LARGEST_M` is, with a reason."""
    infeasible_radius_m: float | None
    """Greatest radius found infeasible (to first order, near the trajectory found) [m]; None if none was."""
    feasible: bool | None
    """Whether `radius_m` is at most the tube's limit; None where there is nothing to judge, with a reason."""
    certificate: TubeCertificate | None
    """The trajectory that proves `radius_m`."""
    violation: TubeViolation | None
    """What forbids a tube of the limit's radius; None if feasible, or if no single cause was found."""
    reason: str | None
    """Why there is no radius, or why it is beyond the limit; None if feasible."""
    programs: int
    """Convex programs solved."""


def optimize_in_tube(
    plant: ArmPlant,
    collision: CollisionModel | None,
    t_s: Array,
    X_BG: Array,
    q: Array,
    *,
    tube_limit_m: float = 0.005,
    table_tolerance_m: float = 0.002,
) -> TubeResult:
    """The smallest radius r of a tube about a track in which a smooth trajectory keeps every limit.

    In the tube is what lies, at every frame, within r of the position and within r / `ROTATION_ARM_M` of the rotation.
    The trajectory is a cubic B-spline in time with a break at every frame, of the track's own duration, its boundary
    speeds free. Joint positions, speeds, accelerations and jerks are kept at all times (bounds on control points);
    collisions and torques are kept where it is sampled.

    First the spline through `q` itself is checked; if it keeps everything, no program is solved. Else the program of
    `solve_tube` is linearised about `q`, then about its own result, until its least radius (what no trajectory near by
    undercuts) and the radius that the trajectory really has are within `RATIO` of each other; where they do not meet,
    the radius is bisected between them. Collisions found are pushed out by linearised distances. All this is local:
    a trajectory elsewhere in the joint space (another elbow) is not looked for.

    Args:
        plant: the robot.
        collision: distances; None leaves collisions out.
        t_s: (T,) times [s], increasing; frames left out of the track are simply absent.
        X_BG: (T, 4, 4) poses of panda_hand_tcp in panda_link0 [m].
        q: (T, 7) joint path [rad] to start from, such as the one that inverse kinematics found.
        tube_limit_m: greatest radius that counts as feasible [m].
        table_tolerance_m: how far into the table the gripper may be [m].
    """
    frames = np.flatnonzero(np.isfinite(q).all(axis=-1) & np.isfinite(X_BG).all(axis=(-2, -1)) & np.isfinite(t_s))
    t = t_s[frames]
    if len(frames) < 2:
        return _undecided("fewer than two frames with a pose and joint angles: there is no motion")
    if not (np.diff(t) > 0.0).all():
        return _undecided("the times do not increase from frame to frame")
    X = X_BG[frames].copy()
    X[:, :3, :3] = orthonormalize(X[:, :3, :3])
    search = _Search(plant, collision, t, X, q[frames], frames, tube_limit_m, table_tolerance_m)
    return search.run()


def _undecided(reason: str) -> TubeResult:
    return TubeResult(
        radius_m=None,
        infeasible_radius_m=None,
        feasible=None,
        certificate=None,
        violation=None,
        reason=reason,
        programs=0,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Trajectory:
    """A spline with the radius of tube that it needs."""

    basis: SplineBasis
    control: Array
    radius_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class _Contact:
    """The least distance along a trajectory."""

    distance_m: float
    t_s: float
    kind: TubeFailure
    least_m: float

    @property
    def broken(self) -> bool:
        return self.distance_m < self.least_m


class _Search:
    """Everything known of one track while its tube is looked for."""

    def __init__(
        self,
        plant: ArmPlant,
        collision: CollisionModel | None,
        t: Array,
        X: Array,
        q: Array,
        frames: NDArray[np.intp],
        tube_limit_m: float,
        table_tolerance_m: float,
    ) -> None:
        self.plant, self.collision, self.X, self.q, self.frames = plant, collision, X, q, frames
        self.origin_s, self.t = float(t[0]), t - t[0]
        self.tube_limit_m, self.table_tolerance_m = tube_limit_m, table_tolerance_m
        self.limits = LimitSet(
            lower=plant.lower,
            upper=plant.upper,
            rates=(plant.velocity_limits, plant.acceleration_limits, plant.jerk_limits),
        )
        self.programs = 0
        self.infeasible_m: float | None = None

    # -- the search ---------------------------------------------------------------------------------------------------

    def run(self) -> TubeResult:
        best = self._smallest()
        if best is None:
            return self._refused(None, None, "the convex program could not be solved")
        if best.radius_m > self.tube_limit_m:
            violation = self._broken_limit()
            return self._refused(best if best.radius_m <= LARGEST_M else None, violation, None)
        clear, contact = self._clear(best)
        if clear is None or clear.radius_m > self.tube_limit_m:
            violation = TubeViolation(
                kind=contact.kind,
                frame=self._frame(contact.t_s),
                joint=None,
                value=contact.distance_m,
                limit=contact.least_m,
            )
            return self._refused(clear, violation, None)
        light, violation = self._light(clear)
        if violation is not None:
            return self._refused(None, violation, None)
        return TubeResult(
            radius_m=max(light.radius_m, SMALLEST_M),
            infeasible_radius_m=self.infeasible_m,
            feasible=True,
            certificate=self._certificate(light),
            violation=None,
            reason=None,
            programs=self.programs,
        )

    def _refused(self, best: _Trajectory | None, violation: TubeViolation | None, reason: str | None) -> TubeResult:
        if reason is None and violation is None:
            reason = "the poses ask for more than the limits allow together; no single one is at fault"
        elif reason is None and violation is not None:
            at = violation.kind.value.replace("_", " ")
            joint = f" of {violation.joint}" if violation.joint else ""
            reason = f"{at}{joint} near frame {violation.frame}: {violation.value:.4g}, limit {violation.limit:.4g}"
        size = f"no tube up to {LARGEST_M} m" if best is None else f"the tube needs {best.radius_m:.4g} m"
        return TubeResult(
            radius_m=None if best is None else max(best.radius_m, SMALLEST_M),
            infeasible_radius_m=self.infeasible_m,
            feasible=False,
            certificate=None if best is None else self._certificate(best),
            violation=violation,
            reason=f"{size}; {reason}",
            programs=self.programs,
        )

    def _smallest(self) -> _Trajectory | None:
        """The trajectory of the smallest tube, collisions and torque aside."""
        basis = SplineBasis.through(self.t)
        fit = self._trajectory(basis, basis.fit(self.t, self.q))
        if fit.radius_m <= SMALLEST_M and self._keeps_limits(fit):
            return fit
        best = self._shrink(basis, self.q, ())
        if best is None or best.radius_m <= self.tube_limit_m or len(self.t) > _REFINED_FRAMES:
            return best
        if self.infeasible_m is not None and self.infeasible_m > 2.0 * self.tube_limit_m:
            return best
        finer = self._shrink(basis.refined(), basis.values(self.t) @ best.control, ())
        return min((best, finer or best), key=lambda trajectory: trajectory.radius_m)

    def _shrink(self, basis: SplineBasis, q: Array, obstacles: tuple[Obstacle, ...]) -> _Trajectory | None:
        """The smallest tube near the joint path `q` (T, 7): programs that free the radius, then bisection."""
        best: _Trajectory | None = None
        proximity, low = _PROXIMITY, SMALLEST_M
        for _ in range(_PROGRAMS):
            solution = self._solve(basis, q, None, proximity, obstacles)
            if solution is None:
                break
            low = max(solution.radius_m, SMALLEST_M)
            found = self._trajectory(basis, solution.control)
            if best is None or found.radius_m < best.radius_m:
                best = found
            else:
                proximity *= 4.0
            q = basis.values(self.t) @ best.control
            if best.radius_m <= RATIO * low or low > LARGEST_M:
                break
        if best is None:
            return None
        for _ in range(_BISECTIONS):
            if best.radius_m <= RATIO * low or low > LARGEST_M:
                break
            middle = float(np.sqrt(low * best.radius_m))
            solution = self._solve(basis, q, middle, proximity, obstacles)
            found = self._trajectory(basis, solution.control) if solution else best
            if solution is not None and found.radius_m <= middle * _KEPT:
                best, q = found, basis.values(self.t) @ found.control
            else:
                low = middle
        self.infeasible_m = low if low > SMALLEST_M else None
        return best

    def _solve(
        self,
        basis: SplineBasis,
        q: Array,
        radius_m: float | None,
        proximity: float,
        obstacles: tuple[Obstacle, ...],
        *,
        elastic: bool = False,
    ) -> TubeSolution | None:
        self.programs += 1
        return solve_tube(
            basis,
            self._linearised(q),
            self.limits,
            radius_m=radius_m,
            proximity=proximity,
            obstacles=obstacles,
            elastic=elastic,
        )

    def _linearised(self, q: Array) -> PoseLinearisation:
        both = [self.plant.forward_and_jacobian(row) for row in q]
        J = np.array([J for _, J in both])
        J[:, :3] *= ROTATION_ARM_M
        return PoseLinearisation(t_s=self.t, q=q, J=J, e=_errors(np.array([X for X, _ in both]), self.X))

    def _trajectory(self, basis: SplineBasis, control: Array) -> _Trajectory:
        e = self._frame_errors(basis, control)
        radius = float(np.linalg.norm(e.reshape(-1, 2, 3), axis=-1).max())
        return _Trajectory(basis=basis, control=control, radius_m=radius)

    def _frame_errors(self, basis: SplineBasis, control: Array) -> Array:
        q = basis.values(self.t) @ control
        return _errors(np.array([self.plant.forward(row) for row in q]), self.X)

    def _keeps_limits(self, trajectory: _Trajectory) -> bool:
        control = trajectory.control
        if (control < self.limits.lower).any() or (control > self.limits.upper).any():
            return False
        for D, limit in zip(trajectory.basis.derivatives[1:], self.limits.rates, strict=True):
            if limit is not None and (np.abs(D @ control) > limit * _KEPT).any():
                return False
        return True

    # -- collisions and torque ----------------------------------------------------------------------------------------

    def _clear(self, trajectory: _Trajectory) -> tuple[_Trajectory | None, _Contact]:
        """The trajectory pushed out of collisions, None where that fails, and the worst contact before."""
        first = worst = self._worst_contact(trajectory)
        basis, obstacles = trajectory.basis, list[Obstacle]()
        for _ in range(_ROUNDS):
            if not worst.broken:
                return trajectory, first
            obstacles += self._obstacles(trajectory)
            moved = self._shrink(basis, basis.values(self.t) @ trajectory.control, tuple(obstacles))
            if moved is None:
                return None, first
            trajectory, worst = moved, self._worst_contact(moved)
        return (None if worst.broken else trajectory), first

    def _worst_contact(self, trajectory: _Trajectory) -> _Contact:
        """The distance that falls short most of what it shall be at least, or exceeds it least."""
        none = _Contact(distance_m=np.inf, t_s=0.0, kind=TubeFailure.SELF_COLLISION, least_m=0.0)
        contacts = [none, *self._contacts(trajectory)]
        return min(contacts, key=lambda contact: contact.distance_m - contact.least_m)

    def _contacts(self, trajectory: _Trajectory) -> list[_Contact]:
        """Least distances from self and table along the trajectory; none without a collision model.

        The table is looked at in every sample; the arm itself, which costs most, twice a span, and in every sample
        of the spans that come within 2 cm of the least distance.
        """
        if self.collision is None:
            return []
        t = _sample_times(trajectory.basis)
        q = trajectory.basis.evaluate(trajectory.control, t)
        table = self.collision.table_distance(q).distance_m
        half = SAMPLES // 2
        own = np.full(len(t), np.inf)
        own[::half] = np.nan_to_num(self.collision.self_distance(q[::half]).distance_m, nan=np.inf)
        near = own[::half] <= own.min() + _NEAR_M
        cells = np.repeat(near[:-1] | near[1:], half)
        rest = np.flatnonzero(cells & np.isinf(own[:-1]))
        if len(rest):
            own[rest] = np.nan_to_num(self.collision.self_distance(q[rest]).distance_m, nan=np.inf)
        contacts = []
        for distance, kind, least in (
            (own, TubeFailure.SELF_COLLISION, 0.0),
            (np.nan_to_num(table, nan=np.inf), TubeFailure.TABLE_COLLISION, -self.table_tolerance_m),
        ):
            k = int(np.argmin(distance))
            contacts.append(_Contact(distance_m=float(distance[k]), t_s=float(t[k]), kind=kind, least_m=least))
        return contacts

    def _obstacles(self, trajectory: _Trajectory) -> list[Obstacle]:
        """Linearised distances near contact, at the frames and halfway between the breaks."""
        if self.collision is None:
            return []
        t = _sample_times(trajectory.basis)
        q_all = trajectory.basis.evaluate(trajectory.control, t)
        obstacles = []
        table = self.collision.table_distance(q_all).distance_m
        for k in range(0, len(t), SAMPLES // 2):
            for near in self.collision.near_pairs(q_all[k], _NEAR_M):
                least = -self.table_tolerance_m if near.link_b == TABLE else 0.0
                if near.distance_m - least < _NEAR_M:
                    offset = near.distance_m - float(near.gradient @ q_all[k])
                    obstacles.append(
                        Obstacle(t_s=float(t[k]), offset_m=offset, gradient=near.gradient, least_m=least + _MARGIN_M)
                    )
        del table
        return obstacles

    def _light(self, trajectory: _Trajectory) -> tuple[_Trajectory, TubeViolation | None]:
        """The trajectory with its torques within limits, accelerating less if need be, or the torque that is not."""
        violation = self._broken_torque(trajectory)
        for _ in range(_TIGHTENINGS):
            if violation is None or self.limits.rates[1] is None:
                break
            t, (q, v, a) = self._samples(trajectory)
            del t, v
            used = float(np.abs(a / self.limits.rates[1]).max())
            weight = np.array([self.plant.torque(row, np.zeros(N_JOINTS), np.zeros(N_JOINTS)) for row in q])
            still = float(np.abs(weight / self.plant.effort_limits).max())
            asked = abs(violation.value) / violation.limit
            if still >= 1.0:
                break
            factor = used * 0.95 * (1.0 - still) / (asked - still)
            velocity, acceleration, jerk = self.limits.rates
            self.limits = LimitSet(
                lower=self.limits.lower, upper=self.limits.upper, rates=(velocity, factor * acceleration, jerk)
            )
            slower = self._shrink(trajectory.basis, trajectory.basis.values(self.t) @ trajectory.control, ())
            if slower is None or slower.radius_m > self.tube_limit_m or self._worst_contact(slower).broken:
                break
            trajectory = slower
            violation = self._broken_torque(trajectory)
        return trajectory, violation

    def _samples(self, trajectory: _Trajectory) -> tuple[Array, tuple[Array, Array, Array]]:
        t = _sample_times(trajectory.basis)
        q, v, a = (trajectory.basis.evaluate(trajectory.control, t, order) for order in range(3))
        return t, (q, v, a)

    def _torques(self, trajectory: _Trajectory) -> tuple[Array, Array]:
        """Sample times and torques (N, 7) [N m]."""
        t, (q, v, a) = self._samples(trajectory)
        return t, np.array([self.plant.torque(*rows) for rows in zip(q, v, a, strict=True)])

    def _broken_torque(self, trajectory: _Trajectory) -> TubeViolation | None:
        t, torque = self._torques(trajectory)
        ratio = np.abs(torque / self.plant.effort_limits)
        k, j = np.unravel_index(np.argmax(ratio), ratio.shape)
        if ratio[k, j] <= 1.0:
            return None
        return TubeViolation(
            kind=TubeFailure.TORQUE,
            frame=self._frame(float(t[k])),
            joint=self.plant.robot.joints[j],
            value=float(torque[k, j]),
            limit=float(self.plant.effort_limits[j]),
        )

    # -- why not ------------------------------------------------------------------------------------------------------

    def _broken_limit(self) -> TubeViolation | None:
        """Which limit forbids the allowed tube: a posture's, else the rate that is exceeded most at least excess."""
        violation = self._broken_posture()
        if violation is not None:
            return violation
        basis = SplineBasis.through(self.t)
        solution = self._solve(basis, self.q, self.tube_limit_m, 0.01, (), elastic=True)
        if solution is None:
            return None
        worst: TubeViolation | None = None
        greatest = 1e-4
        for k, (kind, over, limit) in enumerate(zip(_RATES, solution.excess, self.limits.rates, strict=True)):
            if limit is None or over.max(initial=0.0) <= greatest:
                continue
            i, j = np.unravel_index(np.argmax(over), over.shape)
            greatest = float(over[i, j])
            worst = TubeViolation(
                kind=kind,
                frame=self._frame(float(basis.centres(k + 1)[i])),
                joint=self.plant.robot.joints[j],
                value=float(limit[j] * (1.0 + greatest)),
                limit=float(limit[j]),
            )
        return worst

    def _broken_posture(self) -> TubeViolation | None:
        """The worst frame whose pose the arm cannot take near its posture even if it had all the time."""
        fit = _errors(
            np.array([self.plant.forward(np.clip(row, self.limits.lower, self.limits.upper)) for row in self.q]), self.X
        )
        error = np.linalg.norm(fit.reshape(-1, 2, 3), axis=-1).max(axis=-1)
        for i in np.argsort(-error, kind="stable")[:_STATIC]:
            if error[i] <= self.tube_limit_m:
                return None
            q, _ = newton(self.plant, self.X[i], self.q[i])
            left = _errors(self.plant.forward(q)[None], self.X[i : i + 1]).reshape(2, 3)
            least = float(np.linalg.norm(left, axis=-1).max())
            if least <= self.tube_limit_m:
                continue
            q_free, error_free = newton(self.plant, self.X[i], self.q[i], bounded=False)
            frame = int(self.frames[i])
            past = np.maximum(self.plant.lower - q_free, q_free - self.plant.upper)
            if error_free <= self.tube_limit_m and past.max() > 0.0:
                j = int(np.argmax(past))
                return TubeViolation(
                    kind=TubeFailure.JOINT_LIMIT,
                    frame=frame,
                    joint=self.plant.robot.joints[j],
                    value=float(q_free[j]),
                    limit=float(self.plant.upper[j] if q_free[j] > self.plant.upper[j] else self.plant.lower[j]),
                )
            return TubeViolation(
                kind=TubeFailure.UNREACHABLE, frame=frame, joint=None, value=least, limit=self.tube_limit_m
            )
        return None

    def _frame(self, t: float) -> int:
        return int(self.frames[np.argmin(np.abs(self.t - t))])

    # -- the witness --------------------------------------------------------------------------------------------------

    def _certificate(self, trajectory: _Trajectory) -> TubeCertificate:
        plant, basis = self.plant, trajectory.basis
        _, (q, v, a) = self._samples(trajectory)
        torque = self._torques(trajectory)[1]
        e = np.linalg.norm(self._frame_errors(basis, trajectory.control).reshape(-1, 2, 3), axis=-1)
        jerk = basis.derivatives[3] @ trajectory.control
        margin = np.minimum(q - plant.lower, plant.upper - q) / (0.5 * (plant.upper - plant.lower))
        contacts = {contact.kind: contact.distance_m for contact in self._contacts(trajectory)}
        return TubeCertificate(
            knots_s=basis.knots + self.origin_s,
            control=trajectory.control,
            position_error_max_m=float(e[:, 1].max()),
            rotation_error_max_rad=float(e[:, 0].max() / ROTATION_ARM_M),
            joint_limit_margin_min=float(margin.min()),
            velocity_ratio_max=float(np.abs(v / plant.velocity_limits).max()),
            acceleration_ratio_max=_ratio(a, plant.acceleration_limits),
            jerk_ratio_max=_ratio(jerk, plant.jerk_limits),
            torque_ratio_max=float(np.abs(torque / plant.effort_limits).max()),
            self_distance_min_m=contacts.get(TubeFailure.SELF_COLLISION),
            table_distance_min_m=contacts.get(TubeFailure.TABLE_COLLISION),
        )


def _ratio(values: Array, limits: Array | None) -> float | None:
    return None if limits is None else float(np.abs(values / limits).max())


def _errors(X_now: Array, X_BG: Array) -> Array:
    """Rotation (by its arm) and position (T, 6) [m] from poses `X_now` to `X_BG` (T, 4, 4), expressed in B."""
    e = np.empty((len(X_now), 6))
    e[:, :3] = ROTATION_ARM_M * rotation_log(X_BG[:, :3, :3] @ np.swapaxes(X_now[:, :3, :3], -1, -2))
    e[:, 3:] = X_BG[:, :3, 3] - X_now[:, :3, 3]
    return e


def _sample_times(basis: SplineBasis) -> Array:
    spans = len(basis.breaks_s) - 1
    return np.interp(np.arange(SAMPLES * spans + 1) / SAMPLES, np.arange(spans + 1), basis.breaks_s)
