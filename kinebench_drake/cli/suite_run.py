"""`kinebench-drake suite run` and `suite plan`."""

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
    "  kinebench-drake suite run --suite 0 --world-model diffusers:wan/ --prompt-preset visual-lock --out locked/\n"
    "  kinebench-drake suite run --suite 0 --world-model http://127.0.0.1:8000 --samples 4 --out four/\n"
    "  kinebench-drake suite run --suite 0 --world-model http://127.0.0.1:8000 --condition actions --out obeys/",
)
@suite_options()
@variant_option
@click.option(
    "--world-model", required=True, metavar="SPEC",
    help="World model: folder:DIR, http://..., command:..., dashscope:, minimax:, diffusers:..., oracle, still, "
    "random, module:Class (docs/worldmodels.md).",
)  # fmt: skip
@click.option(
    "--samples", type=click.IntRange(1), default=1, show_default=True, metavar="K",
    help="Closed loops of each episode, each with another seed of the world model.",
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
@click.option(
    "--condition", type=click.Choice(["none", "actions"]), default="none", show_default=True,
    help="State the expert's track in requests, for action-conditioned models, and measure how far videos follow it.",
)  # fmt: skip
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
    from kinebench_drake.runs.suite import run_suite, suite_config

    config = suite_config(number, **options)
    ctx.exit(carry_out(lambda observer: run_suite(config, observer), config.out))


def _numbers(ctx: click.Context, param: click.Parameter, text: str) -> list[int]:
    try:
        numbers = [int(part) for part in text.split(",")]
    except ValueError:
        numbers = [0]
    if min(numbers) < 1:
        raise click.BadParameter(f"{text!r} is not a list of whole numbers from 1, such as 1,2,4", ctx, param)
    return numbers


@click.command(
    short_help="Episodes needed to see a difference.",
    epilog="\b\nExamples:\n"
    "  kinebench-drake suite plan --difference 10\n"
    "  kinebench-drake suite plan --difference 10 --success 40 --correlation 0.4\n"
    "  kinebench-drake suite plan --difference 5 --success 70 --samples 1,4,16 --icc 0.6 --correlation 0.4",
)
@click.option(
    "--difference", type=float, required=True, metavar="POINTS", help="Difference of the two success rates to detect."
)
@click.option("--success", type=float, default=50.0, show_default=True, metavar="PERCENT", help="Lower success rate.")
@click.option(
    "--samples", callback=_numbers, default="1,2,4,8", show_default=True, metavar="A,B", help="Samples of each episode."
)
@click.option(
    "--correlation", type=float, default=0.0, show_default=True, metavar="R",
    help="Correlation of the outcomes of the two models in the same episode.",
)  # fmt: skip
@click.option(
    "--icc", type=float, default=0.5, show_default=True, metavar="R",
    help="Correlation of the outcomes of two samples of one model in the same episode.",
)  # fmt: skip
@click.option("--power", type=float, default=80.0, show_default=True, metavar="PERCENT", help="Probability to detect.")
def plan(difference: float, success: float, samples: list[int], correlation: float, icc: float, power: float) -> None:
    """Compute how many episodes detect a difference of success rates between two models (two-sided, p < 0.05).

    Paired: both models do the same episodes, and `compare` tests them. Unpaired: each model does other ones. Of several
    samples an episode the clips are samples times episodes. Formulas: docs/closedloop.md.
    """
    from kinebench_drake.report.table import Table, plain_columns, table_lines
    from kinebench_drake.results.power import PowerDesign

    rows = []
    for count in samples:
        design = PowerDesign(
            success=success / 100,
            difference=difference / 100,
            samples=count,
            correlation=correlation,
            icc=icc,
            power=power / 100,
        )
        paired, unpaired = design.paired_episodes(), design.unpaired_episodes()
        rows.append((count, paired, paired * count, unpaired, unpaired * count))
    columns = plain_columns(
        samples="Samples an episode", paired="Episodes, paired", paired_clips="Clips of each model",
        unpaired="Episodes, unpaired", unpaired_clips="Clips of each model",
    )  # fmt: skip
    click.echo(
        f"success {success:g} % and {success + difference:g} %, power {power:g} %; correlation in an episode: "
        f"{correlation:g} between the models, {icc:g} between samples of one model"
    )
    for line in table_lines(Table(name="plan", title="Episodes", note="", columns=columns, rows=tuple(rows))):
        click.echo(line)
