"""Drop lists of data sets with planted faults: precision and recall of each reason."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks import markdown
from benchmarks.feasible import TrackSet, smooth_motions
from benchmarks.motion import Arm, prove
from benchmarks.record import machine_text
from kinebench_drake.geometry import Array
from kinebench_drake.results.drops import Drop, DropReason

_FPS = 20
_FRAMES = 120
_LIMIT_RAD = 0.1  # beyond the limit of a joint
_IDLE = (25, 60)  # frames of a planted rest: 1.25 to 3 s
# frames by which actions come after the motion, and too long before it
_LATE = (2, 8)
_EARLY = (14, 19)
# frames at either end of a drawn motion in which it does not rest
_END = 20
_STILL_RAD = 0.05
_NOISE_RAD = 2e-4  # of states
PLANTED = (
    None,
    None,
    DropReason.INFEASIBLE,
    DropReason.DROPPED_SAMPLES,
    DropReason.IDLE_ENDS,
    DropReason.ACTION_OFFSET,
    DropReason.DUPLICATE,
)
"""Faults of the episodes in turn."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantedEpisode:
    """Recording of one episode with at most one fault."""

    state: Array
    """(T, 8) joint angles [rad] and finger gap [m]."""
    action: Array
    """(T, 8) targets: the states of the next frame, unless they are shifted."""
    fault: DropReason | None


def draw_episodes(count: int, seed: int) -> Iterator[PlantedEpisode]:
    """Draw episodes, the faults of `PLANTED` in turn."""
    rng = np.random.default_rng(seed)
    arm = Arm()
    tracks = TrackSet(tracks=8 * count, frames=_FRAMES + 1, period_s=1.0 / _FPS)
    drawn: list[PlantedEpisode] = []
    copied: list[PlantedEpisode] = []
    for motion, t_s in smooth_motions(rng, arm, tracks):
        ends = motion.q(t_s)[[0, _END, -_END - 1, -1]]
        rests = min(np.abs(ends[1] - ends[0]).max(), np.abs(ends[3] - ends[2]).max()) < _STILL_RAD
        if rests or not prove(arm, motion, float(t_s[0]), float(t_s[-1])).holds:
            continue
        if len(drawn) == count:
            return
        fault = PLANTED[len(drawn) % len(PLANTED)]
        q = motion.q(t_s) + _NOISE_RAD * rng.standard_normal((len(t_s), 7))
        states = np.column_stack([q, motion.width(t_s)])
        shift = 1
        if fault is DropReason.INFEASIBLE:
            j = int(rng.integers(7))
            start = int(rng.integers(20, 60))
            bump = np.zeros(len(states))
            bump[start : start + 41] = np.sin(np.linspace(0.0, np.pi, 41)) ** 2
            states[:, j] += bump * (arm.plant.upper[j] + _LIMIT_RAD - states[:, j].max() + np.ptp(states[:, j]))
        elif fault is DropReason.DROPPED_SAMPLES:
            speed = np.linalg.norm(np.diff(states[:, :7], axis=0), axis=-1)
            states = np.delete(states, 20 + int(np.argmax(speed[20:-20])), axis=0)
        elif fault is DropReason.IDLE_ENDS:
            rest = int(rng.integers(*_IDLE))
            side = int(rng.integers(2))
            still = np.repeat(states[[-side]], rest, axis=0)
            still[:, :7] += _NOISE_RAD * rng.standard_normal((rest, 7))
            states = np.concatenate([states, still] if side else [still, states])
        elif fault is DropReason.ACTION_OFFSET:
            shift = -int(rng.integers(*_LATE)) if rng.random() < 0.5 else int(rng.integers(*_EARLY))
        times = np.clip(np.arange(len(states) - 1) + shift, 0, len(states) - 1)
        episode = PlantedEpisode(state=states[:-1], action=states[times], fault=fault)
        if fault is DropReason.DUPLICATE:
            other = next(e for e in drawn if e.fault is None and not any(e is c for c in copied))
            episode = PlantedEpisode(state=other.state, action=other.action, fault=fault)
            copied.append(other)
        drawn.append(episode)
        yield episode


def write_dataset(folder: Path, episodes: Sequence[PlantedEpisode]) -> None:
    """Write episodes as a LeRobot dataset v2.1 without videos."""
    (folder / "meta").mkdir(parents=True)
    data = folder / "data" / "chunk-000"
    data.mkdir(parents=True)
    names = [*(f"panda_joint{j}.pos" for j in range(1, 8)), "gripper_width"]
    vector = {"dtype": "float32", "shape": [8], "names": names}
    features = {"observation.state": vector, "action": vector, "timestamp": {"dtype": "float32", "shape": [1]}}
    info = {"codebase_version": "v2.1", "fps": _FPS, "robot_type": "panda", "features": features}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    lines = []
    start = 0
    for k, episode in enumerate(episodes):
        n = len(episode.state)
        table = {
            "observation.state": list(episode.state.astype(np.float32)),
            "action": list(episode.action.astype(np.float32)),
            "timestamp": (np.arange(n) / _FPS).astype(np.float32),
            "frame_index": np.arange(n),
            "episode_index": np.full(n, k),
            "index": start + np.arange(n),
        }
        pq.write_table(pa.table(table), data / f"episode_{k:06d}.parquet")
        lines.append(json.dumps({"episode_index": k, "tasks": ["reach"], "length": n}))
        start += n
    (folder / "meta" / "episodes.jsonl").write_text("\n".join(lines) + "\n")


def score_list(episodes: Sequence[PlantedEpisode], drops: Sequence[Drop], count: int) -> list[str]:
    """Return the precision and recall of each reason as a Markdown section."""
    listed: Mapping[DropReason, set[int]] = {
        reason: {int(drop.id[-6:]) for drop in drops if drop.reason is reason} for reason in DropReason
    }
    rows = []
    for reason in dict.fromkeys(fault for fault in PLANTED if fault):
        planted = {k for k, episode in enumerate(episodes) if episode.fault is reason}
        hits = len(planted & listed[reason])
        rows.append((reason.key, len(planted), len(listed[reason]), hits, len(listed[reason]) - hits))
    clean = {k for k, episode in enumerate(episodes) if episode.fault is None}
    false = len(clean & set().union(*listed.values()))
    table = markdown.table(("reason", "planted", "listed", "right", "wrong"), (list(map(str, row)) for row in rows))
    return [*table, "", f"{false} of {len(clean)} clean episodes are listed, {count} episodes. {machine_text()}"]
