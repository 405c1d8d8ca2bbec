"""Commands that measure the grounding against ground truth."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from benchmarks.options import COUNT, EXISTING_FOLDER, FILE, jobs_option, weights_option
from kinebench_drake.cli.click_options import check_suffix
from kinebench_drake.errors import member_of

if TYPE_CHECKING:
    from benchmarks.perception.study import GroundingStudy, StudyOutcome

_JSON = click.option(
    "--json", "json_out", type=FILE,
    help="Write the figures to this file; finished measurements are kept in NAME.clips.jsonl beside it.",
)  # fmt: skip
_FIGURE = click.option("--figure", type=FILE, help="Plot the figures (png).")
_OPTIONS = (
    click.argument("folder", type=EXISTING_FOLDER),
    weights_option,
    click.option("--limit", type=COUNT, help="Number of videos, from all tasks in turn."),
    jobs_option,
    click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of all random draws."),
    _JSON,
    click.option("--overwrite", is_flag=True, help="Discard finished measurements and start over."),
    _FIGURE,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasureOptions:
    """Options common to the commands that measure errors."""

    folder: Path
    """Videos with ground truth."""
    weights: Path | None
    limit: int | None
    jobs: int
    seed: int
    json_out: Path | None
    overwrite: bool
    figure: Path | None

    def run(self, study: "GroundingStudy") -> "StudyOutcome":
        """Run a study with a progress display."""
        from benchmarks.perception.study import StudyPlan, run_study
        from kinebench_drake.cli.progress import ProgressView
        from kinebench_drake.executors.base import ExecutorKind, create_executor

        keep = _clips_file(self.json_out)
        if keep and self.overwrite:
            keep.unlink(missing_ok=True)
        plan = StudyPlan(folder=self.folder, weights=self.weights, limit=self.limit, seed=self.seed, keep=keep)
        with ProgressView("measurements") as view:
            return run_study(study, plan, create_executor(ExecutorKind.LOCAL, self.jobs), view)

    def compare(self, study: "GroundingStudy") -> "StudyOutcome":
        """Run a study of several conditions, print its table and write its figure."""
        from benchmarks.perception.figures import draw_comparison
        from kinebench_drake.io.figure import save

        outcome = self.run(study)
        for line in outcome.lines():
            click.echo(line)
        if self.figure:
            groups = [condition.group for condition in study.conditions]
            save(draw_comparison(outcome.results, outcome.figures, groups, study.title), self.figure)
        return outcome


def _measure_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the common argument and options to a command, which receives them as `MeasureOptions`."""

    @wraps(command)
    def wrapped(**options: Any) -> None:
        common = {field.name: options.pop(field.name) for field in fields(MeasureOptions)}
        check_suffix("--figure", common["figure"], ".png")
        command(MeasureOptions(**common), **options)

    for option in reversed(_OPTIONS):
        wrapped = option(wrapped)
    return wrapped


def _clips_file(json_out: Path | None) -> Path | None:
    return json_out.with_suffix(".clips.jsonl") if json_out else None


def _write_json(path: Path | None, value: dict[str, Any]) -> None:
    """Write the figures to the file of --json, if given."""
    from kinebench_drake.io.jsonl import write_json

    if path is not None:
        write_json(path, value)


