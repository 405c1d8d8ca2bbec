"""`export-commands`: a trajectory's file as commands for the robot."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinebench_drake.errors import UsageError
from kinebench_drake.formats.trajectories.reading import TrajectoryOptions
from kinebench_drake.formats.trajectories.source import find_trajectories, read_trajectory
from kinebench_drake.geometry import Array
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.io.jsonl import as_number, as_object
from kinebench_drake.io.npz import open_npz, write_arrays
from kinebench_drake.runs.audit import judge_trajectory
from kinebench_drake.runs.tools import RobotOptions, Tools, load_tools

RATES_HZ = (20.0, 2000.0)
"""Least and greatest rate of commands [Hz]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandProof:
    """What a file of commands was found to hold, read again."""

    duration_s: float
    """Duration of the commands [s]."""
    track_s: float
    """Duration of the track [s]."""
    slower: float
    """Factor by which they are slower than the track, apart from the ramps from and to rest."""
    ratios: Mapping[str, Array]
    """(7,) greatest value / limit by the kind of limit, of finite differences."""
    tube_m: float
    """Radius of the tube about the track that contains the motion [m]."""

    def lines(self) -> Iterator[str]:
        """Describe the proof."""
        yield (
            f"{self.duration_s:.3f} s, the track lasts {self.track_s:.3f} s: {self.slower:.3g} times as slow, and from "
            f"and to rest; within {1000.0 * self.tube_m:.2g} mm of the track"
        )
        used = ", ".join(f"{name} {float(ratio.max()):.3f}" for name, ratio in self.ratios.items())
        yield f"share of the limits used, by finite differences: {used}"


def export_commands(
    source: Path, out: Path, rate_hz: float, options: RobotOptions, choice: TrajectoryOptions
) -> CommandProof:
    """Write the commands of a trajectory to an npz or csv file and prove that they keep the limits.

    Raises:
        UsageError: an argument cannot be used, or the source does not hold one trajectory.
        InputError: it cannot be read, or no commands keep the limits in the tube about it.
        SetupError: writing failed.
    """
    from kinebench_drake.kinematics.collision import CollisionModel
    from kinebench_drake.kinematics.commands import limit_ratios, plan_commands
    from kinebench_drake.kinematics.plant import ArmPlant

    if not RATES_HZ[0] <= rate_hz <= RATES_HZ[1]:
        raise UsageError(
            f"$rate_hz is {rate_hz:g}, expected commands per second from {RATES_HZ[0]:g} to {RATES_HZ[1]:g}"
        )
    samples = find_trajectories(source, choice)
    if len(samples) > 1:
        names = ", ".join(sample.id for sample in samples[:2])
        raise UsageError(f"{source}: holds {len(samples)} trajectories ({names}, ...), expected one: name its file")
    trajectory = read_trajectory(samples[0], choice)
    result = judge_trajectory(load_tools(Tools, options), trajectory)
    track, plant = result.track, ArmPlant(options.load())
    commands = plan_commands(
        plant,
        CollisionModel(plant, table_height_m=options.table_height_m),
        track.t_s,
        np.where(track.tracked[:, None, None], track.X_BG, np.nan),
        result.joints.q,
        track.finger_width_m,
        rate_hz=rate_hz,
        tube_limit_m=as_number(as_object(result.details["trajopt"])["tube_limit_m"]) or 0.0,
    )
    t_s = np.arange(len(commands.q)) / rate_hz
    arrays = {"t_s": t_s, "q": commands.q, "finger_width_m": commands.finger_width_m, "frame_t_s": commands.frame_t_s}
    if out.suffix.lower() == ".npz":
        write_arrays(out, arrays)
        with open_npz(out) as archive:
            q = np.asarray(archive["q"])
    else:
        head = ",".join(["t_s", *(f"q{j}_rad" for j in range(1, 8)), "finger_width_m"])
        rows = np.column_stack([t_s, commands.q, commands.finger_width_m])
        lines = (",".join("" if np.isnan(x) else repr(x) for x in row) for row in rows.tolist())
        write_atomically(out, "\n".join([head, *lines, ""]).encode())
        q = np.loadtxt(out, delimiter=",", skiprows=1, usecols=range(1, 8))
    return CommandProof(
        duration_s=float(t_s[-1]),
        track_s=float(track.t_s[-1] - track.t_s[0]),
        slower=commands.slower,
        ratios=dict(limit_ratios(plant, q, rate_hz)),
        tube_m=commands.tube.radius_m or 0.0,
    )
