"""`kinebench-drake export-commands`."""

from pathlib import Path
from typing import Any

import click

from kinebench_drake.cli.click_options import PathParameter, check_parent, check_suffix, config_options, echo
from kinebench_drake.runs.audit import AuditConfig

_ROBOT = ("table_height_m", "robot", "limits", "tool", "payload_kg", "obstacles", "package_path")


@click.command(
    epilog=(
        "\b\nExamples:\n"
        "  kinebench-drake export-commands results/tracks/push_0.npz --rate 1000 --out push.npz\n"
        "  kinebench-drake export-commands track.csv --out commands.csv --robot fr3 --obstacles scene.json"
    )
)
@click.argument("source", metavar="TRACK", type=PathParameter())
@click.option(
    "--out", type=PathParameter(dir_okay=False), required=True, metavar="FILE.npz|.csv", help="File of the commands."
)
@click.option(
    "--rate", "rate_hz", type=float, default=1000.0, show_default=True, metavar="HZ", help="Commands per second."
)
@config_options(AuditConfig, "reading", *_ROBOT)
def export_commands(source: Path, out: Path, rate_hz: float, reading: Path | None, **robot: Any) -> None:
    """Write the joint angles with which a robot executes TRACK, from rest to rest and within every limit.

    TRACK is one trajectory as `audit` takes it. Position, speed, acceleration, jerk, torque and torque rate are checked
    by finite differences of what was written. Where no motion in the tube about the track keeps them, a line says why,
    and the exit status is 1.
    """
    from kinebench_drake.formats.trajectories.reading import Reading, TrajectoryOptions
    from kinebench_drake.runs.commands import export_commands
    from kinebench_drake.runs.tools import RobotOptions

    check_suffix("--out", out, ".npz", ".csv")
    check_parent("--out", out)
    choice = TrajectoryOptions(reading=None if reading is None else Reading.parse(reading))
    for line in export_commands(source, out, rate_hz, RobotOptions(**robot), choice):
        echo(line)
