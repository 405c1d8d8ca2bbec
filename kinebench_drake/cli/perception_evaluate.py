"""`kinebench-drake perception evaluate`, and what its sisters have in common with it."""

import json
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from kinebench_drake.errors import UsageError

if TYPE_CHECKING:
    from kinebench_drake.grounding.evaluation.study import GroundingStudy, StudyOutcome


_OPTIONS = (
    click.argument("folder", type=click.Path(path_type=Path, exists=True, file_okay=False)),
    click.option(
        "--weights", type=click.Path(path_type=Path, dir_okay=False, exists=True), default=None,
        help="Weights to measure (safetensors).  [default: those shipped]",
    ),
    click.option("--limit", type=click.IntRange(1), default=None, help="Measure so many videos only, tasks in turn."),
    click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Worker processes."),
    click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of all random draws."),
    click.option(
        "--json", "json_out", type=click.Path(path_type=Path, dir_okay=False),
        help="Write the figures here; what is finished is kept in NAME.clips.jsonl beside it.",
    ),
    click.option("--overwrite", is_flag=True, help="Measure anew what is kept."),
    click.option("--figure", type=click.Path(path_type=Path, dir_okay=False), help="Draw the figure (png)."),
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Measuring:
    """What all measuring commands are told."""

    folder: Path
    """Videos with their truth."""
    weights: Path | None
    limit: int | None
    jobs: int
    seed: int
    json_out: Path | None
    overwrite: bool
    figure: Path | None

    def carry_out(self, study: "GroundingStudy") -> "StudyOutcome":
        """Measure a study, telling of the progress."""
        from kinebench_drake.cli.run import ProgressView
        from kinebench_drake.executors.base import ExecutorKind, create_executor
        from kinebench_drake.grounding.evaluation import study as studies

        keep = self.json_out.with_suffix(".clips.jsonl") if self.json_out else None
        if keep and self.overwrite:
            keep.unlink(missing_ok=True)
        plan = studies.StudyPlan(folder=self.folder, weights=self.weights, limit=self.limit, seed=self.seed, keep=keep)
        with ProgressView("measurements") as view:
            return studies.carry_out(study, plan, create_executor(ExecutorKind.LOCAL, self.jobs), view)

    def compare(self, study: "GroundingStudy") -> "StudyOutcome":
        """Measure a study of several conditions, print its table and draw its figure."""
        from kinebench_drake.grounding.evaluation.figures import draw_comparison
        from kinebench_drake.io.figure import save

        outcome = self.carry_out(study)
        for line in outcome.lines():
            click.echo(line)
        if self.figure:
            save(
                draw_comparison(outcome.results, outcome.figures, outcome.study.groups, outcome.study.title),
                self.figure,
            )
        return outcome


def measuring(command: Callable[..., None]) -> Callable[..., None]:
    """The argument and the options that all measuring commands share; the command gets them as one `Measuring`."""

    @wraps(command)
    def told(**options: Any) -> None:
        shared = {field.name: options.pop(field.name) for field in fields(Measuring)}
        check_figure(shared["figure"])
        command(Measuring(**shared), **options)

    for option in reversed(_OPTIONS):
        told = option(told)
    return told


def write_json(path: Path | None, value: dict[str, Any]) -> None:
    """Write figures where a user wants them."""
    from kinebench_drake.io.atomic import write_atomically

    if path is not None:
        write_atomically(path, (json.dumps(value, indent=1, allow_nan=False) + "\n").encode())


def check_figure(path: Path | None) -> None:
    """Refuse a figure's name before minutes of work.

    Raises:
        UsageError: it is no png.
    """
    if path is not None and path.suffix.lower() != ".png":
        raise UsageError(f"--figure {path.name}: expected a name that ends in .png")


_TERMS = """\b
tracked_when_seen     over frames that show at least 30 % of the gripper
lasting_flips         runs of 3 tracked frames or more in the 180-degree reading
open_or_closed_right  gap above or below halfway between the episode's least and greatest (of 0..80 mm where these
                      differ by less than 16 mm), in frames whose true gap is more than 8 mm from there
tracked_frames_off_by_3_cm  frames called tracked that are off by more, or show no gripper at all
vanish_*              frames until a planted vanishing is told and until the gripper is found again
wall_*, cpu_*         for 49 frames, decoding included

"""
"""What the words of the table mean."""


@click.command(
    epilog=_TERMS + "\b\nExample:\n"
    "  kinebench-drake suite demos --suite 2 --split unseen --episodes 5 --with-depth --out heldout\n"
    "  kinebench-drake perception evaluate heldout --json pixels.json --figure pixels.png"
)
@measuring
@click.option(
    "--pipeline", default="pixels", show_default=True,
    help="What to measure: pixels, or with true values put in: true-mask, true-depth, true-mask-and-depth, ...",
)  # fmt: skip
@click.option("--true-depth", is_flag=True, help="The same as --pipeline true-mask-and-depth.")
def evaluate(
    order: Measuring,
    pipeline: str,
    true_depth: bool,
) -> None:
    """Hold the tracks of videos against their ground truth.

    FOLDER is what `suite demos` or `python -m benchmarks.planted_videos` writes: videos, camera.json,
    manifest.jsonl and truth/.
    """
    from kinebench_drake.grounding.evaluation.reliability import judged_frames, reliability
    from kinebench_drake.grounding.evaluation.study import evaluation
    from kinebench_drake.grounding.evaluation.tables import (
        evaluation_json,
        pooled_lines,
        reliability_lines,
        task_table,
        video_line,
    )

    pipeline = "true-mask-and-depth" if true_depth else pipeline
    outcome = order.carry_out(evaluation(pipeline))
    (results,) = outcome.results.values()
    click.echo("median and 95th percentile of position and rotation error of panda_hand; frames are 0-based")
    for e in results:
        click.echo(video_line(e))
    for lines in (
        task_table(results),
        pooled_lines(results, order.seed),
        reliability_lines(reliability(*judged_frames(results))),
    ):
        click.echo("")
        for line in lines:
            click.echo(line)
    write_json(order.json_out, {"pipeline": outcome.study.title, **evaluation_json(results, order.seed)})
    if order.figure:
        from kinebench_drake.grounding.evaluation.figures import draw_evaluation
        from kinebench_drake.io.figure import save

        save(draw_evaluation(results), order.figure)


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


_FRAMING_METRICS = """\b
scaled     the picture in another size
letterbox  the whole picture, black bars beside it
crop       the middle of the picture, as much as fills the video
stretch    the picture drawn out of shape

"""
"""What the words of the table mean."""


@click.command(epilog=_FRAMING_METRICS + "\b\nExample:\n  kinebench-drake perception framing heldout --limit 6")
@measuring
def framing(order: Measuring) -> None:
    """Measure the same videos in the sizes of video models: 832x480, 720x480 and 512x512, made in every usual way.

    What was done is found out from each video's first frame and undone, as `score` does it.
    """
    from kinebench_drake.grounding.evaluation import study

    write_json(order.json_out, order.compare(study.framing()).to_json())


_KINDS = ("deformation", "occlusion", "contrast", "motion-blur", "noise", "h264", "latent", "ghosting")


_ROBUSTNESS_METRICS = """\b
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
    epilog=_ROBUSTNESS_METRICS
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
    from kinebench_drake.grounding.evaluation import study
    from kinebench_drake.grounding.evaluation.figures import draw_sheet
    from kinebench_drake.grounding.evaluation.perturbation.catalogue import PerturbationKind
    from kinebench_drake.grounding.evaluation.sheet import sheet_of
    from kinebench_drake.io.figure import save

    check_figure(sheet)
    try:
        kinds = [PerturbationKind(name.strip()) for name in only.split(",")]
    except ValueError:
        raise click.BadParameter(f"{only!r}; there are {', '.join(_KINDS)}", param_hint="--only") from None
    if sheet:
        save(draw_sheet(sheet_of(study.StudyPlan(folder=order.folder).clips()[0], kinds, order.seed)), sheet)
    write_json(order.json_out, order.compare(study.robustness(kinds)).to_json())


_DEPTH_METRICS = """\b
scale         a whole video too far or too near by so much
smooth error  errors that vary over picture and time, root mean square
noise         each cell by itself, standard deviation

"""
"""What the words of the table mean."""


@click.command(
    "depth-ablation",
    epilog=_DEPTH_METRICS + "\b\nExample:\n"
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
    from kinebench_drake.grounding.evaluation import study
    from kinebench_drake.grounding.evaluation.depth_map import draw_depth, measure_depth
    from kinebench_drake.grounding.evaluation.variants import VariantTools
    from kinebench_drake.io.figure import save

    check_figure(heatmap)
    outcome = order.compare(study.depth_ablation(plug_ins))
    clips = study.StudyPlan(folder=order.folder, limit=order.limit).clips()
    errors = measure_depth(clips, VariantTools.load(order.weights).estimator)
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
