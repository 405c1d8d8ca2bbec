"""`kinebench-drake suite run`, `suite report` and `suite plan`."""

from pathlib import Path
from typing import Any

import click

from kinebench_drake.cli.click_options import PathParameter, config_options, echo
from kinebench_drake.cli.outputs import folders_argument
from kinebench_drake.cli.progress import run as carry_out
from kinebench_drake.suites.runs.suite_config import SuiteConfig


@click.command(
    short_help="Run a world model in closed loop.",
    epilog="\b\nExamples:\n"
    "  kinebench-drake suite run --suite 0 --world-model oracle --episodes 5 --out ceiling/ --jobs 2\n"
    "  kinebench-drake suite run --suite 2 --split unseen --world-model http://127.0.0.1:8000 --out looks/\n"
    "  kinebench-drake suite run --suite 1 --world-model folder:videos/ --rounds 1 --out offline/\n"
    "  kinebench-drake suite run --suite 0 --world-model diffusers:wan/ --prompts visual-lock.json --out locked/\n"
    "  kinebench-drake suite run --suite 0 --world-model http://127.0.0.1:8000 --samples 4 --out four/\n"
    "  kinebench-drake suite run --suite 0 --world-model http://127.0.0.1:8000 --condition actions --out obeys/",
)
@config_options(SuiteConfig, omit=("table_height_m",))
@click.pass_context
def run(ctx: click.Context, /, **options: Any) -> None:
    """Run a world model on the episodes of a suite: it generates, the grounding tracks, ManiSkill executes.

    Each episode begins with its seeded scene; after a clip the model is asked again from the last executed frame, until
    the task succeeds or the rounds are used up. --seed is the number of the first of the split's seeds.
    """
    from kinebench_drake.suites.runs.episodes import run_suite

    config = SuiteConfig(**options)
    ctx.exit(carry_out(lambda observer: run_suite(config, observer), config.out))


@click.command(
    short_help="Report on suite runs.",
    epilog="\b\nExamples:\n"
    "  kinebench-drake suite report runs/wan-suite0/ runs/wan-suite2/ --out report/\n"
    "  kinebench-drake suite report scaling/*/ --out report/",
)
@folders_argument
@click.option(
    "--paper",
    is_flag=True,
    help="Only what the KineBench paper shows: success and kinematics by suite and model, their correlation, the loss "
    "from seen to unseen, scaling.",
)
@click.option("--out", type=PathParameter(file_okay=False), required=True, help="Folder to write to.")
def report(folders: tuple[Path, ...], out: Path, paper: bool) -> None:
    """Report on output folders DIR of `suite run`: report.html, figures (png, svg), tables (csv, LaTeX).

    Folders of one model on one suite are pooled, such as shards, unless their tags or settings differ.
    """
    from kinebench_drake.suites.report.suite_page import write_suite_report

    echo(write_suite_report(folders, out, warn=lambda message: echo(f"warning: {message}", err=True), paper=paper))


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
    samples an episode the clips are samples times episodes. Formulas: results/power.py.
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
        paired = design.paired_episodes()
        unpaired = design.unpaired_episodes()
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
