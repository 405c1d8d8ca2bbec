"""Following of a world model that is conditioned on actions, with planted faults.

The painter of examples/worldmodel draws a video from pose numbers, so a clip can be drawn from other joint angles than
those that it is asked for: late ones, motions too small or too large, a drift. The exact poses of the TCP are those of
the joint angles that were drawn.
"""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from scipy.stats import spearmanr

from benchmarks.markdown import table
from examples.worldmodel.generator import Generator
from examples.worldmodel.pack import measure_pose, read_video
from kinebench_drake.geometry import Array, invert, pose_difference
from kinebench_drake.io.container import write_video
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.metrics.following import PoseSeries, measure_following
from kinebench_drake.models.panda.description import hand_from_tcp
from kinebench_drake.results.store import artifact_path, read_rows
from kinebench_drake.results.trackfile import read_track
from kinebench_drake.runs.config import FollowConfig
from kinebench_drake.runs.follow import follow_videos

CLIP = "StackCube-v1_s0010_unseen"
"""Example video whose first frame and motion are drawn; the painter has learned its task."""
PERIOD_S = 0.2
DRIFT_M = 0.02
DRIFT_FRAME = 24


def plan_motions(q: Array, plant: ArmPlant) -> dict[str, Array]:
    """Return the joint angles (T, 7) [rad] of each planted fault of a motion, by name."""
    frames = np.arange(len(q))
    motions = {f"lag {k}": q[np.maximum(frames - k, 0)] for k in (0, 1, 2, 4)}
    motions |= {f"gain {gain:g}": q[0] + gain * (q - q[0]) for gain in (0.5, 0.8, 1.2)}
    drift = q.copy()
    for k in range(DRIFT_FRAME, len(q)):
        drift[k] += np.linalg.pinv(plant.jacobian(q[k])) @ [0, 0, 0, 0, DRIFT_M, 0]
    return {**motions, "drift": drift, "still": np.repeat(q[:1], len(q), axis=0), "reversed": q[::-1]}


def draw_clips(videos: Path, weights: Path, work: Path) -> dict[str, Array]:
    """Draw the clips that a folder lacks, one of each planted fault, with its actions; return the exact poses [m]."""
    plant = ArmPlant()
    camera = json.loads((videos / "camera.json").read_text())
    truth = dict(np.load(videos / "truth" / f"{CLIP}.npz"))
    first = read_video(videos / f"{CLIP}.mp4")[0]
    painter = Generator(weights)
    exact = {}
    work.mkdir(parents=True, exist_ok=True)
    (work / "camera.json").write_text(json.dumps(camera))
    for name, q in plan_motions(truth["q"], plant).items():
        id = name.replace(" ", "-")
        exact[id] = plant.forward_path(q)
        X_CH = np.linalg.inv(np.array(camera["base_from_camera"])) @ exact[id] @ invert(hand_from_tcp())
        poses = measure_pose(camera, {**truth, "q": q, "camera_from_hand": X_CH}, plant)
        start = measure_pose(camera, truth, plant)[:1]
        if not (work / f"{id}.mp4").exists():  # painting takes longest
            write_video(work / f"{id}.mp4", painter.paint(first, torch.tensor(np.concatenate([start, poses[1:]]))), 5)
        np.savez(work / f"{id}.npz", q=truth["q"], finger_width_m=truth["finger_width_m"])
    return exact


def measure_planted(videos: Path, weights: Path, work: Path, out: Path) -> Iterator[str]:
    """Draw the clips, compare them with their actions, and yield a table of measured beside exact values."""
    exact = draw_clips(videos, weights, work)
    follow_videos(FollowConfig(source=work, actions=work, out=out, frame_period_s=PERIOD_S, replays=None))
    rows = read_rows(out)
    lines = []
    pairs = []
    for id, X_BG in exact.items():
        true = measure_following(_series(X_BG), _series(exact["lag-0"]), np.random.default_rng(0))
        row = rows[id]
        deviations = (row.deviation_m, true.median("distance_m"))
        error = pose_difference(read_track(artifact_path(out, "tracks", id)).track.X_BG, X_BG)[0]
        pairs.append(deviations)
        cells = (
            str(row.follows).lower(),
            _pair(row.lag_frames, true.lag_frames),
            _pair(row.gain, true.gain),
            _pair(row.drift_from_frame, true.drift_from_frame),
            _pair(*(_mm(value) for value in deviations)),
            _pair(_mm(row.drift_m), _mm(true.drift_m)),
            f"{1e3 * np.nanmedian(error):.1f}",
        )
        lines.append((id, *cells))
    head = [
        "planted",
        "follows",
        "lag",
        "gain",
        "drift from frame",
        "deviation [mm]",
        "drift [mm]",
        "error of track [mm]",
    ]
    yield from table(head, lines)
    measured = [p for p in pairs if None not in p]
    yield ""
    rank = spearmanr(*zip(*measured, strict=True))[0]
    yield f"Rank correlation of the deviations of {len(measured)} clips: {rank:.2f}"


def _series(X_BG: Array) -> PoseSeries:
    n = len(X_BG)
    return PoseSeries(t_s=PERIOD_S * np.arange(n, dtype=np.float64), X=X_BG, finger_width_m=np.full(n, np.nan))


def _mm(value: float | None) -> float | None:
    return None if value is None else round(1e3 * float(value), 1)


def _pair(measured: float | None, true: float | None) -> str:
    """Return a measured value and the exact one."""
    return " / ".join("-" if value is None else f"{round(value, 3):.3g}" for value in (measured, true))
