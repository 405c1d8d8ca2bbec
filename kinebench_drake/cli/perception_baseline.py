"""`kinebench-drake perception baseline`."""

from dataclasses import replace
from pathlib import Path

import click


@click.group(epilog="\b\nExample:\n  kinebench-drake perception baseline train --data demos/ --out baseline/")
def baseline() -> None:
    """Train and measure the baseline: a network that maps pixels directly to poses.

    It represents the inverse-dynamics networks of other benchmarks, for comparison only: nothing else here uses it.
    """


@baseline.command(
    epilog="\b\nExamples:\n"
    "  kinebench-drake suite demos --suite 1 --split train --episodes 100 --size 256 --out demos/ --jobs 2\n"
    "  kinebench-drake perception baseline train --data demos/ --out baseline/"
)
@click.option(
    "--data", type=click.Path(path_type=Path, exists=True, file_okay=False), required=True,
    help="Folder of demonstrations, as `suite demos --format mp4` writes them.",
)  # fmt: skip
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), required=True,
    help="Folder for decoded frames, checkpoints and weights; an interrupted run resumes from it.",
)  # fmt: skip
@click.option("--steps", type=click.IntRange(1), default=2400, show_default=True, help="Training steps.")
@click.option(
    "--batch-size", type=click.IntRange(2), default=8, show_default=True, help="Windows of 5 frames per step."
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of windows and weights.")
def train(data: Path, out: Path, steps: int, batch_size: int, seed: int) -> None:
    """Train the baseline on demonstrations of one camera, on the GPU when there is one."""
    from kinebench_drake.grounding.baseline.fitting import SCHEDULE, BaselineConfig
    from kinebench_drake.grounding.baseline.fitting import train as run

    schedule = replace(SCHEDULE, steps=steps, batch_size=batch_size, seed=seed)
    weights = run(BaselineConfig(data=data, out=out, schedule=schedule), click.echo)
    click.echo(f"weights: {weights}; next: kinebench-drake perception baseline evaluate FOLDER --weights {weights}")


@baseline.command(
    epilog="\b\nExamples:\n"
    "  kinebench-drake suite demos --suite 1 --split seen --episodes 5 --out seen/\n"
    "  kinebench-drake suite demos --suite 1 --split unseen --episodes 5 --out unseen/\n"
    "  kinebench-drake perception baseline evaluate seen/ unseen/ --weights baseline/baseline.safetensors\n"
)
@click.argument(
    "folders", metavar="FOLDER...", nargs=-1, required=True,
    type=click.Path(path_type=Path, exists=True, file_okay=False),
)  # fmt: skip
@click.option(
    "--weights", type=click.Path(path_type=Path, dir_okay=False), required=True, help="Weights of the baseline.",
)  # fmt: skip
@click.option(
    "--grounding-weights", type=click.Path(path_type=Path, dir_okay=False), default=None,
    help="Weights of the grounding.  [default: those shipped]",
)  # fmt: skip
@click.option("--limit", type=click.IntRange(1), default=None, help="Number of videos of each task.")
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), default=Path("baseline-comparison"), show_default=True,
    help="Folder for the table (txt, json) and the figure (png).",
)  # fmt: skip
def evaluate(
    folders: tuple[Path, ...], weights: Path, grounding_weights: Path | None, limit: int | None, out: Path
) -> None:
    """Measure the errors of baseline and grounding against ground truth on the same videos.

    A FOLDER is the output of `suite demos --format mp4`. Tasks that the baseline was trained on and unseen tasks are
    listed separately. Errors are those of panda_hand_tcp in the base frame: in all frames for the baseline, in tracked
    frames for the grounding, with 95 % bootstrap intervals over videos.
    """
    from kinebench_drake.grounding.baseline.report import comparison_lines

    for line in comparison_lines(folders, weights, grounding_weights, limit, out):
        click.echo(line)
    click.echo(out)
