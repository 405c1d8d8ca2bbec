"""`export-commands`: a trajectory's file as commands for the robot."""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from kinebench_drake.errors import UsageError
from kinebench_drake.formats.trajectories.reading import TrajectoryOptions
from kinebench_drake.formats.trajectories.source import find_trajectories, read_trajectory
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.io.jsonl import as_number, as_object
from kinebench_drake.io.npz import open_npz, write_arrays
from kinebench_drake.runs.audit import judge_trajectory
from kinebench_drake.runs.resources import Resources, RobotOptions, load_resources

RATES_HZ = (20.0, 2000.0)
"""Least and greatest rate of commands [Hz]."""


def export_commands(
    source: Path, out: Path, rate_hz: float, options: RobotOptions, choice: TrajectoryOptions
) -> list[str]:
    """Write the commands of a trajectory to an npz or csv file; return lines that prove that it keeps the limits.

    Raises:
        UsageError: an argument cannot be used, or the source does not hold one trajectory.
        InputError: it cannot be read, or no commands keep the limits in the tube about it.
        SetupError: writing failed.
    """
    from kinebench_drake.kinematics.collision import CollisionModel
    from kinebench_drake.kinematics.robot_commands import limit_ratios, plan_commands

    if not RATES_HZ[0] <= rate_hz <= RATES_HZ[1]:
        raise UsageError(
            f"$rate_hz is {rate_hz:g}, expected commands per second from {RATES_HZ[0]:g} to {RATES_HZ[1]:g}"
        )
    tools = load_resources(Resources, options)
    choice = replace(choice, joints=tools.plant.robot.column_names)
    samples = find_trajectories(source, choice)
    if len(samples) > 1:
        names = ", ".join(sample.id for sample in samples[:2])
        raise UsageError(f"{source}: holds {len(samples)} trajectories ({names}, ...), expected one: name its file")
    result = judge_trajectory(tools, read_trajectory(samples[0], choice))
    tube_m = as_number(as_object(result.details["trajopt"])["tube_limit_m"]) or 0.0
    plant = tools.plant
    track = result.track
    collision = CollisionModel(plant, table_height_m=options.table_height_m)
    commands = plan_commands(plant, collision, track, result.joints.q, rate_hz=rate_hz, tube_limit_m=tube_m)
    t_s = np.arange(len(commands.q)) / rate_hz
    if out.suffix.lower() == ".npz":
        write_arrays(out, {"t_s": t_s, **asdict(commands)})
        with open_npz(out) as archive:
            q = np.asarray(archive["q"])
    else:
        head = ",".join(["t_s", *(f"q{j}_rad" for j in range(1, commands.q.shape[1] + 1)), "finger_width_m"])
        rows = np.column_stack([t_s, commands.q, commands.finger_width_m])
        lines = (",".join("" if np.isnan(x) else repr(x) for x in row) for row in rows.tolist())
        write_atomically(out, "\n".join([head, *lines, ""]).encode())
        q = np.loadtxt(out, delimiter=",", skiprows=1, usecols=range(1, commands.q.shape[1] + 1))
    used = (f"{name} {float(ratio.max()):.3f}" for name, ratio in limit_ratios(plant, q, rate_hz))
    return [
        f"{t_s[-1]:.3f} s from rest to rest, {commands.slower:.3g} times as slow as the track of "
        f"{track.t_s[-1] - track.t_s[0]:.3f} s, within {1000.0 * commands.tube_radius_m:.2g} mm of it",
        f"share of the limits used, by finite differences: {', '.join(used)}",
    ]
