"""The postures that reach a pose: all of them, the direction in which they continue, the nearest one.

Two ways: the closed form where the arm is built like a Panda, Newton steps from many starts for any other arm.
"""

from typing import Protocol

import numpy as np

from kinebench_drake.geometry import Array, invert
from kinebench_drake.kinematics.analytic import N_BRANCHES, analytic_ik, flange_pose, reach_window
from kinebench_drake.kinematics.newton import REACHED_M, newton
from kinebench_drake.kinematics.plant import ArmPlant

_PROBE_RAD = 1e-5  # change of joint 7 by which the closed form is differentiated
_FAR_RAD = 0.15  # neighbours of the grid farther apart than this have further postures put between them
_WINDOW = np.linspace(-0.98, 0.98, 9)  # where in the window of reach postures are looked for besides the grid
_BRANCH_RAD = 0.3 * np.arange(-9, 10)  # about the start's joint 7, along its branch
_SAME_RAD = 0.05  # postures of the numeric search closer than this are one
_STARTS = 24  # starts of the numeric search


class Postures(Protocol):
    """How the postures of an arm are found."""

    def all(self, X_BG: Array, samples: int, rounds: int = 0) -> list[Array]:
        """Of each pose (T, 4, 4) postures (N_t, 7) [rad] on a grid of its redundancy, joint limits ignored.

        The grid is halved up to `rounds` times where neighbouring postures are far apart, as near singularities.
        """
        ...

    def around(self, X_BG: Array, q: Array, offsets: Array) -> list[Array]:
        """Of each pose the postures (N_t, 7) [rad] of all branches near guesses `q` (T, 7), joint limits ignored."""
        ...

    def along_branch(self, X_BG: Array, q_start: Array) -> list[Array]:
        """Of each pose postures (N_t, 7) [rad] of the branch that `q_start` (7,) is nearest to at the first pose.

        On a coarse grid of the redundancy about that of `q_start`; none where branches are not known.
        """
        ...

    def direction(self, X_BG: Array, q: Array) -> Array:
        """Unit vectors (T, 7) along which postures `q` (T, 7) can move at rest of the TCP; 0 where not known."""
        ...

    def nearest(self, X_BG: Array, q: Array) -> Array:
        """Postures (T, 7) [rad] that reach poses (T, 4, 4) near guesses `q` (T, 7); NaN where there is none."""
        ...

    def out_of_reach_m(self, X_BG: Array) -> Array:
        """How far (T,) [m] poses (T, 4, 4) are, provably, out of reach whatever the joint limits; 0 if unproven."""
        ...


def find_postures(plant: ArmPlant) -> Postures:
    """The closed form if the arm's chain is the Panda's up to its tool, found by comparing numbers, else Newton."""
    rng = np.random.default_rng(0)
    q = rng.uniform(plant.lower, plant.upper, size=(8, 7))
    X_FG = invert(flange_pose(q)) @ np.array([plant.forward(row) for row in q])
    if np.abs(X_FG - X_FG[0]).max() < 1e-9:
        return ClosedForm(X_FG[0])
    return Numeric(plant)


