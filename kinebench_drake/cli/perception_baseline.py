"""`kinebench-drake perception baseline`."""

from dataclasses import replace
from pathlib import Path

import click


@click.group(epilog="\b\nExample:\n  kinebench-drake perception baseline train --data demos/ --out baseline/")
def baseline() -> None:
    """Train and measure the yardstick: a network that maps pixels straight to poses.

    It stands for the inverse-dynamics networks of other benchmarks; nothing in this program takes its tracks from it.
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
    help="Folder for decoded frames, checkpoints and weights; an interrupted run goes on from there.",
)  # fmt: skip
@click.option("--steps", type=click.IntRange(1), default=2400, show_default=True, help="Training steps.")
@click.option("--batch-size", type=click.IntRange(2), default=8, show_default=True, help="Windows of 5 frames a step.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of windows and weights.")
def train(data: Path, out: Path, steps: int, batch_size: int, seed: int) -> None:
    """Train the baseline on demonstrations of one camera, on the GPU when there is one."""
    from kinebench_drake.grounding.baseline.train import SCHEDULE, BaselineConfig
    from kinebench_drake.grounding.baseline.train import train as run

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
    "--weights", type=click.Path(path_type=Path, dir_okay=False), required=True, help="The baseline's weights.",
)  # fmt: skip
@click.option(
    "--grounding-weights", type=click.Path(path_type=Path, dir_okay=False), default=None,
    help="The grounding's weights.  [default: those shipped]",
)  # fmt: skip
@click.option("--limit", type=click.IntRange(1), default=None, help="Measure the first so many videos of each task.")
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), default=Path("baseline-comparison"), show_default=True,
    help="Folder for the table (txt, json) and the figure (png).",
)  # fmt: skip
def evaluate(
    folders: tuple[Path, ...], weights: Path, grounding_weights: Path | None, limit: int | None, out: Path
) -> None:
    """Hold the baseline and the grounding against the truth of the same videos.

    A FOLDER is what `suite demos --format mp4` writes. Tasks that the baseline was trained on and unseen ones are told
    apart. Errors are those of panda_hand_tcp in the base frame: of all frames for the baseline, of tracked ones for the
    grounding; intervals are of 95 %, by drawing whole videos anew.
    """
    from kinebench_drake.grounding.baseline.report import comparison_lines

    for line in comparison_lines(folders, weights, grounding_weights, limit, out):
        click.echo(line)
    click.echo(out)
