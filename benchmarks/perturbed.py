"""Random disturbances of trajectories, of unknown truth: an audit may not fail and must explain every null."""

from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from benchmarks.motion import Arm
from benchmarks.trajectory import Trajectory
from kinebench_drake.geometry import make_pose, rotation_exp

_Disturb: TypeAlias = Callable[[np.random.Generator, Arm, Trajectory], Trajectory]


def add_noise(rng: np.random.Generator, trajectory: Trajectory, position_m: float, rotation_rad: float) -> Trajectory:
    """Add white noise to the poses: standard deviations along each axis of B [m] and about each axis of G [rad]."""
    n = len(trajectory.t_s)
    X = trajectory.X_BG.copy()
    X[:, :3, 3] += position_m * rng.normal(size=(n, 3))
    X[:, :3, :3] = X[:, :3, :3] @ rotation_exp(rotation_rad * rng.normal(size=(n, 3)))
    return replace(trajectory, X_BG=X, q=None)


def perturb(rng: np.random.Generator, arm: Arm, good: Trajectory) -> tuple[Trajectory, list[str]]:
    """Apply one to three disturbances to a feasible trajectory; also return their names."""
    drawn = rng.choice(list(_DISTURBANCES), size=rng.integers(1, 4), replace=False)
    names = sorted((str(name) for name in drawn), key="joints".__eq__)  # last: it replaces the poses
    trajectory = replace(good, q=None)
    for name in names:
        trajectory = _DISTURBANCES[name](rng, arm, trajectory)
    return trajectory, names


def _noise(rng: np.random.Generator, arm: Arm, x: Trajectory) -> Trajectory:
    return add_noise(rng, x, rng.uniform(0.0, 0.02), np.deg2rad(rng.uniform(0.0, 10.0)))


def _jumps(rng: np.random.Generator, arm: Arm, x: Trajectory) -> Trajectory:
    X = x.X_BG.copy()
    for _ in range(rng.integers(1, 5)):
        first = int(rng.integers(len(X)))
        last = int(rng.integers(first, len(X)))
        X[first : last + 1, :3, 3] += rng.normal(0.0, 0.2, size=3)
        X[first : last + 1, :3, :3] = X[first : last + 1, :3, :3] @ rotation_exp(rng.normal(0.0, 0.8, size=3))
    return replace(x, X_BG=X)


def _clock(rng: np.random.Generator, arm: Arm, x: Trajectory) -> Trajectory:
    """Uneven time steps, and a scaled duration."""
    steps = np.diff(x.t_s) * np.exp(rng.normal(0.0, rng.uniform(0.0, 1.0), size=len(x.t_s) - 1))
    return replace(
        x, t_s=np.concatenate([[0.0], np.cumsum(steps)]) * np.exp(rng.uniform(-3.0, 3.0)) + rng.uniform(0, 5)
    )


def _scale(rng: np.random.Generator, arm: Arm, x: Trajectory) -> Trajectory:
    X = x.X_BG.copy()
    X[:, :3, 3] *= np.exp(rng.uniform(-2.0, 2.0))
    return replace(x, X_BG=X)


def _random(rng: np.random.Generator, arm: Arm, x: Trajectory) -> Trajectory:
    """Random poses in some or all frames."""
    n = len(x.t_s)
    poses = make_pose(rotation_exp(rng.normal(0.0, 2.0, size=(n, 3))), rng.uniform(-1.0, 1.0, size=(n, 3)))
    chosen = rng.random(n) < rng.choice([0.05, 0.5, 1.0])
    return replace(x, X_BG=np.where(chosen[:, None, None], poses, x.X_BG))


def _still(rng: np.random.Generator, arm: Arm, x: Trajectory) -> Trajectory:
    """Constant or nearly constant poses."""
    X = np.repeat(x.X_BG[:1], len(x.t_s), axis=0)
    size = float(rng.choice([0.0, 1e-9, 1e-6, 1e-4]))
    return add_noise(rng, replace(x, X_BG=X), size, size)


def _short(rng: np.random.Generator, arm: Arm, x: Trajectory) -> Trajectory:
    n = int(rng.integers(2, 9))
    return _frames(x, np.arange(min(n, len(x.t_s))))


def _long(rng: np.random.Generator, arm: Arm, x: Trajectory) -> Trajectory:
    """400 frames, forwards and backwards in turn."""
    n = len(x.t_s)
    order = np.abs((np.arange(400) + n - 1) % max(2 * n - 2, 1) - (n - 1))
    t_s = np.asarray(np.median(np.diff(x.t_s)) * np.arange(400), dtype=np.float64)
    return replace(_frames(x, order), t_s=t_s)


def _frames(x: Trajectory, index: NDArray[np.intp]) -> Trajectory:
    return replace(
        x,
        t_s=x.t_s[index],
        X_BG=x.X_BG[index],
        finger_width_m=x.finger_width_m[index],
        tracked=None if x.tracked is None else x.tracked[index],
    )


def _gaps(rng: np.random.Generator, arm: Arm, x: Trajectory) -> Trajectory:
    """Frames without a pose: single ones, runs, or all."""
    n = len(x.t_s)
    tracked = rng.random(n) > rng.choice([0.0, 0.1, 0.5, 0.95])
    first = int(rng.integers(n))
    tracked[first : first + int(rng.integers(0, n))] = False
    if rng.random() < 0.03:
        tracked[:] = False
    return replace(x, X_BG=np.where(tracked[:, None, None], x.X_BG, np.nan), tracked=tracked)


def _fingers(rng: np.random.Generator, arm: Arm, x: Trajectory) -> Trajectory:
    """Random or unknown finger widths."""
    n = len(x.t_s)
    return replace(x, finger_width_m=np.where(rng.random(n) < 0.5, np.nan, rng.uniform(0.0, 0.08, size=n)))


def _joints(rng: np.random.Generator, arm: Arm, x: Trajectory) -> Trajectory:
    """Joint angles: a random walk, or random values within limits or past them."""
    n = len(x.t_s)
    plant = arm.plant
    walk = plant.robot.rest_q + np.cumsum(rng.normal(0.0, rng.choice([0.001, 0.05, 0.5]), size=(n, 7)), axis=0)
    q = walk if rng.random() < 0.7 else rng.uniform(1.2 * plant.lower, 1.2 * plant.upper, size=(n, 7))
    return Trajectory(t_s=x.t_s, X_BG=arm.body.forward(q), finger_width_m=x.finger_width_m, q=q)


_DISTURBANCES: dict[str, _Disturb] = {
    "noise": _noise,
    "jumps": _jumps,
    "clock": _clock,
    "scale": _scale,
    "random": _random,
    "still": _still,
    "short": _short,
    "long": _long,
    "gaps": _gaps,
    "fingers": _fingers,
    "joints": _joints,
}
