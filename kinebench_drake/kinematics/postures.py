"""Solvers for the postures that reach a pose: all of them, their null direction, the nearest one.

Closed form for arms with the Panda's chain, Newton steps from many starts for any other arm.
"""

from functools import lru_cache
from typing import Protocol

import numpy as np
from scipy.optimize import minimize
from typing_extensions import override

from kinebench_drake.geometry import Array, invert, pose_difference
from kinebench_drake.kinematics.analytic import N_BRANCHES, analytic_ik, branch_of, flange_pose, reach_window
from kinebench_drake.kinematics.newton import ROWS_STEPS, solve_newton_rows
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.robot import N_JOINTS

_STARTS = 64  # starts of the numeric search for the first pose of a track
_COARSE = 36  # greatest number of samples for which new starts are not tried for every pose,
_EVERY = 8  # but for one of these, and where a posture of the pose before is lost
_NEAR_STEPS = 8  # from a posture of the pose before
_EXACT_RAD = 1e-6
_FREE_TURN_RAD = 0.3  # of five joints: greater turns than those by which smoothing changes a pose are another posture's
FAR_RAD = 0.15
"""Distance of the ends of an interval of the grid above which it is halved [rad]."""
DUPLICATE_RAD = 0.05
"""Distance of postures of the numeric search below which they are duplicates [rad]."""


class PostureSolver(Protocol):
    """Solver for the postures of an arm that reach given poses."""

    def all(self, X_BG: Array, samples: int, rounds: int = 0) -> list[Array]:
        """Return for each pose (T, 4, 4) postures (N_t, J) [rad] on a grid of the redundancy, joint limits ignored.

        Intervals of the grid are halved up to `rounds` times where their ends are far apart, as near singularities.
        """

    def around(self, X_BG: Array, q: Array, offsets: Array) -> list[Array]:
        """Return for each pose the postures (N_t, J) [rad] of all branches near guesses `q` (T, J), limits ignored."""

    def along_branch(self, X_BG: Array, q_start: Array) -> list[Array]:
        """Return for each pose postures (N_t, J) [rad] of the branch of `q_start` (J,).

        The postures are on a coarse grid of the redundancy about that of `q_start`, NaN where there is none; no rows
        where branches are unknown.
        """

    def direction(self, X_BG: Array, q: Array) -> Array:
        """Return unit vectors (T, J) of the null motion of postures `q` (T, J); 0 where unknown."""

    def nearest(self, X_BG: Array, q: Array) -> Array:
        """Return postures (T, J) [rad] that reach poses (T, 4, 4) near guesses `q` (T, J); NaN where there is none."""

    def out_of_reach_m(self, X_BG: Array) -> Array:
        """Return the distance (T,) [m] by which poses (T, 4, 4) are provably out of reach; 0 if not proven."""


@lru_cache(maxsize=4)
def posture_solver(plant: ArmPlant) -> PostureSolver:
    """Return the closed-form solver if the arm equals the Panda up to its tool (numerically), else Newton's."""
    if len(plant.lower) == N_JOINTS:
        q = np.random.default_rng(0).uniform(plant.lower, plant.upper, size=(8, N_JOINTS))
        X_FG = invert(flange_pose(q)) @ plant.forward_path(q)
        if np.abs(X_FG - X_FG[0]).max() < 1e-9:
            return ClosedFormSolver(X_FG[0])
    return NumericSolver(plant)