@click.command(
    epilog="""\b
tracked_when_seen     tracked frames / frames that show at least 30 % of the gripper
lasting_flips         runs of 3 or more tracked frames with the gripper turned by 180 degrees
open_or_closed_right  gap above or below the middle of the episode's range (of 0..80 mm if the range is smaller than
                      16 mm), in frames whose true gap is more than 8 mm from there
tracked_frames_off_by_3_cm  share of tracked frames that are off by more, or show no gripper
vanish_*              frames until a planted vanishing is detected, and until the gripper is tracked again
wall_*, cpu_*         time for 49 frames, decoding included

\b
Example:
  kinebench-drake suite demos --suite 2 --split unseen --episodes 5 --with-depth --out heldout
  python -m benchmarks evaluate heldout --json pixels.json --figure pixels.png"""
)
@_measure_options
@click.option(
    "--pipeline", default="pixels", show_default=True,
    help="Pipeline: pixels, or with ground truth as prior: true-mask, true-depth, true-mask-and-depth, true-start, "
    "true-opening, all-true.",
)  # fmt: skip
@click.option("--true-depth", is_flag=True, help="Same as --pipeline true-mask-and-depth.")
def evaluate(options: MeasureOptions, pipeline: str, true_depth: bool) -> None:
    """Measure the errors of gripper tracks against ground truth.

    FOLDER is the output of `suite demos` or `python -m benchmarks planted-videos`: videos, camera.json,
    manifest.jsonl and truth/.
    """
    from benchmarks.perception import tables
    from benchmarks.perception.study import evaluation
    from benchmarks.perception.summary import reliability

    outcome = options.run(evaluation("true-mask-and-depth" if true_depth else pipeline))
    (results,) = outcome.results.values()
    click.echo("median and 95th percentile of position and rotation error of panda_hand; frames are 0-based")
    for errors in results:
        click.echo(tables.video_line(errors))
    for lines in (
        tables.task_table(results),
        tables.pooled_lines(results, options.seed),
        tables.reliability_lines(reliability(results)),
    ):
        click.echo("")
        for line in lines:
            click.echo(line)
    _write_json(
        options.json_out,
        {"study": outcome.study.name, "pipeline": outcome.study.title, **tables.evaluation_json(results, options.seed)},
    )
    if options.figure:
        from benchmarks.perception.figures import draw_evaluation
        from kinebench_drake.io.figure import save

        save(draw_evaluation(results), options.figure)


@click.command(
    epilog="\b\nExample:\n  python -m benchmarks budget heldout --json budget.json --figure budget.png --jobs 2"
)
@_measure_options
def budget(options: MeasureOptions) -> None:
    """Measure the error budget: each stage's output replaced by ground truth, one at a time and all together.

    FOLDER is the output of `suite demos --with-depth`.
    """
    from benchmarks.perception import study

    _write_json(options.json_out, options.compare(study.budget()).to_json())


@click.command(
    epilog="""\b
scaled     the image in another size
letterbox  the whole image with black bars
crop       the largest centred part of the image that fills the video
stretch    the image with another aspect ratio

\b
Example:
  python -m benchmarks framing heldout --limit 6"""
)
@_measure_options
def framing(options: MeasureOptions) -> None:
    """Measure the errors of the same videos in sizes of video models: 832x480, 720x480 and 512x512.

    The framing is estimated from the first frame of each video and undone, as `score` does it.
    """
    from benchmarks.perception import study

    _write_json(options.json_out, options.compare(study.framing()).to_json())


_KINDS = ("deformation", "occlusion", "contrast", "motion-blur", "noise", "h264", "latent", "ghosting")


@click.command(
    epilog="""\b
deformation  non-rigid warp of the gripper [px, root mean square over the gripper]
occlusion    share of the visible gripper hidden by drifting textured shapes
contrast     loss of contrast
motion-blur  blur along the motion of the gripper [px]
noise        standard deviation of Gaussian noise [levels of 255]
h264         constant rate factor of x264
latent       compression ratio: of the coefficients of 4 x 8 x 8 blocks only the largest are kept, similar to the
             autoencoder of a video model
ghosting     weight of the two previous frames, blended in

\b
Example:
  python -m benchmarks perturb heldout --json robust.json --figure robust.png
  python -m benchmarks perturb heldout --baseline baseline/baseline.safetensors --json robust.json"""
)
@_measure_options
@click.option("--only", default=",".join(_KINDS), show_default=True, help="Kinds of perturbations, comma-separated.")
@click.option(
    "--sheet", type=FILE, help="Draw a contact sheet: one frame of the first video under each perturbation (png)."
)
@click.option(
    "--baseline", type=FILE, help="Weights of the learned baseline, to be measured on the same frames.",
)  # fmt: skip
def perturb(options: MeasureOptions, only: str, sheet: Path | None, baseline: Path | None) -> None:
    """Measure the errors of the same videos under perturbations of the frames."""
    from benchmarks.perception import study
    from benchmarks.perception.clip import find_clips
    from benchmarks.perception.figures import draw_contact_sheet
    from benchmarks.perception.perturbation.catalogue import PerturbationKind
    from kinebench_drake.io.figure import save

    check_suffix("--sheet", sheet, ".png")
    kinds = [member_of(PerturbationKind, name.strip(), "only") for name in only.split(",")]
    if baseline:
        from training.baseline.network import Baseline

        network = Baseline.load(baseline)
        for clip in find_clips(options.folder):
            network.require_camera(clip.camera)
    if sheet:
        first = find_clips(options.folder)[0]
        save(draw_contact_sheet(first, kinds, options.seed), sheet)
    _write_json(options.json_out, options.compare(study.robustness(kinds, baseline)).to_json())


