"""Is there a smooth joint trajectory along a track? The smallest tube about the track that holds one, and a witness."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from kinebench_drake.geometry import Array, orthonormalize
from kinebench_drake.kinematics.collision import CollisionModel
from kinebench_drake.kinematics.infeasibility import (
    TubeViolation,
    broken_distance,
    broken_posture,
    broken_rate,
    broken_start,
    broken_torque,
    steepest_rate,
)
from kinebench_drake.kinematics.newton import newton
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.spline import SplineBasis
from kinebench_drake.kinematics.trajectory import Course, JointTrajectory, TrajectoryCheck
from kinebench_drake.kinematics.tube import Obstacle, TubeSolution, proximity_cost_m, solve_tube

SMALLEST_M = 1e-4
"""Radius that needs no smaller one [m]."""
LARGEST_M = 0.1
"""Radius beyond which a trajectory is no longer along the track [m]."""
RATIO = 1.25
"""The smallest radius is known to this ratio, as far as programs linearised beside it can tell."""
LONGEST = 1000
"""Frames of a track that are looked at: of a longer one only every second, third, ... frame and the last."""

_PROXIMITY = 0.5  # see solve_tube: the first weight; raised where a step went wrong
_ELASTIC_PROXIMITY = 0.01
_HELD, _HELD_BEYOND = 0.1, 0.02  # of the radius (within the tube's limit, beyond): while staying near the last path
# costs more, another program may do better
_TIGHTER, _LOOSER = 4.0, 0.25  # changes of that weight after a step that went wrong and one that went well
# Programs at most that leave the radius free, and after them those with the radius given:
_FULL, _REFINED_EFFORT, _ROUND_EFFORT = (5, 3), (3, 1), (2, 1)  # at first, on the finer spline, a round
_AIM = 0.99  # of a given radius, to leave room for the poses' curvature
_ROUNDS, _FEWER_ROUNDS = 4, 2  # of pushing a trajectory out of collisions; where the track is refused anyway
_TIGHTENINGS = 2  # attempts to save torque by accelerating less
_SURELY = 1.5  # times the tube's limit: a posture that far off is at fault, whatever else is (see broken_posture)
_TORQUE_AIM = 0.95  # of the torque's limit, then
_REFINED = 200  # tracks up to so many frames are tried on a spline twice as fine before they are given up
_HOPELESS = 2.0  # times the tube's limit: what is known infeasible beyond is not tried again


@dataclass(frozen=True, slots=True, kw_only=True)
class TubeResult:
    """The smallest tube about a track in which the robot can move, or why there is none."""

    radius_m: float | None
    """Smallest radius found feasible [m], `SMALLEST_M` at least; None if none up to `LARGEST_M` is, with a reason."""
    infeasible_radius_m: float | None
    """Greatest radius found infeasible (to first order, near the trajectory found) [m]; None if none was."""
    feasible: bool | None
    """Whether `radius_m` is at most the tube's limit; None where there is nothing to judge, with a reason."""
    certificate: TrajectoryCheck | None
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
    finger_width_m: Array | None = None,
) -> TubeResult:
    """The smallest radius r of a tube about a track in which a smooth trajectory keeps every limit.

    In the tube is what lies, at every frame, within r of the position and within r / `ROTATION_ARM_M` of the rotation.
    The trajectory is a cubic B-spline in time with a break at every frame (`SplineBasis.through`), of the track's own
    duration, its boundary speeds free. Joint positions, speeds, accelerations and jerks are kept at all times, by
    bounds on control points; collisions and torques are kept wherever it is sampled.

    First the spline through `q` itself is checked; if it keeps everything, no program is solved. Else the program of
    `solve_tube` is linearised about `q`, then about its own result, until its least radius (which, to first order, no
    trajectory near by undercuts) and the radius that the trajectory really needs are within `RATIO` of each other;
    where they do not meet, or the tube's limit lies between them, the radius is bisected. A trajectory that collides
    is pushed out by linearised distances; one that asks for too much torque is made to accelerate less. Where the
    limit is exceeded, the search goes on longer, and on tracks of up to 200 frames also on a spline twice as fine. All
    this is local: a path far off in the joint space (another elbow) is not looked for, so that a radius is an upper
    bound with a witness, and "infeasible" holds near `q`.

    Args:
        plant: the robot.
        collision: distances; None leaves collisions out.
        t_s: (T,) times [s], increasing; frames left out of the track are simply absent.
        X_BG: (T, 4, 4) poses of the TCP in the base [m].
        q: (T, 7) joint path [rad] to start from, such as inverse kinematics finds.
        tube_limit_m: greatest radius that counts as feasible [m].
        table_tolerance_m: how far into the table the gripper may be [m].
        finger_width_m: (T,) gap between the fingers [m]; None: as the plant has it.
    """
    usable = np.isfinite(q).all(axis=-1) & np.isfinite(X_BG).all(axis=(-2, -1)) & np.isfinite(t_s)
    frames = np.flatnonzero(usable)
    if len(frames) < 2:
        return _undecided("fewer than two frames with a pose and joint angles: there is no motion")
    if not (np.diff(t_s[frames]) > 0.0).all():
        return _undecided("the times do not increase from frame to frame")
    stride = -(-len(frames) // LONGEST)
    frames = np.unique(np.append(frames[::stride], frames[-1]))
    X = X_BG[frames].copy()
    X[:, :3, :3] = orthonormalize(X[:, :3, :3])
    course = Course(
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
    return _Search(course, tube_limit_m).run()


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


class _Search:
    """Everything known of one track while its tube is looked for."""

    def __init__(self, course: Course, tube_limit_m: float) -> None:
        self.course, self.tube_limit_m = course, tube_limit_m
        self.limits = course.limits
        self.programs = 0
        self.infeasible_m: float | None = None

    def run(self) -> TubeResult:
        """First the limits alone, then collisions, then torque: the first that forbids the tube is the cause."""
        fit, best = self._smallest()
        cause = None if best.radius_m <= self.tube_limit_m else self._broken_limit(fit)
        if best.radius_m > LARGEST_M:
            return self._result(None, cause)
        contact = broken_distance(self.course, best.worst_contact)
        clear = self._clear(best, _ROUNDS if cause is None else _FEWER_ROUNDS)
        if clear is None or clear.radius_m > self.tube_limit_m:
            cause = cause or contact
        if clear is None or clear.radius_m > LARGEST_M:
            return self._result(None, cause)
        torque = broken_torque(clear)
        light = self._light(clear)
        if light is None or light.radius_m > self.tube_limit_m:
            cause = cause or torque
        return self._result(light, cause)

    def _result(self, best: JointTrajectory | None, cause: TubeViolation | None) -> TubeResult:
        feasible = best is not None and best.radius_m <= self.tube_limit_m
        if best is None:
            size = f"no trajectory was found in a tube of up to {LARGEST_M:g} m"
        else:
            size = f"the tube needs {best.radius_m:.4g} m"
        why = cause or "the limits together forbid a narrower one, none of them alone"
        return TubeResult(
            radius_m=None if best is None else max(best.radius_m, SMALLEST_M),
            infeasible_radius_m=self.infeasible_m,
            feasible=feasible,
            certificate=None if best is None else best.check(),
            violation=None if feasible else cause,
            reason=None if feasible else f"{size}; {why}",
            programs=self.programs,
        )

    def _smallest(self) -> tuple[JointTrajectory, JointTrajectory]:
        """The spline through the joint path, and the trajectory of the smallest tube, collisions and torque aside."""
        course = self.course
        basis = SplineBasis.through(course.t_s)
        fit = JointTrajectory(course, basis, basis.fit(course.t_s, course.q))
        if fit.radius_m <= SMALLEST_M and fit.keeps_limits:
            return fit, fit
        best = self._shrink(basis, self._start, (), _FULL)
        if best is None:  # the program is beyond the solver's precision; standing still is always allowed
            middle = np.clip(course.q[len(course.q) // 2], course.limits.lower, course.limits.upper)
            return fit, JointTrajectory(course, basis, np.tile(middle, (basis.size, 1)))
        hopeless = self.infeasible_m is not None and self.infeasible_m > _HOPELESS * self.tube_limit_m
        if best.radius_m <= self.tube_limit_m or len(course.t_s) > _REFINED or hopeless:
            return fit, best
        finer = self._shrink(basis.refined(), best.q, (), _REFINED_EFFORT)
        return fit, best if finer is None or finer.radius_m > best.radius_m else finer

    @cached_property
    def _start(self) -> Array:
        """The joint path (T, 7) [rad]; from where it first passes a limit on, one within that follows the poses."""
        q, limits = self.course.q, self.limits
        outside = np.flatnonzero(((q < limits.lower) | (q > limits.upper)).any(axis=-1))
        if len(outside) == 0:
            return q
        q = np.clip(q, limits.lower, limits.upper)
        for i in range(int(outside[0]), len(q)):
            q[i], _ = newton(self.course.plant, self.course.X_BG[i], q[max(i - 1, 0)])
        return q

    def _shrink(
        self, basis: SplineBasis, q: Array, obstacles: tuple[Obstacle, ...], effort: tuple[int, int]
    ) -> JointTrajectory | None:
        """The smallest tube near the joint path `q` (T, 7): programs that leave the radius free, then bisection."""
        best: JointTrajectory | None = None
        proximity, looser, low = _PROXIMITY, _LOOSER, SMALLEST_M
        for _ in range(effort[0]):
            solution = self._solve(basis, q, None, proximity, obstacles)
            if solution is None:
                break
            low = max(solution.radius_m, SMALLEST_M)
            found = JointTrajectory(self.course, basis, solution.control)
            cost = proximity_cost_m(found.q, q, proximity)
            if best is not None and found.radius_m >= best.radius_m:
                proximity, looser = _TIGHTER * proximity, 1.0
            else:
                best = found
                proximity *= looser if found.radius_m <= RATIO * low else 1.0
            held = cost > low * (_HELD if best.radius_m <= self.tube_limit_m else _HELD_BEYOND)
            q = best.q
            if (best.radius_m <= RATIO * low and not held) or low > LARGEST_M:
                break
        if best is None:
            return None
        for _ in range(effort[1]):
            in_doubt = low < self.tube_limit_m < best.radius_m
            if low > LARGEST_M or (best.radius_m <= RATIO * low and not in_doubt):
                break
            middle = self.tube_limit_m if in_doubt else float(np.sqrt(low * best.radius_m))
            solution = self._solve(basis, best.q, _AIM * middle, proximity, obstacles)
            found = JointTrajectory(self.course, basis, solution.control) if solution else best
            if found.radius_m <= middle:
                best = found
            else:
                low = middle
        self.infeasible_m = low if SMALLEST_M < low < best.radius_m else None
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
            self.course.linearised(q),
            self.limits,
            radius_m=radius_m,
            proximity=proximity,
            obstacles=obstacles,
            elastic=elastic,
        )

    def _clear(self, trajectory: JointTrajectory, rounds: int) -> JointTrajectory | None:
        """The trajectory pushed out of collisions; None where that fails."""
        obstacles: list[Obstacle] = []
        for _ in range(rounds):
            contact = trajectory.worst_contact
            if contact is None or not contact.broken:
                return trajectory
            obstacles += trajectory.obstacles()
            moved = self._shrink(trajectory.basis, trajectory.q, tuple(obstacles), _ROUND_EFFORT)
            if moved is None or moved.radius_m > LARGEST_M:
                return None
            trajectory = moved
        contact = trajectory.worst_contact
        return None if contact is not None and contact.broken else trajectory

    def _light(self, trajectory: JointTrajectory) -> JointTrajectory | None:
        """The trajectory with its torques within limits, accelerating less if need be; None where that fails."""
        plant = self.course.plant
        for _ in range(_TIGHTENINGS):
            violation = broken_torque(trajectory)
            velocity, acceleration, jerk = self.limits.rates
            if violation is None:
                return trajectory
            q, _, a = trajectory.motion
            if acceleration is None:
                acceleration = np.full_like(velocity, np.abs(a).max())
            still = np.array([plant.torque(row, np.zeros_like(row), np.zeros_like(row)) for row in q])
            weight = float(np.abs(still / plant.effort_limits).max())
            if weight >= _TORQUE_AIM:
                return None
            # Torque beyond the weight is taken as proportional to acceleration.
            used = float(np.abs(a / acceleration).max())
            factor = used * (_TORQUE_AIM - weight) / (abs(violation.value) / violation.limit - weight)
            self.limits = replace(self.limits, rates=(velocity, factor * acceleration, jerk))
            obstacles = tuple(trajectory.obstacles())
            slower = self._shrink(trajectory.basis, trajectory.q, obstacles, _ROUND_EFFORT)
            if slower is None or slower.radius_m > LARGEST_M:
                return None
            if slower.worst_contact is not None and slower.worst_contact.broken:
                return None
            trajectory = slower
        return None if broken_torque(trajectory) else trajectory

    def _broken_limit(self, fit: JointTrajectory) -> TubeViolation | None:
        """Which limit forbids the tube.

        A posture's, if a pose is out of reach by far; else the rate that is exceeded where the least excess makes the
        tube wide enough; else, as no excess does, what is wrong with the joint path to start from or with its poses.
        """
        course, limit = self.course, self.tube_limit_m
        violation = broken_posture(course, limit, _SURELY)
        if violation is not None:
            return violation
        solution = self._solve(fit.basis, self._start, limit, _ELASTIC_PROXIMITY, (), elastic=True)
        return (
            broken_rate(course, fit.basis, solution)
            or broken_start(course)
            or steepest_rate(fit)
            or broken_posture(course, limit)
        )