class ClosedFormSolver(PostureSolver):
    """Closed-form solver for a Panda with any tool; joint 7 is the redundancy."""

    def __init__(self, X_FG: Array) -> None:
        """Set the tool: pose (4, 4) of the TCP in the flange (panda_link8) [m]."""
        self._X_GF = invert(X_FG)

    @override
    def all(self, X_BG: Array, samples: int, rounds: int = 0) -> list[Array]:
        X_BF = X_BG @ self._X_GF
        q7 = np.linspace(-np.pi, np.pi, samples + 1)
        q = analytic_ik(X_BF[:, None], q7)
        layers = [_listed(row) for row in q]
        if rounds:  # a stretched arm reaches the pose at few angles, which the grid may miss
            centre, half_width, _ = reach_window(X_BF)
            q7_near = centre[:, None] + half_width[:, None] * np.linspace(-0.98, 0.98, 9)
            near = analytic_ik(X_BF[:, None], (q7_near + np.pi) % (2 * np.pi) - np.pi)
            layers = [np.vstack([layer, _listed(row)]) for layer, row in zip(layers, near, strict=True)]
        frame = np.repeat(np.arange(len(X_BG)), samples)
        low = np.tile(q7[:-1], len(X_BG))
        high = np.tile(q7[1:], len(X_BG))
        q_low = q[:, :-1].reshape(-1, N_BRANCHES, 7)
        q_high = q[:, 1:].reshape(-1, N_BRANCHES, 7)
        for _ in range(rounds):
            finite = np.isfinite(q_low[..., 0]), np.isfinite(q_high[..., 0])
            with np.errstate(invalid="ignore"):
                far = np.abs(q_high - q_low)[..., :6].max(axis=-1) > FAR_RAD
            split = ((finite[0] & finite[1] & far) | (finite[0] ^ finite[1])).any(axis=-1)
            if not split.any():
                break
            frame, low, high, q_low, q_high = (a[split] for a in (frame, low, high, q_low, q_high))
            middle = 0.5 * (low + high)
            q_middle = analytic_ik(X_BF[frame], middle)
            for i in np.unique(frame):
                layers[i] = np.vstack([layers[i], _listed(q_middle[frame == i])])
            frame = np.concatenate([frame, frame])
            low = np.concatenate([low, middle])
            high = np.concatenate([middle, high])
            q_low = np.concatenate([q_low, q_middle])
            q_high = np.concatenate([q_middle, q_high])
        return layers

    @override
    def around(self, X_BG: Array, q: Array, offsets: Array) -> list[Array]:
        return [_listed(q) for q in analytic_ik((X_BG @ self._X_GF)[:, None], q[:, 6, None] + offsets)]

    @override
    def along_branch(self, X_BG: Array, q_start: Array) -> list[Array]:
        q7 = q_start[6] + 0.3 * np.arange(-9, 10)
        return list(analytic_ik((X_BG @ self._X_GF)[:, None], q7)[:, :, branch_of(q_start)])

    @override
    def direction(self, X_BG: Array, q: Array) -> Array:
        probe = q.copy()
        probe[:, 6] += 1e-5  # step of joint 7 in the finite difference of the closed form
        step = self.nearest(X_BG, probe) - q
        size = np.linalg.norm(step, axis=-1, keepdims=True)
        usable = np.isfinite(size) & (size < 0.1) & (size > 0.0)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(usable, step / size, 0.0)

    @override
    def nearest(self, X_BG: Array, q: Array) -> Array:
        branches = analytic_ik(X_BG @ self._X_GF, q[:, 6])
        distance = np.abs(branches - q[:, None]).max(axis=-1)
        best = np.argmin(np.where(np.isfinite(distance), distance, np.inf), axis=-1)
        return np.asarray(branches[np.arange(len(q)), best])

    @override
    def out_of_reach_m(self, X_BG: Array) -> Array:
        return reach_window(X_BG @ self._X_GF)[2]


