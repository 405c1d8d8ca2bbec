"""Actions from video: the tracks of a run as a LeRobot dataset, or as the joint angles that RoboWM-Bench executes.

Frames without joint angles hold the values of the frame before (LeRobot: `usable` is false for their actions) or lie
between those of the frames around (RoboWM-Bench, which has no place for a mask). So do gaps between the pads, of which
`gripper_known` tells; one that is never seen is open.
"""

import json
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import UsageError
from kinebench_drake.formats.folders import is_output
from kinebench_drake.formats.lerobot import writer as lerobot
from kinebench_drake.formats.videos.sample import VideoSample
from kinebench_drake.geometry import Array, rotation_log
from kinebench_drake.io.atomic import remove, write_atomically
from kinebench_drake.io.jsonl import write_lines
from kinebench_drake.io.reader import read_video
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.results.store import artifact_path
from kinebench_drake.results.trackfile import read_track
from kinebench_drake.runs.config import ActionFileFormat
from kinebench_drake.track import MAX_WIDTH_M

_WHOLE = 0.01
"""Greatest relative distance of a frame rate from a whole number, and of one episode's from another's."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _ExportedMotion:
    """Motion of one video."""

    sample: VideoSample
    t_s: Array
    q: Array
    """(T, 7) joint angles [rad]; NaN where unknown."""
    width_m: Array
    """(T,) gap between the pads [m]; NaN where unknown."""
    X_BG: Array
    """(T, 4, 4) TCP in the robot base frame [m]; NaN where unknown."""
    confidence: Array

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(T,) frames with joint angles and a pose."""
        numbers = np.column_stack([self.q, self.X_BG.reshape(-1, 16)])
        return np.asarray(np.isfinite(numbers).all(axis=1))

    @property
    def period_s(self) -> float:
        """Task time between two frames [s]."""
        return float(np.median(np.diff(self.t_s)))


def require_own_folder(format: ActionFileFormat, out: Path) -> None:
    """Check that the folder of the actions in an output folder is free, or of an earlier run: it is written anew.

    Raises:
        UsageError: it is a link, or holds what no run wrote.
    """
    folder = out / format.folder
    if folder.is_symlink() or (folder.exists() and not is_output(out)):
        raise UsageError(f"$out {out}: {format.folder} is there already, but no run wrote it; name another folder")


def write_actions(
    format: ActionFileFormat,
    out: Path,
    samples: Sequence[VideoSample],
    rows: Sequence[SampleRow],
    warn: Callable[[str], None],
) -> Path:
    """Write the actions of all measured videos of an output folder, and return the folder with them."""
    folder = out / format.folder
    remove(folder)
    motions = _read_motions(out, {sample.id: sample for sample in samples}, rows, warn)
    if format is ActionFileFormat.ROBOWM:
        _write_robowm(folder, motions)
    else:
        with tempfile.TemporaryDirectory(dir=out, prefix=".parts-") as parts:
            _write_lerobot(folder, Path(parts), motions, warn)
    return folder


def _read_motions(
    out: Path, samples: Mapping[str, VideoSample], rows: Sequence[SampleRow], warn: Callable[[str], None]
) -> Iterator[_ExportedMotion]:
    """Read the tracks of an output folder; `warn` of those of which no frame is known."""
    for row in rows:
        if row.status is not Status.OK or row.id not in samples:
            continue
        file = read_track(artifact_path(out, "tracks", row.id))
        track = file.track
        q = np.where((file.ik_ok & track.tracked)[:, None], file.q, np.nan)
        motion = _ExportedMotion(
            sample=samples[row.id],
            t_s=track.t_s,
            q=q,
            width_m=track.finger_width_m,
            X_BG=np.where(track.tracked[:, None, None], track.X_BG, np.nan),
            confidence=track.confidence,
        )
        if motion.valid.sum() < 2:
            warn(f"{row.id} has no actions: fewer than two frames have joint angles")
        else:
            yield motion


