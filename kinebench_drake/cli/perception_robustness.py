"""`kinebench-drake perception robustness`."""

from pathlib import Path

import click

from kinebench_drake.cli.perception_evaluate import Measuring, check_figure, measuring, write_json

_KINDS = ("deformation", "occlusion", "contrast", "motion-blur", "noise", "h264", "latent", "ghosting")


_TERMS = """\b
deformation  the gripper warped by so many px (root mean square over it), in ways that no rigid motion explains
occlusion    textured shapes that drift over it and hide so much of what is seen of it
contrast     so much of it lost
motion-blur  the picture smeared over so many px along the gripper's motion
noise        Gaussian noise of so many levels of 255
h264         coded by x264 at this constant rate factor
latent       of so many numbers one kept: the greatest coefficients of 4 x 8 x 8 blocks, as a video model's
             autoencoder would
ghosting     the two frames before shine through with this weight

"""
"""What the words of the table mean."""


@click.command(
    epilog=_TERMS
    + "\b\nExample:\n  kinebench-drake perception robustness heldout --json robust.json --figure robust.png"
)
@measuring
@click.option("--only", default=",".join(_KINDS), show_default=True, help="Kinds of perturbations, comma-separated.")
@click.option(
    "--sheet", type=click.Path(path_type=Path, dir_okay=False),
    help="Draw a frame of the first video under each perturbation (png).",
)  # fmt: skip
def robustness(
    order: Measuring,
    only: str,
    sheet: Path | None,
) -> None:
    """Measure the same videos with perturbed frames: how errors and tracking bear it."""
    from kinebench_drake.drawing import save
    from kinebench_drake.grounding.evaluation import study
    from kinebench_drake.grounding.evaluation.figures import draw_sheet
    from kinebench_drake.grounding.evaluation.perturbation.catalogue import Kind
    from kinebench_drake.grounding.evaluation.sheet import sheet_of

    check_figure(sheet)
    try:
        kinds = [Kind(name.strip()) for name in only.split(",")]
    except ValueError:
        raise click.BadParameter(f"{only!r}; there are {', '.join(_KINDS)}", param_hint="--only") from None
    if sheet:
        save(draw_sheet(sheet_of(study.Plan(folder=order.folder).clips()[0], kinds, order.seed)), sheet)
    write_json(order.json_out, order.compare(study.robustness(kinds)).to_json())
