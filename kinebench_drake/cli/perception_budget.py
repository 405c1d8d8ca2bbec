"""`kinebench-drake perception budget`."""

from pathlib import Path

import click

from kinebench_drake.cli.perception_evaluate import carry_out, check_figure, measuring, write_json


@click.command(
    epilog="\b\nExample:\n  kinebench-drake perception budget heldout --json budget.json --figure budget.png --jobs 2"
)
@measuring
def budget(
    folder: Path,
    weights: Path | None,
    limit: int | None,
    jobs: int,
    seed: int,
    json_out: Path | None,
    overwrite: bool,
    figure: Path | None,
) -> None:
    """Say which stage owes what of the error: true values put in one at a time, and all together.

    FOLDER is what `suite demos --with-depth` writes.
    """
    from kinebench_drake.grounding.evaluation import study
    from kinebench_drake.grounding.evaluation.figures import draw_comparison, save

    check_figure(figure)
    outcome = carry_out(study.budget(), folder, weights, limit, jobs, seed, json_out, overwrite)
    for line in outcome.lines():
        click.echo(line)
    write_json(json_out, outcome.to_json())
    if figure:
        save(draw_comparison(outcome.results, outcome.figures, outcome.study.groups, outcome.study.title), figure)
