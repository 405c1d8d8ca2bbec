"""Exported commands of many tracks against the robot's limits, by finite differences of the files."""

from collections import Counter
from pathlib import Path

import numpy as np

from benchmarks import markdown
from benchmarks.feasible import TrackSet, smooth_motions
from benchmarks.motion import Arm
from benchmarks.record import machine_text
from kinebench_drake.errors import KinebenchError
from kinebench_drake.formats.trajectories.reading import TrajectoryOptions
from kinebench_drake.io.npz import write_arrays
from kinebench_drake.runs.command_export import export_commands
from kinebench_drake.runs.resources import RobotOptions

_PERIODS_S = {"own speed": 0.05, "3 times as fast": 0.05 / 3.0, "poses": 0.05}
_FRAMES = 120
_RATE_HZ = 1000.0


def export_all(folder: Path, count: int, seed: int) -> list[str]:
    """Export `count` tracks, a third each as they are, faster and as poses, and return the shares used as a section."""
    rng = np.random.default_rng(seed)
    arm = Arm()
    limits = arm.plant.robot.limits
    acceleration, jerk, torque_rate = (
        np.asarray(limit, dtype=np.float64) for limit in (limits.acceleration, limits.jerk, limits.torque_rate)
    )
    lines = []
    reasons = Counter[str]()
    written: dict[str, list[list[float]]] = {kind: [] for kind in _PERIODS_S}
    slower: dict[str, list[float]] = {kind: [] for kind in _PERIODS_S}
    tracks = TrackSet(tracks=count, frames=_FRAMES, period_s=0.05)
    for k, (motion, t_s) in enumerate(smooth_motions(rng, arm, tracks)):
        kind = list(_PERIODS_S)[k % len(_PERIODS_S)]
        q = motion.q(t_s)
        width = motion.width(t_s)
        times = _PERIODS_S[kind] * np.arange(_FRAMES)
        source = folder / f"{k}.npz"
        out = folder / f"{k}-commands.npz"
        content = {"base_from_tcp": arm.plant.forward_path(q)} if kind == "poses" else {"q": q}
        write_arrays(source, {"t_s": times, "finger_width_m": width, **content})
        try:
            export_commands(source, out, _RATE_HZ, RobotOptions(), TrajectoryOptions())
        except KinebenchError as error:
            reasons[str(error).split(";")[-1].split(" of ")[0].strip()] += 1
            continue
        with np.load(out) as archive:
            commands = archive["q"]
            slower[kind].append(float(archive["slower"]))
        rest = np.concatenate([np.repeat(commands[:1], 3, axis=0), commands, np.repeat(commands[-1:], 3, axis=0)])
        middle = 0.5 * (limits.upper + limits.lower)
        half = 0.5 * (limits.upper - limits.lower)
        v = np.gradient(rest, 1.0 / _RATE_HZ, axis=0)
        a = np.diff(rest, 2, axis=0) * _RATE_HZ**2
        torque = arm.plant.chain.torques(rest[1:-1], v[1:-1], a)
        used = [
            np.abs(rest - middle) / half,
            np.abs(np.diff(rest, axis=0)) * _RATE_HZ / limits.velocity,
            np.abs(a) / acceleration,
            np.abs(np.diff(rest, 3, axis=0)) * _RATE_HZ**3 / jerk,
            np.abs(torque) / limits.torque,
            np.abs(np.diff(torque, axis=0)) * _RATE_HZ / torque_rate,
        ]
        written[kind].append([float(ratio.max()) for ratio in used])
    head = ("tracks", "exported", "slower", "position", "velocity", "acceleration", "jerk", "torque", "torque rate")
    for kind, rows in written.items():
        most = np.max(rows, axis=0) if rows else np.full(6, np.nan)
        median = f"{np.median(slower[kind]):.2f}" if rows else "-"
        lines.append([kind, str(len(rows)), median, *(f"{value:.3f}" for value in most)])
    why = "; ".join(f"{n} x {reason}" for reason, n in reasons.most_common())
    total = sum(len(rows) for rows in written.values())
    note = f"{total} of {count} exported; the others: {why or 'none'}. {machine_text()}"
    return [*markdown.table(head, lines), "", note]
