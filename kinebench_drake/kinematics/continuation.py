"""Joint paths along a track of poses that continue from a known posture, such as the one in which the robot stands."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.ik import IkSolution, solve_pose
from kinebench_drake.kinematics.newton import solve_newton_path
from kinebench_drake.kinematics.path import find_cheapest_path, is_sound, relax, select_anchors, within_limits
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.postures import posture_solver
from kinebench_drake.track import IkStatus

ANCHORS_S = (0.8, 0.4)
"""Least time between poses of the search: on the branch of the start, then on all branches [s]."""
SPACING_RAD = 0.3
"""Spacing of the redundancy's angles [rad]."""


def minimum_jerk(s: Array) -> Array:
    """Return the fraction of the way (...) at fraction `s` (...) of the time, 0 before and 1 after.

    The minimum-jerk profile of Flash and Hogan (1985, eq. 3): 10 s^3 - 15 s^4 + 6 s^5.
    """
    s = np.clip(np.asarray(s, dtype=np.float64), 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def solve_stepwise(plant: ArmPlant, X_BG: Array, q_start: Array) -> tuple[Array, IkSolution | None]:
    """Solve the poses (N, 4, 4) one after the other, each near the posture before.

    Returns:
        The joint path (N, J) [rad] up to the first pose that is not reached, NaN from there on, and the solution of
        that pose; None if all poses are reached.
    """
    q = np.full((len(X_BG), len(q_start)), np.nan)
    seed = q_start
    for i, X in enumerate(X_BG):
        solution = solve_pose(plant, X, seed)
        if solution.status is not IkStatus.OK:
            return q, solution
        q[i] = seed = solution.q
    return q, None


def plan_continuation(plant: ArmPlant, t_s: Array, X_BG: Array, q_start: Array) -> Array:
    """Plan a joint path (N, J) [rad] at times `t_s` (N,) [s] that moves the elbow ahead of later poses; NaN if none.

    The path of `continue_path` may begin with another elbow angle than the start's; the difference at t = 0 is faded
    out by `blend_from_start`.
    """
    return blend_from_start(plant, t_s, X_BG, continue_path(plant, t_s, X_BG, q_start), q_start)


def blend_from_start(plant: ArmPlant, t_s: Array, X_BG: Array, q: Array, q_start: Array) -> Array:
    """Return the path `q` (N, J) [rad] changed to begin at `q_start` (J,), the elbow moving to the path in 2 s."""
    return posture_solver(plant).nearest(X_BG, q + (1.0 - minimum_jerk(t_s / 2.0))[:, None] * (q_start - q[0]))


def continue_path(plant: ArmPlant, t_s: Array, X_BG: Array, q_start: Array) -> Array:
    """Search a path (T, J) [rad] that continues from a posture near the first pose: faster than `search_path`.

    Dynamic programming chooses postures of few frames (anchors), first on the start's branch, then on all. A cubic
    spline through them is projected onto the poses and, if needed, relaxed. All NaN if the result passes a limit or has
    a step that is too fast: then `search_path` may find a path. Arguments as for `search_path`.
    """
    for path in _candidates(plant, t_s, X_BG, q_start):
        if is_sound(plant, t_s, path):
            return path
    return np.full((len(t_s), len(q_start)), np.nan)


def _candidates(plant: ArmPlant, t_s: Array, X_BG: Array, q_start: Array) -> Iterator[Array]:
    """Yield paths (T, J), which may pass limits, the ones that cost least time first. Arguments as `continue_path`."""
    solver = posture_solver(plant)
    anchors = _spread_anchors(tuple(t_s), ANCHORS_S[0])
    guess = _interpolate_layers(plant, t_s, anchors, solver.along_branch(X_BG[anchors.frames], q_start), q_start)
    if guess is not None:
        yield solver.nearest(X_BG, guess)
        # Where the redundancy's angle leaves the branch, Newton steps may still follow the poses.
        yield solve_newton_path(plant, X_BG, guess)
    anchors = _spread_anchors(tuple(t_s), ANCHORS_S[1])
    layers = solver.all(X_BG[anchors.frames], 24)  # angles of the redundancy over a full turn
    layers[0] = solver.nearest(X_BG[:1], q_start[None])
    guess = _interpolate_layers(plant, t_s, anchors, layers, q_start)
    if guess is not None:
        yield solver.nearest(X_BG, guess)
        path = solve_newton_path(plant, X_BG, guess)
        yield path
        yield relax(plant, t_s, X_BG, path)


@dataclass(frozen=True, slots=True)
class _Anchors:
    """Frames whose postures are searched, and the path through them."""

    frames: NDArray[np.intp]
    """(A,)."""
    weights: Array
    """(T, A) of the anchors' postures in those of all frames: smoothed, then interpolated by a cubic spline."""


@lru_cache(maxsize=16)
def _spread_anchors(times: tuple[float, ...], spacing_s: float) -> _Anchors:
    """Select anchors at least `spacing_s` apart among `times` (T,) [s]: tracks often have the same."""
    t_s = np.array(times)
    frames = select_anchors(t_s, spacing_s)
    weights = np.eye(len(frames))
    for _ in range(2):  # the kernel (1, 2, 1) / 4 removes the steps of the grid
        weights[1:-1] = 0.25 * weights[:-2] + 0.5 * weights[1:-1] + 0.25 * weights[2:]
    if len(frames) > 1:
        weights = make_interp_spline(t_s[frames], weights, k=min(3, len(frames) - 1))(t_s)
    return _Anchors(frames, weights)


def _interpolate_layers(
    plant: ArmPlant, t_s: Array, anchors: _Anchors, layers: list[Array], q_start: Array
) -> Array | None:
    """Return the path (T, J) near the cheapest of `layers`, the postures of the anchors; None if an anchor has none."""
    path = find_cheapest_path(plant, t_s[anchors.frames], within_limits(plant, layers), q_start, SPACING_RAD)
    return anchors.weights @ path if len(path) > 1 and np.isfinite(path).all() else None
