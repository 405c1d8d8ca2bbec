"""The law that no number of a track improves because frames are lost or cannot be reached, on random tracks."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from benchmarks.feasible import draw_feasible
from benchmarks.motion import Arm
from benchmarks.trajectory import Trajectory, add_noise
from kinebench_drake.geometry import Array, rotation_exp
from kinebench_drake.metrics.judge import TrackJudge
from kinebench_drake.metrics.kinematic_result import KinematicResult, Value
from kinebench_drake.results.direction import BOUND, HIGHER_IS_BETTER, LOWER_IS_BETTER, worst_value
from kinebench_drake.track import GripperTrack

STAGES = 2
"""Times that frames of a track are replaced, one after the other."""
_FAR_M = (1.4, 2.0)
"""Range of the distance of an unreachable TCP from the shoulder [m]; the arm is 1.2 m long with its hand."""
_PAST_RAD = (0.3, 1.0)
"""Range of the angle of an unreachable posture past a joint limit [rad]."""
_SHOULDER_M = np.array([0.0, 0.0, 0.333])


def improves(name: str, before: float, after: float) -> bool:
    """Return whether `after` is better than `before`; never for metrics that are neither good nor bad."""
    return after != before and worst_value(name, (before, after)) == before


class TrackKind(Enum):
    """Random tracks."""

    FEASIBLE = "feasible"
    """Poses of a feasible motion, half of them with noise of up to 5 mm and 2.5 degrees."""
    JOINTS = "joints"
    """Joint angles of a feasible motion, as recorded."""


class LossKind(Enum):
    """What a frame is replaced by."""

    LOST = "lost"
    """No pose."""
    UNREACHABLE = "unreachable"
    """A pose that is too far away, or a joint angle past its limit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LossTrial:
    """Numbers of one track, before and after each replacement."""

    index: int
    kind: TrackKind
    losses: tuple[LossKind, ...]
    """Replacements, one after the other."""
    metrics: tuple[Mapping[str, Value], ...]
    """Metrics of the track, and after each replacement."""

    @property
    def improved(self) -> dict[str, tuple[float, float]]:
        """Metrics that a replacement improves: values before and after."""
        better = {}
        for before, after in zip(self.metrics, self.metrics[1:], strict=False):
            for name in sorted(HIGHER_IS_BETTER | LOWER_IS_BETTER):
                old, new = (m.get(name + BOUND, m.get(name)) for m in (before, after))
                if old is not None and new is not None and improves(name, float(old), float(new)):
                    better[name] = float(old), float(new)
        return better


class LossWorker:
    """Judges random tracks with and without replaced frames."""

    def __init__(self, seed: int) -> None:
        """Load the robot."""
        self._seed = seed
        self._arm = Arm()
        self._judge = TrackJudge(self._arm.plant)

    def __call__(self, index: int) -> LossTrial:
        """Draw track number `index`, and judge it before and after each of STAGES replacements."""
        rng = np.random.default_rng([self._seed, index])
        kind = list(TrackKind)[index % len(TrackKind)]
        track = self._draw(rng, kind)
        tracked = np.ones(len(track.t_s), dtype=bool)
        results = [self._measure(track, tracked)]
        losses = list[LossKind]()
        usable = tracked & (results[0].curves["manipulability"] > 0.0)  # neither lost nor unreachable so far
        for _ in range(STAGES):
            loss = list(LossKind)[rng.integers(len(LossKind))]
            frames = _choose(rng, usable)
            usable[frames] = False
            if loss is LossKind.LOST:
                tracked = tracked & ~frames
            else:
                track = _move_away(rng, self._arm, track, frames)
            losses.append(loss)
            results.append(self._measure(track, tracked))
        return LossTrial(
            index=index, kind=kind, losses=tuple(losses), metrics=tuple({**result.metrics} for result in results)
        )

    def _draw(self, rng: np.random.Generator, kind: TrackKind) -> Trajectory:
        track = draw_feasible(rng, self._arm, proven=False).trajectory(self._arm)
        if kind is TrackKind.JOINTS:
            return track
        size_mm = rng.uniform(0.0, 5.0) * (rng.random() < 0.5)
        return add_noise(rng, track, 1e-3 * size_mm, np.deg2rad(0.5 * size_mm))

    def _measure(self, track: Trajectory, tracked: NDArray[np.bool_]) -> KinematicResult:
        if track.q is not None:
            q = np.where(tracked[:, None], track.q, np.nan)
            return self._judge.judge_joints(track.t_s, q, track.finger_width_m)
        X_BG = np.where(tracked[:, None, None], track.X_BG, np.nan)
        return self._judge.judge_poses(
            GripperTrack(
                t_s=track.t_s,
                X_CH=np.full_like(X_BG, np.nan),
                X_BG=X_BG,
                tracked=tracked,
                confidence=tracked.astype(np.float64),
                finger_width_m=track.finger_width_m,
            )
        )


def _choose(rng: np.random.Generator, usable: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Choose a stretch of frames, or single ones: half of the times one or two."""
    n = len(usable)
    count = int(rng.integers(1, 3)) if rng.random() < 0.5 else int(rng.integers(1, n + 1))
    if rng.random() < 0.5:
        first = int(rng.integers(n))
        return usable & (np.arange(n) >= first) & (np.arange(n) < first + count)
    return usable & (rng.permutation(n) < count)


def _move_away(rng: np.random.Generator, arm: Arm, track: Trajectory, frames: NDArray[np.bool_]) -> Trajectory:
    """Replace frames by unreachable ones that move together."""
    if track.q is not None:
        q = track.q.copy()
        joint = int(rng.integers(7))
        q[frames, joint] = arm.plant.upper[joint] + rng.uniform(*_PAST_RAD)
        return replace(track, q=q)
    X_BG = track.X_BG.copy()
    direction = rng.normal(size=3)
    place: Array = _SHOULDER_M + rng.uniform(*_FAR_M) * direction / np.linalg.norm(direction)
    X_BG[frames, :3, 3] = place + rng.normal(0.0, rng.choice([0.0, 0.05]), size=(int(frames.sum()), 3))
    X_BG[frames, :3, :3] = rotation_exp(rng.normal(0.0, 1.0, size=3))
    return replace(track, X_BG=X_BG)


def loss_table(trials: Sequence[LossTrial]) -> Iterator[str]:
    """Format, for each metric, in how many replacements it improves, stays a number or becomes null."""
    numbers = Counter[str]()
    nulls = Counter[str]()
    improved = dict[str, list[int]]()
    for trial in trials:
        for before, after in zip(trial.metrics, trial.metrics[1:], strict=False):
            for name in sorted(before):
                if before[name] is not None:
                    (nulls if after[name] is None else numbers)[name] += 1
        for name in trial.improved:
            improved.setdefault(name, []).append(trial.index)
    yield f"{len(trials)} tracks, {STAGES} replacements each"
    yield f"{'metric':34}{'still a number':>16}{'null':>8}{'improved':>10}"
    for name in sorted((HIGHER_IS_BETTER | LOWER_IS_BETTER) & (numbers.keys() | nulls.keys())):
        yield f"{name:34}{numbers[name]:16}{nulls[name]:8}{len(improved.get(name, [])):10}"
    for name, indices in sorted(improved.items()):
        yield f"{name} improves in {', '.join(map(str, indices))}"
