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
    from kinebench_drake.grounding.evaluation.study import Outcome, Study

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

    def carry_out(self, study: "Study") -> "Outcome":
        """Measure a study, telling of the progress."""
        from kinebench_drake.cli.progress import EpisodeView
        from kinebench_drake.engines import EngineKind, create_engine
        from kinebench_drake.grounding.evaluation import study as studies

        keep = self.json_out.with_suffix(".clips.jsonl") if self.json_out else None
        if keep and self.overwrite:
            keep.unlink(missing_ok=True)
        plan = studies.Plan(folder=self.folder, weights=self.weights, limit=self.limit, seed=self.seed, keep=keep)
        with EpisodeView("measurements") as view:
            return studies.carry_out(study, plan, create_engine(EngineKind.LOCAL, self.jobs), view)

    def compare(self, study: "Study") -> "Outcome":
        """Measure a study of several conditions, print its table and draw its figure."""
        from kinebench_drake.drawing import save
        from kinebench_drake.grounding.evaluation.figures import draw_comparison

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
    from kinebench_drake.storage import write_atomically

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

    FOLDER is what `suite demos` or `python -m kinebench_drake.suites.samples` writes: videos, camera.json,
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
        from kinebench_drake.drawing import save
        from kinebench_drake.grounding.evaluation.figures import draw_evaluation

        save(draw_evaluation(results), order.figure)
