"""Random postures and motions of a Panda above a table."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from kinebench_drake.geometry import Array
from training.layout import random_finger

_REST = np.array([0.0, 0.4, 0.0, -2.0, 0.0, 2.4, 0.785])
_SPREAD_RAD = np.array([0.6, 0.5, 0.4, 0.5, 0.5, 0.5, 1.2])
_WRIST = ("panda_link5", "panda_link6", "panda_link7")
_STEP = 0.5
"""Spread of a motion's waypoint about the one before, over that of postures."""
_LEGS = (3, 4)
"""Fewest and most motions between two stops."""
_GRASPS = 0.5
"""Share of the stops at which the gripper closes on something, as long as it has not."""
_SPEED_RAD_S = (0.4, 1.5)
"""Range of the mean speed of the fastest joint between two stops [rad/s]."""
_PAUSE_S = 0.6
"""Time in which the fingers move at a stop [s]."""
_DRAWS = 20_000


@dataclass(frozen=True, slots=True, kw_only=True)
class PostureSampler:
    """Source of postures above a table."""

    lower: Array
    """(7,) lower joint limits [rad]."""
    upper: Array
    """(7,) upper joint limits [rad]."""
    link_poses: Callable[[Array], Mapping[str, Array]]
    """Function of joint angles (7,): poses (4, 4) of the links in the base frame [m], by name."""
    table_z: float
    """Height of the table [m]."""

    def clears_table(self, q: Array) -> bool:
        """Return whether wrist and gripper are above the table at `q` (7,), the fingertips below 0.85 m."""
        X_BL = self.link_poses(q)
        X_BH = X_BL["panda_hand"]
        tip_z = X_BH[2, 3] + 0.11 * X_BH[2, 2] - self.table_z
        low = min(float(X_BL[name][2, 3]) for name in _WRIST)
        high = low >= self.table_z + 0.05 and X_BH[2, 3] >= self.table_z + 0.03
        return bool(0.0 <= tip_z <= 0.85 and high)

    def draw(self, rng: np.random.Generator) -> Array:
        """Return joint angles (7,): mostly in front of the base and pointing down."""
        for _ in range(_DRAWS):
            q = _REST + rng.normal(0, _SPREAD_RAD) if rng.random() < 0.8 else rng.uniform(self.lower, self.upper)
            if not self._within(q) or not self.clears_table(q):
                continue
            X_BH = self.link_poses(q)["panda_hand"]
            if rng.random() > np.exp(2.0 * (-X_BH[2, 2] - 1.0)) or (X_BH[0, 3] < 0.2 and rng.random() < 0.8):
                continue
            return np.asarray(q)
        raise RuntimeError(f"no robot pose above the table after {_DRAWS} draws; the joint limits exclude it")

    def _within(self, q: Array) -> bool:
        return bool((q >= self.lower).all() and (q <= self.upper).all())

    def draw_motion(self, rng: np.random.Generator, frame_period_s: float, payload_m: float) -> "Motion":
        """Return a motion between random postures, with at most one grasp of something `payload_m` thick to each side.

        The arm comes to rest at each posture, where the fingers move; the path between them is straight in joint space.
        """
        q = [self.draw(rng)]
        fingers = [random_finger(rng)]
        holds = [False]
        for _ in range(int(rng.integers(*_LEGS, endpoint=True))):
            for _ in range(_DRAWS):
                waypoint = q[-1] + rng.normal(0, _STEP * _SPREAD_RAD)
                path = q[-1] + np.linspace(0.0, 1.0, 9)[:, None] * (waypoint - q[-1])
                if self._within(waypoint) and all(map(self.clears_table, path[1:])):
                    break
            else:
                raise RuntimeError(f"no motion above the table after {_DRAWS} draws; the posture has no room around it")
            q.append(waypoint)
            holds.append(not any(holds) and rng.random() < _GRASPS)
            fingers.append(payload_m if holds[-1] else random_finger(rng))
        return Motion.between(rng, np.array(q), np.array(fingers), np.array(holds), frame_period_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """Motion of arm and fingers in T frames."""

    q: Array
    """(T, 7) joint angles [rad]."""
    finger_m: Array
    """(T,) opening of each finger [m]."""
    holds: NDArray[np.bool_]
    """(T,) frames in which something is between the fingers."""

    @staticmethod
    def between(
        rng: np.random.Generator, q: Array, finger_m: Array, holds: NDArray[np.bool_], frame_period_s: float
    ) -> "Motion":
        """Return the motion from rest to rest through postures `q` (N, 7).

        The fingers move to `finger_m` (N,) [m] in each stop; where `holds` (N,), a thing is held from then on, up to
        the next stop.
        """
        times = [0.0]
        knots = [q[0]]
        stops = [0.0]
        for k in range(1, len(q)):
            speed = rng.uniform(*_SPEED_RAD_S)
            stops.append(times[-1] + max(float(np.abs(q[k] - q[k - 1]).max()) / speed, 2 * frame_period_s))
            times += [stops[-1], stops[-1] + _PAUSE_S]
            knots += [q[k], q[k]]
        t = np.arange(0.0, times[-1] + 1e-9, frame_period_s)
        arm = CubicHermiteSpline(times, knots, np.zeros_like(knots))  # at rest in all knots: straight lines between
        leg = np.searchsorted(stops, t, side="right") - 1
        opened = np.concatenate([finger_m[:1], finger_m])
        share = np.where(leg > 0, np.clip((t - np.array(stops)[leg]) / _PAUSE_S, 0.0, 1.0), 1.0)
        finger = opened[leg] + (opened[leg + 1] - opened[leg]) * share**2 * (3 - 2 * share)
        return Motion(q=np.asarray(arm(t)), finger_m=finger, holds=holds[leg] & (share >= 1.0))