@click.command(
    "depth-ablation",
    epilog="""\b
scale         scale error of a whole video
smooth error  error that varies over image and time, root mean square
noise         independent error of each cell, standard deviation

\b
Example:
  python -m benchmarks depth-ablation heldout --json depth.json --figure depth.png --heatmap map.png""",
)
@_measure_options
@click.option(
    "--depth", "plug_ins", multiple=True, metavar="moge:CHECKPOINT|module:Class",
    help="Another depth estimator: MoGe-2, or a class of yours; repeatable.",
)  # fmt: skip
@click.option("--heatmap", type=FILE, help="Plot the depth errors over the gripper, and one example frame (png).")
def depth_ablation(options: MeasureOptions, plug_ins: tuple[str, ...], heatmap: Path | None) -> None:
    """Measure the effect of depth quality: true depth, estimated depth, degraded depth, other depth estimators.

    FOLDER is the output of `suite demos --with-depth`.
    """
    from benchmarks.perception import study
    from benchmarks.perception.clip import choose, find_clips
    from benchmarks.perception.depth_map import draw_depth, measure_depth
    from benchmarks.perception.variants import VariantTools
    from kinebench_drake.io.figure import save

    check_suffix("--heatmap", heatmap, ".png")
    outcome = options.compare(study.depth_ablation(plug_ins))
    clips = choose(find_clips(options.folder), options.limit)
    errors = measure_depth(clips, VariantTools.load(options.weights).estimator)
    figures: dict[str, Any] = {}
    if errors is not None:
        figures = {"median": errors.median, "p95": errors.p95, "common_error_median": errors.level_median}
        figures["maps"] = {"front": errors.front.to_json(), "side": errors.side.to_json()}
        click.echo(
            f"relative depth error of our estimate on the gripper: median {errors.median:.2%}, 95 % {errors.p95:.2%}; "
            f"common to a frame: median {errors.level_median:.2%}"
        )
    _write_json(options.json_out, {**outcome.to_json(), "relative_depth_error": figures})
    if heatmap and errors is not None:
        save(draw_depth(errors, "our estimate"), heatmap)


@click.command(
    epilog="""\b
frames right           detected with the right first frame (and last frame, for kinds that end)
detected               detected in any frame of the video
area under the curve   probability that a faulty video has a higher score than a clean one; 95 % interval of Newcombe
                       (2006)

\b
Example:
  kinebench-drake suite demos --suite 2 --split unseen --episodes 5 --out clean
  python -m benchmarks planted-videos --suite 2 --split unseen --out faulty
  python -m benchmarks anomalies clean faulty --json anomalies.json --figure anomalies.png"""
)
@click.argument("clean", type=EXISTING_FOLDER)
@click.argument("faulty", type=EXISTING_FOLDER)
@weights_option
@click.option(
    "--limit",
    type=COUNT,
    help="Number of clean videos and of videos of each fault, from all tasks in turn.",
)
@jobs_option
@_JSON
@_FIGURE
def anomalies(
    clean: Path, faulty: Path, weights: Path | None, limit: int | None, jobs: int, json_out: Path | None,
    figure: Path | None,
) -> None:  # fmt: skip
    """Measure the detection rate of planted anomalies and the rate of false alarms.

    CLEAN is the output of `suite demos`, FAULTY that of `python -m benchmarks planted-videos`.
    """
    from benchmarks.perception.anomalies import detect_all, find_cases
    from benchmarks.perception.anomaly_table import draw_anomalies, table_json, table_lines
    from kinebench_drake.cli.progress import ProgressView
    from kinebench_drake.executors.base import ExecutorKind, create_executor
    from kinebench_drake.io.figure import save

    check_suffix("--figure", figure, ".png")
    cases = find_cases(clean, faulty, limit)
    with ProgressView("videos") as view:
        findings = detect_all(cases, weights, create_executor(ExecutorKind.LOCAL, jobs), view, _clips_file(json_out))
    for line in table_lines(findings):
        click.echo(line)
    _write_json(json_out, table_json(findings))
    if figure:
        save(draw_anomalies(findings), figure)


COMMANDS = (evaluate, budget, framing, perturb, depth_ablation, anomalies)
