"""Motions that the arm can execute: drawn at random, kept only if the proof holds."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.motion import Arm, Motion, Proof, prove
from benchmarks.moves import Family, cartesian, joint_space, shipped
from benchmarks.trajectory import Trajectory
from kinebench_drake.geometry import Array

BENCHMARK_FRAMES = 49
BENCHMARK_PERIOD_S = 0.2
"""Frames of a benchmark episode and time between them."""
OTHER_PERIODS_S = (0.05, 1.0 / 17.0)
"""Times between frames of a fifth of the trajectories: the control period, and the period at which videos play [s]."""

_SHARES = {Family.CARTESIAN: 0.7, Family.SHIPPED: 0.15, Family.JOINT: 0.15}
_DRAW = {Family.CARTESIAN: cartesian, Family.SHIPPED: shipped, Family.JOINT: joint_space}
_WINDOWS = 4
"""Tracks cut out of one long motion."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FeasibleMotion:
    """A motion with its proof, and the frames that sample it."""

    family: Family
    motion: Motion
    proof: Proof | None
    """None if none was asked for."""
    start_s: float
    """Time of the motion at the first frame [s]."""
    period_s: float
    """Time between frames [s]."""
    frames: int

    @property
    def t_s(self) -> Array:
        """Times of the frames (T,) from 0 [s]."""
        return np.asarray(self.period_s * np.arange(self.frames), dtype=np.float64)

    def trajectory(self, arm: Arm, motion_s: Array | None = None, t_s: Array | None = None) -> Trajectory:
        """Return the trajectory at the frames, or at other times of the motion (T,) [s] with time stamps (T,) [s]."""
        when = self.start_s + self.t_s if motion_s is None else motion_s
        q = self.motion.q(when)
        return Trajectory(
            t_s=self.t_s if t_s is None else t_s,
            X_BG=arm.plant.forward_path(q),
            finger_width_m=self.motion.width(when),
            q=q,
        )


def draw_feasible(
    rng: np.random.Generator, arm: Arm, *, family: Family | None = None, proven: bool = True
) -> FeasibleMotion:
    """Draw a feasible motion; repeated until the proof holds.

    Nine in ten of the tracks at 0.2 s have 49 frames as benchmark episodes do. A third of the tracks is cut out of a
    longer motion.

    Args:
        rng: random generator.
        arm: the robot.
        family: how to draw; None for the usual mixture.
        proven: False omits the proof, for trajectories whose truth is not used.
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
            return FeasibleMotion(
                family=family, motion=motion, proof=proof, start_s=start, period_s=period, frames=frames
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackSet:
    """Number and sampling of expert-like tracks."""

    tracks: int
    frames: int
    """Frames of each track."""
    period_s: float
    """Time between frames [s]."""


def smooth_motions(rng: np.random.Generator, arm: Arm, tracks: TrackSet) -> Iterator[tuple[Motion, Array]]:
    """Yield expert-like motions within limits of position, speed and acceleration, each with frame times (T,) [s]."""
    span = tracks.period_s * (tracks.frames - 1)
    count = 0
    while count < tracks.tracks:
        motion = cartesian(rng, arm, _WINDOWS * span)
        if motion is None:
            continue
        for k in range(_WINDOWS):
            t_s = np.asarray(k * span + tracks.period_s * np.arange(tracks.frames), dtype=np.float64)
            fine = np.linspace(t_s[0], t_s[-1], 1000)
            q, v, a = (motion.q(fine, order) for order in range(3))
            within = (q >= arm.plant.lower).all() and (q <= arm.plant.upper).all()
            slow = (np.abs(v) <= arm.plant.velocity_limits).all() and (np.abs(a) <= arm.acceleration_limits).all()
            if within and slow and count < tracks.tracks:
                count += 1
                yield motion, t_s
