"""Verdicts on the same motions by the limits of the Panda and of the Franka Research 3, against proofs for both.

A motion is drawn within the limits of one of the two and proven for each (`motion.prove`). The arms differ in limits
and masses alone, so a proof that fails shows which limit the motion breaks. It is judged by its joint angles.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from benchmarks.feasible import draw_feasible
from benchmarks.markdown import table
from benchmarks.motion import Arm, prove
from benchmarks.moves import Family
from kinebench_drake.geometry import Array
from kinebench_drake.metrics.judge import TrackJudge
from kinebench_drake.models.arm import ROBOTS, load_robot
from kinebench_drake.models.joint_limits import JointLimits
from kinebench_drake.results.aggregate import estimate


class Truth(Enum):
    """What is proven about a motion and one robot."""

    FEASIBLE = "feasible"
    """It keeps every limit at 500 Hz."""
    SHOWN = "infeasible, shown by the frames"
    """An angle, or a first, second or third difference of the frames, exceeds its limit."""
    BETWEEN = "infeasible between the frames"
    """It breaks a limit that the frames alone do not show."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotTrial:
    """One motion, judged for every robot."""

    index: int
    truths: Mapping[str, Truth]
    """By the name of the robot."""
    feasible: Mapping[str, bool | None]
    """Verdicts likewise."""
    kinds: Mapping[str, frozenset[str]]
    """Kinds of violations likewise."""


class RobotWorker:
    """Draws motions and judges each by all robots."""

    def __init__(self, seed: int) -> None:
        """Load the robots."""
        self._seed = seed
        self._arms = {name: Arm(load_robot(name)) for name in ROBOTS}
        self._judges = {name: TrackJudge(arm.plant) for name, arm in self._arms.items()}

    def __call__(self, index: int) -> RobotTrial:
        """Draw motion number `index`, for the robots in turn, half of them up to high speeds; prove and judge it."""
        rng = np.random.default_rng([self._seed, index])
        arm = list(self._arms.values())[index % len(self._arms)]
        base = draw_feasible(rng, arm, family=Family.JOINT if index // len(self._arms) % 2 else None)
        track = base.trajectory(arm)
        q = np.asarray(track.q)
        truths = {}
        results = {}
        for name, own in self._arms.items():
            distance_m = None if base.proof is None else base.proof.self_distance_m  # the arms have one shape
            proof = prove(own, base.motion, base.start_s, base.start_s + base.t_s[-1], distance_m)
            shown = shows_excess(own.plant.robot.limits, track.t_s, q)
            truths[name] = Truth.FEASIBLE if proof.holds else Truth.SHOWN if shown else Truth.BETWEEN
            results[name] = self._judges[name].judge_joints(track.t_s, q, track.finger_width_m)
        return RobotTrial(
            index=index,
            truths=truths,
            feasible={name: result.feasible for name, result in results.items()},
            kinds={name: frozenset(v.kind.value for v in result.violations) for name, result in results.items()},
        )


def shows_excess(limits: JointLimits, t_s: Array, q: Array) -> bool:
    """Return whether joint angles (T, 7) [rad] at even times (T,) [s] show that a limit is exceeded.

    A k-th difference over the k-th power of the period is a mean of the k-th derivative (its Peano kernel is a
    B-spline); a speed counts as too fast if it exceeds the limits of both ends of its step.
    """
    period = float(t_s[1] - t_s[0])
    v = np.diff(q, axis=0) / period
    bounds = (np.maximum(limits.speeds(q[:-1], v), limits.speeds(q[1:], v)), limits.acceleration, limits.jerk)
    outside = bool(((q < limits.lower) | (q > limits.upper)).any())
    return outside or any(
        limit is not None and bool((np.abs(np.diff(q, order, axis=0)) > limit * period**order).any())
        for order, limit in enumerate(bounds, 1)
    )


def robot_table(trials: Sequence[RobotTrial]) -> Iterator[str]:
    """Format, for each robot and truth, how many motions are judged infeasible, and the exceptions."""
    rows = []
    notes = []
    for name in ROBOTS:
        for truth in Truth:
            own = [trial for trial in trials if trial.truths[name] is truth]
            share = estimate([trial.feasible[name] is False for trial in own], total=len(own))
            hits = sum(trial.feasible[name] is False for trial in own)
            interval = (
                "" if share.low is None or share.high is None else f"{100 * share.low:.1f} to {100 * share.high:.1f} %"
            )
            kinds = Counter(kind for trial in own for kind in trial.kinds[name])
            named = ", ".join(f"{kind} {n}" for kind, n in sorted(kinds.items()))
            rows.append([name, truth.value, f"{hits} of {len(own)}", interval, named])
            wrong = [t.index for t in own if (t.feasible[name] is False) is (truth is Truth.FEASIBLE)]
            if wrong and truth is not Truth.BETWEEN:
                notes.append(f"{name}, {truth.value}, judged otherwise: {' '.join(map(str, wrong))}")
    yield from table(("robot", "proven", "judged infeasible", "95 %", "limits named"), rows)
    pairs = Counter(tuple(trial.truths[name] is Truth.FEASIBLE for name in ROBOTS) for trial in trials)
    names = list(ROBOTS)
    yield ""
    yield (
        f"{len(trials)} motions: {pairs[True, True]} feasible for both, {pairs[True, False]} for {names[0]} alone, "
        f"{pairs[False, True]} for {names[1]} alone"
    )
    yield from notes
