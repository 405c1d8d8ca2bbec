"""`kinebench-drake audit`."""

from typing import Any

import click

from kinebench_drake.cli.options import PathParameter, judging_options, sample_options


@click.command(
    epilog=(
        "\b\nExamples:\n"
        "  kinebench-drake audit track.npz --out results/\n"
        "  kinebench-drake audit demos/trajectory.h5 --out results/ --jobs 4\n"
        "  kinebench-drake audit dataset/ --out results/ --joints observation.state\n"
        "  kinebench-drake audit score-results/ --out results/ --table-height -0.02\n"
        "  kinebench-drake audit track.csv --out results/ --robot arm.urdf --tcp-frame tool0"
    )
)
@click.argument("source", metavar="PATH", type=PathParameter())
@sample_options
@click.option(
    "--rate",
    "rate_hz",
    type=float,
    help="Frames per second, in place of the times of the files (t_s = k / rate).",
    metavar="HZ",
)
@judging_options
@click.option(
    "--robot",
    "urdf",
    type=PathParameter(),
    help="URDF of a seven-joint arm, with --tcp-frame.  [default: mani_skill's Franka Panda]",
    metavar="URDF",
)
@click.option("--tcp-frame", help="TCP frame of the URDF.  [default: panda_hand_tcp]", metavar="NAME")
@click.option("--joints", help="Array (npz), data set (h5) or column (LeRobot) of the joint angles.", metavar="COLUMN")
@click.option("--poses", help="Array (npz) or column (LeRobot) of the TCP poses.", metavar="COLUMN")
@click.pass_context
def audit(ctx: click.Context, /, **options: Any) -> None:
    """Check the trajectories of PATH: whether and how well the robot executes each, and if not, why not.

    PATH is an npz file (t_s with base_from_tcp or q), a csv file (t_s,x_m,y_m,z_m,qw,qx,qy,qz or t_s,q1_rad..q7_rad),
    a ManiSkill trajectory (.h5, its .json beside it), a LeRobot dataset (v2 or v3), an output folder of score or ground
    or its tracks/, or a folder of these. Joint angles are judged as recorded; poses are infeasible only if no joint
    path follows them. Lengths are metres, angles radians, poses those of the TCP in the robot's base frame.
    """
    from kinebench_drake.cli.run import run
    from kinebench_drake.runs.audit import AuditConfig, audit_trajectories

    config = AuditConfig(**options)
    ctx.exit(run(lambda observer: audit_trajectories(config, observer), config.out))
