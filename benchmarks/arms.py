"""Audits of arms by name: clean motions and planted faults, drawn from each arm's own limits, against the verdicts.

Motions are minimum-jerk moves between random postures, in closed form. What they keep and break is shown by the limits
of the description, by Drake's inverse dynamics and by Drake's signed distances, posture by posture.
"""

import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.markdown import table
from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.collision import CollisionModel
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.metrics.judge import TrackJudge
from kinebench_drake.models.arm import load_robot
from kinebench_drake.track import GripperTrack

FRAMES = 49
PERIOD_S = 0.2
USED = 0.85
"""Greatest share of a limit that clean motions use."""
FAULTS = ("joint_limit", "velocity", "torque", "self_collision", "table_collision", "discontinuity", "unreachable")
DEPTH_M = 0.01
"""Least depth of planted contacts, and least clearance of clean motions [m]."""
JUMP_M = 0.12
"""Least jump of the TCP [m]."""
USUAL = 0.5
"""Share of postures from which on a pair of links is near by design: clean motions then only do not touch."""
EXCESS = (1.3, 3.0)
"""Planted speeds and torques over their limits."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmTrial:
    """One clean motion or fault, and its verdict."""

    fault: str | None
    feasible: bool | None
    kinds: frozenset[str]
    seconds: float


class ArmWorker:
    """Draws motions of one arm and judges them; odd trials have faults."""

    def __init__(self, name: str, seed: int) -> None:
        """Load the arm, without and with a payload that overloads it."""
        self._seed = seed
        self.plant = ArmPlant(load_robot(name))
        self._faults = [fault for fault in FAULTS if fault not in self.plant.robot.limits.unstated]
        self._body = CollisionModel(self.plant)
        self._judge = TrackJudge(self.plant)
        middle = 0.5 * (self.plant.lower + self.plant.upper)
        room = 0.97 * np.minimum(0.5 * (self.plant.upper - self.plant.lower), np.pi)
        self._ends = middle - room, middle + room
        postures = np.random.default_rng(0).uniform(*self._ends, size=(2000, len(room)))
        near = Counter(pair for q in postures[::20] for pair, _ in self._near(q))
        self._close = {pair for pair, count in near.items() if count > USUAL * len(postures[::20])}
        own = self.plant.forward_path(postures)
        self._reach_m = float(np.linalg.norm(own[:, :3, 3], axis=-1).max())
        weight = float(np.median(self.plant.effort_limits[:2])) / (9.81 * self._reach_m)
        self._loaded = ArmPlant(load_robot(name, payload_kg=round(min(2.0 * EXCESS[0] * weight, 50.0), 1)))

    def __call__(self, index: int) -> ArmTrial:
        """Draw and judge trial number `index`."""
        rng = np.random.default_rng([self._seed, index])
        fault = self._faults[index // 2 % len(self._faults)] if index % 2 else None
        while (motion := self._draw(rng, fault)) is None:
            pass
        t_s, q, X_BG = motion
        judge = TrackJudge(self._loaded) if fault == "torque" else self._judge
        start = time.process_time()
        if X_BG is None:
            result = judge.judge_joints(t_s, q, np.full(len(t_s), np.nan))
        else:
            shown = np.ones(len(t_s), dtype=bool)
            gap = np.full(len(t_s), np.nan)
            track = GripperTrack(
                t_s=t_s, X_CH=np.full_like(X_BG, np.nan), X_BG=X_BG, tracked=shown, confidence=shown + 0.0,
                finger_width_m=gap,
            )  # fmt: skip
            result = judge.judge_poses(track)
        seconds = time.process_time() - start
        kinds = frozenset(violation.kind.value for violation in result.violations)
        return ArmTrial(fault=fault, feasible=result.feasible, kinds=kinds, seconds=seconds)

    def _draw(self, rng: np.random.Generator, fault: str | None) -> tuple[Array, Array, Array | None] | None:
        """Draw times (T,) [s], angles (T, J) [rad] and, of a track of poses, poses (T, 4, 4) [m]; None: draw again."""
        a, b = rng.uniform(*self._ends, size=(2, len(self.plant.lower)))
        b = b if fault in ("self_collision", "table_collision") else a + 0.5 * (b - a)
        s = np.linspace(0.0, 1.0, FRAMES)[:, None]
        rise = 10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5
        t_s = np.asarray(PERIOD_S * np.arange(FRAMES), dtype=np.float64)
        q: Array = np.asarray(a + rise * (b - a), dtype=np.float64)
        speed = 1.875 * np.abs(b - a) / t_s[-1]  # the peak of a minimum-jerk move
        own_m = max(self._depth(b, gap_m) for gap_m in (0.0, None))  # as the gap of the fingers is not recorded
        contacts = {"self_collision": own_m, "table_collision": self._height(q)}
        if fault in contacts:
            return (t_s, q, None) if contacts[fault] < -DEPTH_M else None
        if not self._is_clean(q, np.gradient(q, t_s, axis=0)):
            return None
        if fault == "joint_limit":
            j = int(rng.integers(len(a)))
            q[:, j] += (self.plant.upper[j] + rng.uniform(0.05, 0.3) - q[FRAMES // 2, j]) * np.sin(np.pi * s[:, 0]) ** 2
        elif fault == "velocity":
            t_s *= float((speed / self.plant.velocity_limits).max()) / rng.uniform(*EXCESS)
        elif fault == "torque":
            still = np.array([self._loaded.torque(row, 0.0 * row, 0.0 * row) for row in q[::6]])
            if np.abs(still / self.plant.effort_limits).max() < EXCESS[0]:
                return None
        elif fault == "discontinuity":
            jump = rng.uniform(*self._ends) - a
            q[FRAMES // 2 :] += 0.3 * jump
            ends = self.plant.forward_path(q[FRAMES // 2 - 1 : FRAMES // 2 + 1])[:, :3, 3]
            if np.linalg.norm(ends[1] - ends[0]) < JUMP_M:
                return None
        elif fault == "unreachable":
            X_BG = self.plant.forward_path(q)
            p = X_BG[:, :3, 3]
            X_BG[:, :3, 3] += rise * (1.25 * self._reach_m * p[-1] / np.linalg.norm(p[-1]) - p[-1])
            return t_s, q, X_BG
        return t_s, q, self.plant.forward_path(q) if fault is None and rng.random() < 0.5 else None

    def _height(self, q: Array) -> float:
        return float(np.nan_to_num(self._body.table_distance(q[::6]).distance_m, nan=1.0).min())

    def _depth(self, q: Array, gap_m: float | None) -> float:
        pairs = self.plant.query(q, gap_m).ComputeSignedDistancePairwiseClosestPoints(0.0)
        return float(min((pair.distance for pair in pairs), default=0.0))

    def _is_clean(self, q: Array, v: Array) -> bool:
        """Return whether a motion (T, J) [rad] with these speeds [rad/s] keeps every limit by a margin."""
        allowed = USED * self.plant.robot.limits.speeds(q, v)
        if (np.abs(v) > allowed).any() or self._height(q) < DEPTH_M:
            return False
        torque = np.array([self.plant.torque(row, 0.0 * row, 0.0 * row) for row in q[::6]])
        near = [(pair, distance) for row in q[::2] for pair, distance in self._near(row)]
        touching = any(distance < 0.0 or pair not in self._close for pair, distance in near)
        return bool((np.abs(torque) <= USED * self.plant.effort_limits).all()) and not touching

    def _near(self, q: Array) -> list[tuple[object, float]]:
        """Return the pairs of shapes that are nearer than DEPTH_M, with their distances [m]."""
        pairs = self.plant.query(q).ComputeSignedDistancePairwiseClosestPoints(DEPTH_M)
        return [((pair.id_A, pair.id_B), pair.distance) for pair in pairs]


def arm_table(trials: Sequence[tuple[str, ArmTrial]]) -> Iterator[str]:
    """Format, for each arm, how many faults get the right reason, and clean motions called infeasible."""
    rows = []
    for name in dict.fromkeys(name for name, _ in trials):
        own = [trial for arm, trial in trials if arm == name]
        faults = [trial for trial in own if trial.fault is not None]
        clean = [trial for trial in own if trial.fault is None]
        missed = [str(trial.fault) for trial in faults if trial.fault not in trial.kinds]
        false = [", ".join(sorted(trial.kinds)) for trial in clean if trial.feasible is False]
        seconds = np.percentile([trial.seconds for trial in clean], [50, 95])
        hits = f"{len(faults) - len(missed)} of {len(faults)}"
        rows.append([name, hits, " ".join(missed), f"{len(false)} of {len(clean)}", "; ".join(false)])
        rows[-1] += [f"{value:.3f}" for value in seconds]
    head = ("arm", "with the right reason", "missed", "false", "as", "median s a clean track", "95th percentile")
    yield from table(head, rows)
