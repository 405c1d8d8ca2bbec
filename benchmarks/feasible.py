"""Trajectories that the arm can make: drawn, and kept only when the proof holds."""

from dataclasses import dataclass

import numpy as np

from benchmarks.motion import Arm, Motion, Proof, prove
from benchmarks.moves import Family, cartesian, joint_space, shipped
from benchmarks.sample import Trajectory
from kinebench_drake.geometry import Array

BENCHMARK_FRAMES, BENCHMARK_PERIOD_S = 49, 0.2
"""A benchmark episode."""
OTHER_PERIODS_S = (0.05, 1.0 / 17.0)
"""Times between frames of a fifth of the trajectories: the control rate, and the rate at which the videos play."""

_SHARES = {Family.CARTESIAN: 0.7, Family.SHIPPED: 0.15, Family.JOINT: 0.15}
_DRAW = {Family.CARTESIAN: cartesian, Family.SHIPPED: shipped, Family.JOINT: joint_space}


@dataclass(frozen=True, slots=True, kw_only=True)
class Feasible:
    """A motion with its proof, and the frames in which it is seen."""

    family: Family
    motion: Motion
    proof: Proof | None
    """None where none was asked for."""
    start_s: float
    """Time of the motion at the first frame [s]."""
    period_s: float
    """Time between frames [s]."""
    frames: int
    cut: bool
    """Whether the frames may begin or end while the arm moves."""

    @property
    def t_s(self) -> Array:
        """(T,) times of the frames from 0 [s]."""
        return np.asarray(self.period_s * np.arange(self.frames), dtype=np.float64)

    def trajectory(self, arm: Arm, motion_s: Array | None = None, t_s: Array | None = None) -> Trajectory:
        """The frames, or those at other times of the motion (T,) [s] with other time stamps (T,) [s]."""
        when = self.start_s + self.t_s if motion_s is None else motion_s
        q = self.motion.q(when)
        return Trajectory(
            t_s=self.t_s if t_s is None else t_s,
            X_BG=np.array([arm.plant.forward(posture) for posture in q]),
            finger_width_m=self.motion.width(when),
            q=q,
        )


def draw_feasible(rng: np.random.Generator, arm: Arm, *, family: Family | None = None, proven: bool = True) -> Feasible:
    """A feasible motion of some family, drawn again until the proof holds.

    Nine in ten of the tracks at 0.2 s have 49 frames as benchmark episodes do. A third of the tracks is cut out of a
    longer motion.

    Args:
        rng: all randomness.
        arm: the robot.
        family: how to draw; None for the usual mixture.
        proven: False leaves the proof out, where nobody relies on the truth.
    """
    if family is None:
        family = list(_SHARES)[rng.choice(len(_SHARES), p=list(_SHARES.values()))]
    period = BENCHMARK_PERIOD_S if rng.random() < 0.8 else float(rng.choice(OTHER_PERIODS_S))
    frames = BENCHMARK_FRAMES if rng.random() < 0.9 or period < BENCHMARK_PERIOD_S else int(rng.integers(20, 100))
    if period < BENCHMARK_PERIOD_S and rng.random() < 0.5:
        frames = int(rng.integers(60, 200))
    span = period * (frames - 1)
    cut = bool(rng.random() < 1.0 / 3.0)
    while True:
        motion = _DRAW[family](rng, arm, span * (1.5 if cut else 1.0))
        if motion is None or motion.duration_s < span:
            continue
        spare = motion.duration_s - span
        start = float(rng.uniform(0.0, spare)) if cut or family is Family.JOINT else 0.0
        proof = prove(arm, motion, start, start + span) if proven else None
        if proof is None or proof.holds:
            return Feasible(
                family=family, motion=motion, proof=proof, start_s=start, period_s=period, frames=frames, cut=cut
            )