class NumericSolver(PostureSolver):
    """Solver for any arm: Newton steps from many starts, and from the postures of the pose before."""

    def __init__(self, plant: ArmPlant) -> None:
        self._plant = plant
        self._starts = spread_postures(plant, _STARTS)
        self._middle = 0.5 * (plant.lower + plant.upper)
        self._shoulder, self._reach_m = _reach(plant)

    @override
    def all(self, X_BG: Array, samples: int, rounds: int = 0) -> list[Array]:
        layers: list[Array] = []
        beyond = self.out_of_reach_m(X_BG) > 0.0
        before = self._starts[:0]
        is_redundant = before.shape[1] > 6  # its postures may be moved into the limits
        free_rad = _FREE_TURN_RAD
        for X, is_beyond in zip(X_BG, beyond, strict=True):
            if is_beyond:
                before = self._starts[:0]
                layers.append(before)
                continue
            near = self._solve(X, before, free_rad, bounded=is_redundant, iterations=_NEAR_STEPS)
            is_sure = len(near) == len(before) > 0 and samples <= _COARSE
            count = 0 if is_sure and len(layers) % _EVERY else max(8, samples // 4)
            fresh = self._solve(X, self._starts[: count if layers else _STARTS], free_rad, bounded=is_redundant)
            if not layers and len(fresh) and self._turns(X, fresh).max() <= _EXACT_RAD:  # so are the other poses
                free_rad = _EXACT_RAD
            postures: list[Array] = []
            for row in _listed(np.vstack([near, self._wrapped(fresh)])):
                if all(np.abs(row - other).max() > DUPLICATE_RAD for other in postures):
                    postures.append(row)
            layers.append(np.reshape(postures, (-1, before.shape[1])))
            past = np.maximum(self._plant.lower - layers[-1], layers[-1] - self._plant.upper).max(axis=-1, initial=0.0)
            before = layers[-1][past <= DUPLICATE_RAD]
        return layers

    def _turns(self, X: Array, q: Array) -> Array:
        """Return the angles (N,) [rad] between a pose (4, 4) and those at postures (N, J)."""
        return pose_difference(self._plant.chain.poses(q, self._plant.robot.tcp_link), X)[1]

    def _solve(self, X: Array, q: Array, free_rad: float, *, bounded: bool, iterations: int = ROWS_STEPS) -> Array:
        """Return the postures (M, J) that reach the pose (4, 4) from `q` (N, J).

        Of five joints those up to a free turn of `free_rad`, but where some reach the whole pose these alone.
        """
        poses = np.broadcast_to(X, (len(q), 4, 4))
        q = _listed(solve_newton_rows(self._plant, poses, q, bounded=bounded, iterations=iterations))
        if q.shape[1] > 5 or not len(q):
            return q
        turn = self._turns(X, q)
        return np.asarray(q[turn <= (_EXACT_RAD if turn.min() <= _EXACT_RAD else free_rad)])

    def _wrapped(self, q: Array) -> Array:
        """Return postures (N, J) with each angle within half a turn of the middle of its limits."""
        turned = self._middle + (q - self._middle + np.pi) % (2.0 * np.pi) - np.pi
        return np.where(self._plant.chain.turns, turned, q)

    @override
    def around(self, X_BG: Array, q: Array, offsets: Array) -> list[Array]:
        return [row[None][np.isfinite(row[:1])] for row in self.nearest(X_BG, q)]

    @override
    def along_branch(self, X_BG: Array, q_start: Array) -> list[Array]:
        return [self._starts[:0]] * len(X_BG)

    @override
    def direction(self, X_BG: Array, q: Array) -> Array:
        # the last right singular vector of the Jacobian
        return np.asarray(np.linalg.svd(self._plant.chain.jacobians(q))[2][:, -1])

    @override
    def nearest(self, X_BG: Array, q: Array) -> Array:
        return solve_newton_rows(self._plant, X_BG, q)

    @override
    def out_of_reach_m(self, X_BG: Array) -> Array:
        beyond = np.linalg.norm(X_BG[:, :3, 3] - self._shoulder, axis=-1) - self._reach_m
        return np.asarray(np.maximum(beyond, 0.0))


def _reach(plant: ArmPlant) -> tuple[Array, float]:
    """Return a point (3,) of the first axis in B, and a bound of the TCP's distance from it [m]; inf if a joint slides.

    Points on successive axes keep their distances in all postures: their polyline is made as short as possible.
    """
    chain = plant.chain
    tcp = chain.home[plant.robot.tcp_link][:3, 3]
    axes, points = (of_all[0] for of_all in chain.axes(chain.motions(np.zeros((1, chain.n_joints)))))

    def length(along: Array) -> float:
        ends = np.vstack([points + along[:, None] * axes, tcp])
        return float(np.linalg.norm(np.diff(ends, axis=0), axis=-1).sum())

    best = np.asarray(minimize(length, np.zeros(chain.n_joints), method="Powell").x)
    return points[0] + best[0] * axes[0], length(best) if chain.turns.all() else np.inf


def spread_postures(plant: ArmPlant, count: int) -> Array:
    """Return a fixed random sample (count, J) [rad] of postures within limits, the rest posture first.

    Angles are within half a turn of the middle of their limits.
    """
    middle = 0.5 * (plant.lower + plant.upper)
    low = np.maximum(plant.lower, middle - np.pi)
    high = np.minimum(plant.upper, middle + np.pi)
    spread = np.random.default_rng(0).uniform(low, high, size=(count - 1, len(low)))
    return np.vstack([plant.robot.rest_q, spread])


def _listed(q: Array) -> Array:
    """Return the finite rows (N, J) of postures (..., J)."""
    q = q.reshape(-1, q.shape[-1])
    return q[np.isfinite(q[:, 0])]