def _write_robowm(folder: Path, motions: Iterator[_ExportedMotion]) -> None:
    """Write numbered files with a line `[q1, ..., q7, f, f]` per command: joint angles [rad], finger joints [m]."""
    episodes = []
    for number, motion in enumerate(motions):
        valid = motion.valid
        measured = np.isfinite(motion.width_m)
        # 20 Hz: rate of RoboWM-Bench's commands (https://github.com/fffstrong/RoboWM-Bench,
        # scripts/robot/eval_franka.py)
        times = np.arange(0.0, motion.t_s[-1] + 1e-6, 1.0 / 20.0)
        angles = [np.interp(times, motion.t_s[valid], x) for x in motion.q[valid].T]
        width_m = np.full(len(times), MAX_WIDTH_M)
        if measured.any():
            width_m = np.interp(times, motion.t_s[measured], motion.width_m[measured])
        commands = np.column_stack([*angles, 0.5 * width_m, 0.5 * width_m]).round(6).tolist()
        text = "".join(f"{json.dumps(command)}\n" for command in commands)
        write_atomically(folder / f"{number}.json", text.encode())
        filled = {"interpolated": int((~valid).sum()), "gripper_unknown": int((~measured).sum())}
        episodes.append({"file": f"{number}.json", "id": motion.sample.id, "frames": len(valid), **filled})
    write_lines(folder / "episodes.jsonl", episodes)
    write_atomically(folder / "file_indices.txt", "".join(f"{k}\n" for k in range(len(episodes))).encode())


def _write_lerobot(folder: Path, parts: Path, motions: Iterator[_ExportedMotion], warn: Callable[[str], None]) -> None:
    prompts: dict[str, str] = {}
    fps = 0.0
    size = (0, 0)
    for motion in motions:
        sample = motion.sample
        rate = 1.0 / motion.period_s
        video = read_video(sample.path, sample.part)
        if not prompts:
            fps = float(max(round(rate), 1))
            size = (video.width, video.height)
        if abs(rate / fps - 1.0) > _WHOLE and not prompts:
            raise UsageError(
                f"{sample.id}: {rate:.4g} frames per second of task time, LeRobot asks for a whole number: give "
                "$frame_period_s, such as 0.2"
            )
        if abs(rate / fps - 1.0) > _WHOLE or (video.width, video.height) != size:
            warn(
                f"{sample.id} is left out: {video.width} x {video.height} px at {rate:.4g} frames per second, the "
                f"dataset has {size[0]} x {size[1]} px at {fps:g}"
            )
            continue
        chosen = np.linspace(0, len(video.frames) - 1, len(motion.t_s)).round().astype(int)
        lerobot.write_part(parts, sample.id, video.frames[chosen], _columns(motion), fps=fps, crf=18)
        prompts[sample.id] = sample.prompt or sample.task or ""
    if prompts:
        lerobot.join_parts(folder, parts, prompts, fps, None, size=size, features=lerobot.ESTIMATES)


def _columns(motion: _ExportedMotion) -> dict[str, NDArray[np.generic]]:
    """Return the columns of an episode: the action of a frame is the state of the next one, of the last its own."""
    valid = motion.valid
    measured = np.isfinite(motion.width_m)
    n = len(motion.t_s)
    source = _last_valid(valid)
    after = np.minimum(np.arange(n) + 1, n - 1)
    width = motion.width_m[_last_valid(measured)] if measured.any() else np.full(n, MAX_WIDTH_M)
    state = np.column_stack([motion.q[source], width])
    X_BG = motion.X_BG[source]
    pose = lerobot.pose_columns(X_BG)
    turns = rotation_log(X_BG[after, :3, :3] @ np.swapaxes(X_BG[:, :3, :3], 1, 2))
    usable = valid & np.append(valid[1:], False)
    return {
        lerobot.STATE: state,
        lerobot.POSE: pose,
        lerobot.ACTION: state[after],
        lerobot.POSE_ACTION: np.column_stack([pose[after], width[after]]),
        lerobot.DELTA_ACTION: np.column_stack([X_BG[after, :3, 3] - X_BG[:, :3, 3], turns, width[after]]),
        lerobot.CONFIDENCE: np.where(valid, motion.confidence, 0.0),
        lerobot.USABLE: usable,
        lerobot.GRIPPER_KNOWN: measured & measured[after],
    }


def _last_valid(valid: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return for each frame the last known one until it, before the first known one that."""
    frames = np.flatnonzero(valid)
    return frames[np.clip(np.searchsorted(frames, np.arange(len(valid)), side="right") - 1, 0, None)]
