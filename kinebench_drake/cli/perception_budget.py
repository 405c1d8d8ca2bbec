"""`kinebench-drake perception budget`."""

import click

from kinebench_drake.cli.perception_evaluate import Measuring, measuring, write_json


@click.command(
    epilog="\b\nExample:\n  kinebench-drake perception budget heldout --json budget.json --figure budget.png --jobs 2"
)
@measuring
def budget(order: Measuring) -> None:
    """Say which stage owes what of the error: true values put in one at a time, and all together.

    FOLDER is what `suite demos --with-depth` writes.
    """
    from kinebench_drake.grounding.evaluation import study

    write_json(order.json_out, order.compare(study.budget()).to_json())
