"""Trajectory optimisation: the smallest tube about a track that contains a feasible joint trajectory."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from kinebench_drake.geometry import Array, orthonormalize
from kinebench_drake.kinematics.collision import CollisionModel
from kinebench_drake.kinematics.joint_trajectory import JointTrajectory, TubeProblem
from kinebench_drake.kinematics.newton import solve_newton
from kinebench_drake.kinematics.path import limit_excess
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.spline import SplineBasis
from kinebench_drake.kinematics.tube import DistanceBound, proximity_cost_m, solve_tube
from kinebench_drake.violation import RATES, Violation, ViolationKind

SMALLEST_M = 1e-4
"""Radius below which the search does not continue [m]."""
LARGEST_M = 0.1
"""Greatest radius of a tube about the track [m]."""
RATIO = 1.25
"""Ratio between upper and lower bound of the radius at which the search ends."""
MOST_FRAMES = 1000
"""Greatest number of frames; of a longer track only every second, third, ... frame and the last are used."""
HOPELESS = 2.0
"""Factor of the tube's limit: if that radius is infeasible, the finer spline is not tried."""
REFINED_FRAMES = 200
"""Greatest number of frames of a track that is tried on a spline twice as fine."""
PROXIMITY = 0.5
"""Initial proximity weight of `solve_tube`; raised after a step that widened the tube."""
FIXED_SHARE = 0.99
"""Share of a fixed radius used by the program; the rest covers the curvature of the poses."""
FAR_OUT = 1.5
"""Factor of the tube's limit above which the error of a posture is the cause, whatever else is."""

# proximity cost / radius (within the tube's limit, beyond it) above which
_CONFINED = 0.1
_CONFINED_BEYOND = 0.02
# another program, linearised about the new path, may find a smaller tube
# factors of the proximity weight after a step that failed and one that succeeded
_TIGHTER = 4.0
_LOOSER = 0.25
# Greatest numbers of programs with free radius, then with fixed radius:
# first search, on the finer spline, per round
_FULL = (5, 3)
_REFINED_EFFORT = (3, 1)
_ROUND_EFFORT = (2, 1)
# of collision avoidance; the latter if the tube is infeasible anyway
_ROUNDS = 4
_FEWER_ROUNDS = 2
_TORQUE_AIM = 0.95  # share of the torque limit aimed at by the reduction


@dataclass(frozen=True, slots=True, kw_only=True)
class TubeResult:
    """Smallest tube about a track in which the robot can move, or the reason why there is none."""

    radius_m: float | None = None
    """Smallest feasible radius found [m], at least `SMALLEST_M`; None if none up to `LARGEST_M` is, with a reason."""
    infeasible_radius_m: float | None = None
    """Greatest radius found infeasible (to first order, near the trajectory) [m]; None if there was none."""
    feasible: bool | None = None
    """True if `radius_m` is at most the tube's limit; None if the track cannot be judged, with a reason."""
    certificate: JointTrajectory | None = None
    """Trajectory that proves `radius_m`."""
    violation: Violation | None = None
    """Requirement that makes a tube of the limit's radius infeasible; None if feasible, or without a single cause."""
    reason: str | None = None
    """Why there is no radius, or why it exceeds the limit; None if feasible."""


