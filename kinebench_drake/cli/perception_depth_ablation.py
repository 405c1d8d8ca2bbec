"""`kinebench-drake perception depth-ablation`."""

from pathlib import Path

import click

from kinebench_drake.cli.perception_evaluate import Measuring, check_figure, measuring, write_json

_TERMS = """\b
scale         a whole video too far or too near by so much
smooth error  errors that vary over picture and time, root mean square
noise         each cell by itself, standard deviation

"""
"""What the words of the table mean."""


@click.command(
    "depth-ablation",
    epilog=_TERMS + "\b\nExample:\n"
    "  kinebench-drake perception depth-ablation heldout --json depth.json --figure depth.png --heatmap map.png",
)
@measuring
@click.option(
    "--depth",
    "plug_ins",
    multiple=True,
    metavar="moge:CHECKPOINT|module:Class",
    help="Another estimator: MoGe-2, or a class of yours; repeatable.",
)
@click.option(
    "--heatmap", type=click.Path(path_type=Path, dir_okay=False),
    help="Draw where on the gripper the estimated depth errs, and one frame of it (png).",
)  # fmt: skip
def depth_ablation(
    order: Measuring,
    plug_ins: tuple[str, ...],
    heatmap: Path | None,
) -> None:
    """Say what depth is worth: true depth, our estimate, our estimate made worse, other estimators.

    FOLDER is what `suite demos --with-depth` writes.
    """
    from kinebench_drake.drawing import save
    from kinebench_drake.grounding.evaluation import study
    from kinebench_drake.grounding.evaluation.depth_figure import draw_depth
    from kinebench_drake.grounding.evaluation.depth_map import measure_depth
    from kinebench_drake.grounding.evaluation.variants import Tools

    check_figure(heatmap)
    outcome = order.compare(study.depth_ablation(plug_ins))
    clips = study.Plan(folder=order.folder, limit=order.limit).clips()
    errors = measure_depth(clips, Tools.load(order.weights).estimator)
    told = {}
    if errors is not None:
        told = {"median": errors.median, "p95": errors.p95, "common_error_median": errors.level_median}
        click.echo(
            f"relative depth error of our estimate on the gripper: median {errors.median:.2%}, 95 % {errors.p95:.2%}; "
            f"common to a frame: median {errors.level_median:.2%}"
        )
    write_json(order.json_out, {**outcome.to_json(), "relative_depth_error": told})
    if heatmap and errors is not None:
        save(draw_depth(errors, "our estimate"), heatmap)
