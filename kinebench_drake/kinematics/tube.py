"""Convex program for a joint trajectory within a tube of poses and within all limits; poses and distances linearised.

Drake's KinematicTrajectoryOptimization provides the program, its B-spline and the variables. With fixed duration,
bounds on derivatives are linear in the control points, and a tube of radius r about a pose is a second-order cone.
Solver: P. Goulart and Y. Chen, "Clarabel: An interior-point solver for conic programs with quadratic objectives", 2024.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.math import BsplineBasis
from pydrake.planning import KinematicTrajectoryOptimization
from pydrake.solvers import ClarabelSolver
from pydrake.trajectories import BsplineTrajectory
from scipy.sparse import coo_matrix, diags, hstack, identity, kron, vstack

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.spline import ORDER, SplineBasis
from kinebench_drake.models.drake_log import silent_drake

INSIDE = 1.0 - 1e-6
"""Share of each limit that the program may use; the rest covers the tolerance of the solver."""
WIDENING_COST = 100.0
"""Cost of a millimetre by which the tube of an elastic program is widened."""
ASSUMED_ACCELERATION = 10.0
"""Acceleration limit in the cost where none is published [rad/s^2]."""
ACCELERATION_COST = 1e-3
"""Cost of accelerations at their limits throughout, in millimetres of radius."""

_MM = 1000.0  # radii and slacks are in millimetres within the program, so that costs are of the order of one
_FRAMES = 49.0  # frames of a typical clip, to which costs summed over frames are normalised
_STEP_RAD = 0.1  # change of all joints that costs as much as `proximity` millimetres of radius


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitSet:
    """Limits of the arm, (J,) each."""

    lower: Array
    """Lower joint limits [rad]."""
    upper: Array
    """Upper joint limits [rad]."""
    rates: tuple[Array | None, Array | None, Array | None]
    """Limits of speed [rad/s], acceleration [rad/s^2] and jerk [rad/s^3]; None where there is none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseLinearisation:
    """Pose errors linearised about a joint path: moving the joints by dq leaves the error e - J dq."""

    t_s: Array
    """(T,) times of the frames on the clock of the spline [s]."""
    q: Array
    """(T, J) joint path [rad]."""
    J: Array
    """(T, 6, J) Jacobians, the rows of rotation multiplied by their arm [m/rad]."""
    e: Array
    """(T, 6) errors of the poses, rotation (by its arm) and position [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DistanceBound:
    """Linearised lower bound of a distance."""

    t_s: float
    """Time [s]."""
    offset_m: float
    """Distance of the linearisation at zero joint angles [m]."""
    gradient: Array
    """(J,) gradient of the distance [m/rad]."""
    least_m: float
    """Lower bound [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TubeSolution:
    """Solution of the program."""

    control: Array
    """(n, J) control points [rad]."""
    radius_m: float
    """Radius of the linearised tube [m]."""
    excess: tuple[Array, ...]
    """Excess (n - k, J) / limit of the control points of the k-th derivative, k = 1..3."""


def solve_tube(
    basis: SplineBasis,
    poses: PoseLinearisation,
    limits: LimitSet,
    radius_m: float | None,
    proximity: float,
    obstacles: Sequence[DistanceBound] = (),
    *,
    elastic: bool = False,
) -> TubeSolution | None:
    """Solve the trajectory that is in the tube at the frames and within limits at all times; None if there is none.

    Args:
        limits: limits, applied to the control points (slightly stricter than on the curve, see `spline`).
        radius_m: radius of the tube [m]; None minimises it.
        proximity: weight of the distance from the path of the linearisation: millimetres of radius that outweigh a
            common change of all joints by 0.1 rad.
        obstacles: distances to keep; violating one costs 20 times its depth in radius.
        elastic: True to let derivatives exceed their limits: the sum of relative excesses is minimised (the tube is
            widened too, but only where no excess helps).
    """
    n = basis.size
    joints = len(limits.lower)
    frames = len(poses.t_s)
    still: Any = np.zeros((joints, n))
    spline: Any = BsplineTrajectory(BsplineBasis(ORDER, basis.knots.tolist()), still)
    kto: Any = KinematicTrajectoryOptimization(spline)
    prog = kto.get_mutable_prog()
    duration = float(basis.breaks_s[-1] - basis.breaks_s[0])
    prog.AddBoundingBoxConstraint(duration, duration, kto.duration())
    x = kto.control_points().T.ravel()  # of (n, J)
    r = prog.NewContinuousVariables(1, "r")
    lower, upper = (np.tile(bound, n) for bound in (limits.lower, limits.upper))
    prog.AddBoundingBoxConstraint(lower, upper, x)
    if radius_m is None:
        prog.AddLinearCost(np.ones(1), r)
    elif elastic:
        prog.AddBoundingBoxConstraint(_MM * radius_m, np.inf, r)
        prog.AddLinearCost(np.full(1, WIDENING_COST), r)
    else:
        prog.AddBoundingBoxConstraint(0.0, _MM * radius_m, r)

    rows = []
    sizes = []
    for D, limit in zip(basis.derivatives[1:], limits.rates, strict=True):
        sizes.append(D.shape[0] if limit is not None else 0)
        if limit is not None:
            rows.append(diags(np.tile(1.0 / limit, D.shape[0])) @ kron(D, identity(joints)))
    A = vstack(rows).tocsc()
    one = np.ones(A.shape[0])
    slack = None
    if elastic:
        slack = prog.NewContinuousVariables(A.shape[0], "excess")
        prog.AddBoundingBoxConstraint(0.0, np.inf, slack)
        prog.AddLinearCost(10.0 * one, slack)  # cost of one control point that exceeds a limit by the limit itself
        both = vstack([hstack([A, -identity(len(one))]), hstack([-A, -identity(len(one))])]).tocsc()
        prog.AddLinearConstraint(
            both, np.full(2 * len(one), -np.inf), np.full(2 * len(one), INSIDE), np.concatenate([x, slack])
        )
    else:
        prog.AddLinearConstraint(A, -INSIDE * one, INSIDE * one, x)

    B = basis.values(poses.t_s)
    for i in range(frames):
        near, values = _row(B, i, x.reshape(n, joints))
        variables = np.concatenate([r, near])
        target = _MM * (poses.J[i] @ poses.q[i] + poses.e[i])
        for part in (slice(0, 3), slice(3, 6)):
            M = np.zeros((4, len(variables)))
            M[0, 0] = 1.0
            M[1:, 1:] = _MM * np.kron(values, poses.J[i, part])
            prog.AddLorentzConeConstraint(M, np.concatenate([[0.0], -target[part]]), variables)
        # proximity |B C - q|^2
        weight = 2.0 * proximity / (_STEP_RAD**2 * _FRAMES)
        Q = weight * np.kron(np.outer(values, values), np.eye(joints))
        prog.AddQuadraticCost(Q, -weight * np.kron(values, poses.q[i]), near, is_convex=True)
    scale = ASSUMED_ACCELERATION if limits.rates[1] is None else limits.rates[1]
    D = basis.derivatives[2]
    for k in range(D.shape[0]):
        near, values = _row(D, k, x.reshape(n, joints))
        Q = 2.0 * ACCELERATION_COST / _FRAMES * np.kron(np.outer(values, values), np.diag(np.ones(joints) / scale**2))
        prog.AddQuadraticCost(Q, np.zeros(len(near)), near, is_convex=True)
    if obstacles:
        _add_obstacles(prog, basis, x, obstacles)

    with silent_drake():
        result = ClarabelSolver().Solve(prog, None, None)
    if not result.is_success():
        return None
    excess = np.maximum(result.GetSolution(slack), 0.0) if slack is not None else np.zeros(A.shape[0])
    parts = np.split(excess.reshape(-1, joints), np.cumsum(sizes)[:-1])
    control = np.clip(result.GetSolution(x), lower, upper).reshape(n, joints)
    return TubeSolution(control=control, radius_m=float(result.GetSolution(r)[0]) / _MM, excess=tuple(parts))


def proximity_cost_m(q: Array, q_near: Array, proximity: float) -> float:
    """Return the proximity cost [m of radius] of a joint path `q` (T, J) [rad] about `q_near` (T, J)."""
    return proximity / _MM * float(np.sum((q - q_near) ** 2)) / (_STEP_RAD**2 * _FRAMES)


def _row(matrix: Any, i: int, x: Any) -> tuple[Any, Array]:
    """Return the control points of `x` (n, J) within the band of row i of a sparse matrix, and its values there."""
    span = slice(matrix.indptr[i], matrix.indptr[i + 1])
    columns = matrix.indices[span]
    first = int(columns.min())
    values = np.zeros(int(columns.max()) - first + 1)
    values[columns - first] = matrix.data[span]
    return x[first : first + len(values)].ravel(), values


def _add_obstacles(prog: Any, basis: SplineBasis, x: Any, obstacles: Sequence[DistanceBound]) -> None:
    """Add the linearised distances to the program, each with its own slack."""
    count = len(obstacles)
    B = basis.values(np.array([o.t_s for o in obstacles])).tocoo()
    gradients = np.array([o.gradient for o in obstacles])
    joints = gradients.shape[1]
    rows = np.repeat(B.row, joints)
    columns = (joints * B.col[:, None] + np.arange(joints)).ravel()
    A = coo_matrix(((B.data[:, None] * gradients[B.row]).ravel() * _MM, (rows, columns)), shape=(count, len(x)))
    slack = prog.NewContinuousVariables(count, "penetration")
    prog.AddBoundingBoxConstraint(0.0, np.inf, slack)
    prog.AddLinearCost(20.0 * np.ones(count), slack)  # cost of a millimetre of penetration, in millimetres of radius
    least = _MM * np.array([o.least_m - o.offset_m for o in obstacles])
    prog.AddLinearConstraint(
        hstack([A, identity(count)]).tocsc(), least, np.full(count, np.inf), np.concatenate([x, slack])
    )