def optimize_in_tube(
    plant: ArmPlant,
    collision: CollisionModel | None,
    t_s: Array,
    X_BG: Array,
    q: Array,
    *,
    tube_limit_m: float = 0.005,
    table_tolerance_m: float = 0.002,
    finger_width_m: Array | None = None,
) -> TubeResult:
    """Find the smallest radius r of a tube about a track that contains a smooth trajectory within every limit.

    A trajectory is in the tube if, at every frame, its position error is at most r and its rotation error at most r /
    `ROTATION_ARM_M`. It is a cubic B-spline with a break at every frame (`SplineBasis.through`), of the duration of the
    track, with free boundary speeds. Limits of position, speed, acceleration and jerk hold at all times, by bounds on
    control points; collisions, torques and speed limits that depend on the position are checked at samples.

    If the spline through `q` does not do, `solve_tube` is linearised about `q`, then about its own result, until its
    least radius and the one that the trajectory needs are within `RATIO`; else the radius is bisected. A trajectory
    that collides is moved by linearised distances; one of too much torque gets lower acceleration limits. Short tracks
    beyond the limit are tried on a spline twice as fine. The search is local: a radius has a certificate, and
    "infeasible" holds near `q`.

    Args:
        collision: collision model; None ignores collisions.
        t_s: (T,) times [s], increasing; they may have gaps.
        X_BG: (T, 4, 4) poses of the TCP in the base [m].
        q: (T, J) initial joint path [rad], such as that of inverse kinematics.
        tube_limit_m: greatest radius that counts as feasible [m].
        table_tolerance_m: allowed penetration of the table [m].
        finger_width_m: (T,) gap between the finger pads [m]; None for the plant's default.
    """
    usable = np.isfinite(q).all(axis=-1) & np.isfinite(X_BG).all(axis=(-2, -1)) & np.isfinite(t_s)
    frames = np.flatnonzero(usable)
    if len(frames) < 2:
        return TubeResult(reason="fewer than two frames with a pose and joint angles: there is no motion")
    if not (np.diff(t_s[frames]) > 0.0).all():
        return TubeResult(reason="the times do not increase from frame to frame")
    stride = -(-len(frames) // MOST_FRAMES)
    frames = np.unique(np.append(frames[::stride], frames[-1]))
    X = X_BG[frames].copy()
    X[:, :3, :3] = orthonormalize(X[:, :3, :3])
    problem = TubeProblem(
        plant=plant,
        collision=collision,
        frames=frames,
        t_s=t_s[frames] - t_s[frames[0]],
        origin_s=float(t_s[frames[0]]),
        X_BG=X,
        q=q[frames],
        finger_width_m=None if finger_width_m is None else finger_width_m[frames],
        table_tolerance_m=table_tolerance_m,
    )
    return _TubeSearch(problem, tube_limit_m).run()


class _TubeSearch:
    """State of the search for the smallest tube of one track."""

    def __init__(self, problem: TubeProblem, tube_limit_m: float) -> None:
        self.problem = problem
        self.tube_limit_m = tube_limit_m
        self.limits = problem.limits
        self.infeasible_m: float | None = None

    def run(self) -> TubeResult:
        """Apply the limits, then collisions, then torques; the first requirement that fails is the cause."""
        fit, best = self._smallest()
        cause = None if best.radius_m <= self.tube_limit_m else self._broken_limit(fit)
        if best.radius_m > LARGEST_M:
            return self._result(None, cause)
        contact = best.contact
        clear = self._avoid_collisions(best, _ROUNDS if cause is None else _FEWER_ROUNDS)
        if clear is None or clear.radius_m > self.tube_limit_m:
            cause = cause or contact
        if clear is None or clear.radius_m > LARGEST_M:
            return self._result(None, cause)
        torque = clear.overload
        reduced = self._reduce_torque(clear)
        if reduced is None or reduced.radius_m > self.tube_limit_m:
            cause = cause or torque
        return self._result(reduced, cause)

    def _result(self, best: JointTrajectory | None, cause: Violation | None) -> TubeResult:
        speeding = None if best is None else best.speeding
        cause = cause or speeding
        feasible = best is not None and best.radius_m <= self.tube_limit_m and speeding is None
        none = f"no trajectory was found in a tube of up to {LARGEST_M:g} m"
        size = none if best is None else f"the tube needs {best.radius_m:.4g} m"
        why = describe_violation(cause) if cause else "the limits together forbid a narrower one, none of them alone"
        return TubeResult(
            radius_m=None if best is None else max(best.radius_m, SMALLEST_M),
            infeasible_radius_m=self.infeasible_m,
            feasible=feasible,
            certificate=best,
            violation=None if feasible else cause,
            reason=None if feasible else f"{size}; {why}",
        )

    def _smallest(self) -> tuple[JointTrajectory, JointTrajectory]:
        """Return the spline through the joint path and that of the smallest tube, contact and torque ignored."""
        problem = self.problem
        basis = SplineBasis.through(problem.t_s)
        fit = JointTrajectory(problem, basis, basis.fit(problem.t_s, problem.q))
        if fit.radius_m <= SMALLEST_M and fit.keeps_limits:
            return fit, fit
        best = self._shrink(basis, self._start, (), _FULL)
        if best is None:  # the program exceeds the precision of the solver; a rest is always within limits
            middle = np.clip(problem.q[len(problem.q) // 2], problem.limits.lower, problem.limits.upper)
            return fit, JointTrajectory(problem, basis, np.tile(middle, (basis.size, 1)))
        hopeless = self.infeasible_m is not None and self.infeasible_m > HOPELESS * self.tube_limit_m
        if best.radius_m <= self.tube_limit_m or len(problem.t_s) > REFINED_FRAMES or hopeless:
            return fit, best
        finer = self._shrink(basis.refine(), best.q, (), _REFINED_EFFORT)
        return fit, best if finer is None or finer.radius_m > best.radius_m else finer

    @cached_property
    def _start(self) -> Array:
        """Joint path (T, J) [rad]; from the first frame past a limit on, poses are solved again within limits."""
        q = self.problem.q
        limits = self.limits
        outside = np.flatnonzero(((q < limits.lower) | (q > limits.upper)).any(axis=-1))
        if len(outside) == 0:
            return q
        q = np.clip(q, limits.lower, limits.upper)
        for i in range(int(outside[0]), len(q)):
            q[i], _ = solve_newton(self.problem.plant, self.problem.X_BG[i], q[max(i - 1, 0)])
        return q

    def _shrink(
        self, basis: SplineBasis, q: Array, obstacles: tuple[DistanceBound, ...], effort: tuple[int, int]
    ) -> JointTrajectory | None:
        """Find the smallest tube near the joint path `q` (T, J): programs with free radius, then bisection."""
        best: JointTrajectory | None = None
        proximity = PROXIMITY
        looser = _LOOSER
        low = SMALLEST_M
        for _ in range(effort[0]):
            solution = solve_tube(basis, self.problem.linearise(q), self.limits, None, proximity, obstacles)
            if solution is None:
                break
            low = max(solution.radius_m, SMALLEST_M)
            candidate = JointTrajectory(self.problem, basis, solution.control)
            cost = proximity_cost_m(candidate.q, q, proximity)
            if best is not None and candidate.radius_m >= best.radius_m:
                proximity = _TIGHTER * proximity
                looser = 1.0
            else:
                best = candidate
                proximity *= looser if candidate.radius_m <= RATIO * low else 1.0
            confined = cost > low * (_CONFINED if best.radius_m <= self.tube_limit_m else _CONFINED_BEYOND)
            q = best.q
            if (best.radius_m <= RATIO * low and not confined) or low > LARGEST_M:
                break
        if best is None:
            return None
        for _ in range(effort[1]):
            in_doubt = low < self.tube_limit_m < best.radius_m
            if low > LARGEST_M or (best.radius_m <= RATIO * low and not in_doubt):
                break
            middle = self.tube_limit_m if in_doubt else float(np.sqrt(low * best.radius_m))
            poses = self.problem.linearise(best.q)
            solution = solve_tube(basis, poses, self.limits, FIXED_SHARE * middle, proximity, obstacles)
            candidate = JointTrajectory(self.problem, basis, solution.control) if solution else best
            if candidate.radius_m <= middle:
                best = candidate
            else:
                low = middle
        self.infeasible_m = low if SMALLEST_M < low < best.radius_m else None
        return best

    def _avoid_collisions(self, trajectory: JointTrajectory, rounds: int) -> JointTrajectory | None:
        """Return the trajectory moved out of collisions; None if that fails."""
        obstacles: list[DistanceBound] = []
        for _ in range(rounds):
            if trajectory.contact is None:
                return trajectory
            obstacles += trajectory.obstacles()
            moved = self._shrink(trajectory.basis, trajectory.q, tuple(obstacles), _ROUND_EFFORT)
            if moved is None or moved.radius_m > LARGEST_M:
                return None
            trajectory = moved
        return trajectory if trajectory.contact is None else None

    def _reduce_torque(self, trajectory: JointTrajectory) -> JointTrajectory | None:
        """Return the trajectory with torques within limits, by lower accelerations if needed; None if that fails."""
        plant = self.problem.plant
        for _ in range(2):  # attempts to reduce torque by lower accelerations
            violation = trajectory.overload
            if violation is None:
                return trajectory
            velocity, acceleration, jerk = self.limits.rates
            q, _, a = trajectory.motion
            if acceleration is None:
                acceleration = np.full_like(velocity, np.abs(a).max())
            still = plant.chain.torques(q, np.zeros_like(q), np.zeros_like(q))
            weight = float(np.abs(still / plant.effort_limits).max())
            if weight >= _TORQUE_AIM:
                return None
            # Torque beyond that of gravity is taken as proportional to acceleration.
            used = float(np.abs(a / acceleration).max())
            factor = used * (_TORQUE_AIM - weight) / (abs(violation.value) / violation.limit - weight)
            self.limits = replace(self.limits, rates=(velocity, factor * acceleration, jerk))
            slower = self._shrink(trajectory.basis, trajectory.q, tuple(trajectory.obstacles()), _ROUND_EFFORT)
            if slower is None or slower.radius_m > LARGEST_M or slower.contact is not None:
                return None
            trajectory = slower
        return trajectory if trajectory.overload is None else None

    def _broken_limit(self, fit: JointTrajectory) -> Violation | None:
        """Find the limit that makes the tube infeasible.

        A pose far out of reach; else the rate exceeded by the elastic program; else a limit or pose of the initial
        path.
        """
        problem = self.problem
        limit = self.tube_limit_m
        violation = find_pose_violation(problem, limit, FAR_OUT)
        if violation is not None:
            return violation
        solution = solve_tube(fit.basis, problem.linearise(self._start), self.limits, limit, 0.01, elastic=True)
        return (
            (solution and find_rate_violation(problem, fit.basis, solution.excess, offset=1.0))
            or find_start_violation(problem)
            or find_rate_violation(problem, fit.basis, fit.usage)
            or find_pose_violation(problem, limit)
        )


def describe_violation(violation: Violation) -> str:
    """Describe a violation at one frame in a line."""
    kind = violation.kind.value.replace("_", " ")
    unit = violation.unit
    joint = f" of {violation.joint}" if violation.joint else ""
    return (
        f"{kind}{joint} near frame {violation.frame_start}: {violation.value:.4g} {unit}, "
        f"limit {violation.limit:.4g} {unit}"
    )


def find_pose_violation(problem: TubeProblem, tube_limit_m: float, margin: float = 1.0) -> Violation | None:
    """Find the worst frame whose pose the arm cannot take near its posture, whatever the time; None if there is none.

    The error is the root of both squared errors, rotation by its arm: up to sqrt(2) times the radius of a tube. It is
    reported above `margin` times its limit `tube_limit_m` [m].
    """
    least_m = margin * tube_limit_m
    plant = problem.plant
    error = np.linalg.norm(problem.errors(np.clip(problem.q, plant.lower, plant.upper)), axis=-1)
    for i in np.argsort(-error, kind="stable")[:10]:  # frames of the greatest errors whose poses are solved one by one
        if error[i] <= least_m:
            return None
        _, bounded = solve_newton(plant, problem.X_BG[i], problem.q[i])
        if bounded <= least_m:
            continue
        q, free = solve_newton(plant, problem.X_BG[i], problem.q[i], bounded=False)
        past = limit_excess(plant, q)
        j = int(np.argmax(past))
        frame = int(problem.frames[i])
        if free > least_m or past[j] <= 0.0:
            return Violation.at(ViolationKind.UNREACHABLE, frame, None, bounded, tube_limit_m)
        return _joint_limit_violation(plant, frame, j, float(q[j]))
    return None


def find_start_violation(problem: TubeProblem) -> Violation | None:
    """Find the joint angle of the initial path that is farthest past its limit; None if all are within limits."""
    past = limit_excess(problem.plant, problem.q)
    i, j = np.unravel_index(np.argmax(past), past.shape)
    if past[i, j] <= 0.0:
        return None
    return _joint_limit_violation(problem.plant, int(problem.frames[i]), int(j), float(problem.q[i, j]))


def _joint_limit_violation(plant: ArmPlant, frame: int, joint: int, value: float) -> Violation:
    limit = float(plant.upper[joint] if value > plant.upper[joint] else plant.lower[joint])
    return Violation.at(ViolationKind.JOINT_LIMIT, frame, plant.robot.joints[joint], value, limit)


def find_rate_violation(
    problem: TubeProblem, basis: SplineBasis, ratios: Sequence[Array | None], offset: float = 0.0
) -> Violation | None:
    """Find the rate that exceeds its limit most, relative to it; None if none does.

    `ratios` are the control points (n - k, J) of the k-th derivative of the spline / limit, less `offset`, for k =
    1..3; None without a limit. `offset` is 1 if they are excesses over the limit.
    """
    # of a limit, above which it counts as broken
    worst = None
    least = 1.0 - offset + 1e-3
    for k, (kind, ratio, limit) in enumerate(zip(RATES, ratios, problem.limits.rates, strict=True)):
        if ratio is None or limit is None or ratio.max(initial=0.0) <= least:
            continue
        i, j = np.unravel_index(np.argmax(ratio), ratio.shape)
        least = float(ratio[i, j])
        frame = problem.nearest_frame(float(basis.centres(k + 1)[i]))
        value = float(limit[j] * (offset + least))
        worst = Violation.at(kind, frame, problem.plant.robot.joints[j], value, float(limit[j]))
    return worst