class ClosedForm:
    """Postures of a Panda with any tool, joint 7 being the redundancy."""

    def __init__(self, X_FG: Array) -> None:
        """Take the tool: pose (4, 4) of the TCP in the flange (panda_link8) [m]."""
        self._X_GF = invert(X_FG)

    def all(self, X_BG: Array, samples: int, rounds: int = 0) -> list[Array]:
        """Postures on `samples` angles of joint 7 over a full turn, and on more where they lie far apart."""
        X_BF = X_BG @ self._X_GF
        q7 = np.linspace(-np.pi, np.pi, samples + 1)
        q = analytic_ik(X_BF[:, None], q7)
        layers = [_listed(row) for row in q]
        if rounds:  # a stretched arm reaches the pose at few angles, which a grid may miss
            centre, half_width, _ = reach_window(X_BF)
            q7_near = centre[:, None] + half_width[:, None] * _WINDOW
            near = analytic_ik(X_BF[:, None], (q7_near + np.pi) % (2 * np.pi) - np.pi)
            layers = [np.vstack([layer, _listed(row)]) for layer, row in zip(layers, near, strict=True)]
        frame = np.repeat(np.arange(len(X_BG)), samples)
        low, high = np.tile(q7[:-1], len(X_BG)), np.tile(q7[1:], len(X_BG))
        q_low, q_high = q[:, :-1].reshape(-1, N_BRANCHES, 7), q[:, 1:].reshape(-1, N_BRANCHES, 7)
        for _ in range(rounds):
            known = np.isfinite(q_low[..., 0]), np.isfinite(q_high[..., 0])
            with np.errstate(invalid="ignore"):
                far = np.abs(q_high - q_low)[..., :6].max(axis=-1) > _FAR_RAD
            split = ((known[0] & known[1] & far) | (known[0] ^ known[1])).any(axis=-1)
            if not split.any():
                break
            frame, low, high, q_low, q_high = (a[split] for a in (frame, low, high, q_low, q_high))
            middle = 0.5 * (low + high)
            q_middle = analytic_ik(X_BF[frame], middle)
            for i in np.unique(frame):
                layers[i] = np.vstack([layers[i], _listed(q_middle[frame == i])])
            frame = np.concatenate([frame, frame])
            low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
            q_low, q_high = np.concatenate([q_low, q_middle]), np.concatenate([q_middle, q_high])
        return layers

    def around(self, X_BG: Array, q: Array, offsets: Array) -> list[Array]:
        """Postures at the guesses' joint-7 angles plus each of `offsets` (K,) [rad]."""
        q7 = q[:, 6, None] + offsets
        return [_listed(q) for q in analytic_ik((X_BG @ self._X_GF)[:, None], q7)]

    def along_branch(self, X_BG: Array, q_start: Array) -> list[Array]:
        """Postures of one branch index, joint 7 on _BRANCH_RAD about that of the start."""
        q = analytic_ik((X_BG @ self._X_GF)[:, None], q_start[6] + _BRANCH_RAD)
        distance = np.abs(q[0, len(_BRANCH_RAD) // 2] - q_start).max(axis=-1)
        branch = np.argmin(np.where(np.isfinite(distance), distance, np.inf))
        return [_listed(row) for row in q[:, :, branch]]

    def direction(self, X_BG: Array, q: Array) -> Array:
        """Unit null vectors by a finite difference along joint 7."""
        probe = q.copy()
        probe[:, 6] += _PROBE_RAD
        step = self.nearest(X_BG, probe) - q
        size = np.linalg.norm(step, axis=-1, keepdims=True)
        usable = np.isfinite(size) & (size < 0.1) & (size > 0.0)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(usable, step / size, 0.0)

    def nearest(self, X_BG: Array, q: Array) -> Array:
        """Of the branches at the guesses' joint-7 angles the one nearest to the guess."""
        found = analytic_ik(X_BG @ self._X_GF, q[:, 6])
        distance = np.abs(found - q[:, None]).max(axis=-1)
        best = np.argmin(np.where(np.isfinite(distance), distance, np.inf), axis=-1)
        return np.asarray(found[np.arange(len(q)), best])

    def out_of_reach_m(self, X_BG: Array) -> Array:
        """By the distance of shoulder and wrist."""
        return reach_window(X_BG @ self._X_GF)[2]


class Numeric:
    """Postures of any seven-joint arm by Newton steps within limits from many starts."""

    def __init__(self, plant: ArmPlant) -> None:
        self._plant = plant
        rng = np.random.default_rng(0)
        spread = rng.uniform(plant.lower, plant.upper, size=(_STARTS - 1, 7))
        self._starts = np.vstack([plant.robot.rest_q, spread])

    def all(self, X_BG: Array, samples: int, rounds: int = 0) -> list[Array]:
        """Postures that the starts, and those found for the pose before, lead to."""
        layers: list[Array] = []
        before = np.zeros((0, 7))
        for X in X_BG:
            found: list[Array] = []
            for start in (*before, *self._starts[: max(4, min(samples // 4, _STARTS))]):
                q, error = newton(self._plant, X, start, iterations=25)
                if error <= REACHED_M and all(np.abs(q - other).max() > _SAME_RAD for other in found):
                    found.append(q)
            before = np.reshape(found, (-1, 7))
            layers.append(before)
        return layers

    def around(self, X_BG: Array, q: Array, offsets: Array) -> list[Array]:
        """The nearest posture alone."""
        found = self.nearest(X_BG, q)
        return [row[None][np.isfinite(row[:1])] for row in found]

    def along_branch(self, X_BG: Array, q_start: Array) -> list[Array]:
        """None: branches are not known."""
        return [np.zeros((0, 7))] * len(X_BG)

    def direction(self, X_BG: Array, q: Array) -> Array:
        """Last right singular vector of the Jacobian."""
        return np.array([np.linalg.svd(self._plant.jacobian(row))[2][-1] for row in q]).reshape(-1, 7)

    def nearest(self, X_BG: Array, q: Array) -> Array:
        """Newton steps from the guesses."""
        found = np.full_like(q, np.nan)
        for i, (X, guess) in enumerate(zip(X_BG, q, strict=True)):
            if np.isfinite(guess).all():
                row, error = newton(self._plant, X, guess, iterations=15)
                found[i] = row if error <= REACHED_M else np.nan
        return found

    def out_of_reach_m(self, X_BG: Array) -> Array:
        """Nothing is proved for arms in general."""
        return np.zeros(len(X_BG))


def _listed(q: Array) -> Array:
    """The finite rows (N, 7) of postures (..., 7)."""
    q = q.reshape(-1, q.shape[-1])
    return q[np.isfinite(q[:, 0])]
