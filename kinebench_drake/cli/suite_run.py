"""`kinebench-drake suite run`."""

from typing import Any

import click

from kinebench_drake.cli.options import (
    clip_timing_option,
    prompt_options,
    replays_option,
    run_options,
    suite_options,
    variant_option,
)
from kinebench_drake.cli.run import run as carry_out
from kinebench_drake.suites.clock import FRAME_PERIOD_S, MAX_FRAME_PERIOD_S, MIN_FRAME_PERIOD_S


@click.command(
    short_help="Run a world model in closed loop.",
    epilog="\b\nExamples:\n"
    "  kinebench-drake suite run --suite 0 --world-model oracle --episodes 5 --out ceiling/ --jobs 2\n"
    "  kinebench-drake suite run --suite 2 --split unseen --world-model http://127.0.0.1:8000 --out looks/\n"
    "  kinebench-drake suite run --suite 1 --world-model folder:videos/ --rounds 1 --out offline/\n"
    "  kinebench-drake suite run --suite 0 --world-model diffusers:wan/ --prompt-preset visual-lock --out locked/",
)
@suite_options()
@variant_option
@click.option(
    "--world-model", required=True, metavar="SPEC",
    help="World model: folder:DIR, http://..., command:..., dashscope:, minimax:, diffusers:..., oracle, still, "
    "random, module:Class (docs/worldmodels.md).",
)  # fmt: skip
@click.option(
    "--rounds", type=click.IntRange(1), default=3, show_default=True, help="Largest number of clips per episode."
)
@click.option(
    "--control", type=click.Choice(["pd_joint_pos", "pd_ee_pose"]), default="pd_joint_pos", show_default=True,
    help="Commands of the robot: joint angles from Drake, or poses.",
)  # fmt: skip
@click.option(
    "--action-repeat", type=click.IntRange(1), metavar="N",
    help="Control steps (at 20 Hz) per frame.  [default: by the duration of frames]",
)  # fmt: skip
@click.option(
    "--frame-period", "frame_period_s", type=click.FloatRange(MIN_FRAME_PERIOD_S, MAX_FRAME_PERIOD_S),
    default=FRAME_PERIOD_S, show_default=True,
    help="Task time between two frames.", metavar="SECONDS",
)  # fmt: skip
@clip_timing_option(
    "Frames of a clip: evenly over the 48 frame periods that were requested, or one frame period apart.  "
    "[default: uniform for models that choose the number of frames (folder, services, diffusers with frames=), else "
    "native]"
)
@click.option("--pixels-only", is_flag=True, help="Do not use the robot's own pose as a prior for first frames.")
@click.option(
    "--rollouts/--no-rollouts", default=True, show_default=True,
    help="Write videos of the generated and executed motion side by side.",
)  # fmt: skip
@prompt_options
@replays_option
@run_options
@click.pass_context
def run(ctx: click.Context, /, number: int, **options: Any) -> None:
    """Run a world model on the episodes of a suite: it generates, the grounding tracks, ManiSkill executes.

    Each episode begins with its seeded scene; after a clip the model is asked again from the last executed frame, until
    the task succeeds or the rounds are used up. --seed is the number of the first of the split's seeds.
    """
    from kinebench_drake.evaluation.suite import run_suite, suite_config

    config = suite_config(number, **options)
    ctx.exit(carry_out(lambda observer: run_suite(config, observer), config.out))
