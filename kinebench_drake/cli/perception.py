"""`kinebench-drake perception`."""

from pathlib import Path

import click

_DATA = click.option(
    "--data", type=click.Path(path_type=Path, file_okay=False), default=Path("data/frames"), show_default=True,
    help="Folder of rendered frames; missing ones are rendered into it.",
)  # fmt: skip
_JOBS = click.option("--jobs", type=click.IntRange(1), default=2, show_default=True, help="Rendering processes.")
_WEIGHTS = click.option(
    "--weights", type=click.Path(path_type=Path, dir_okay=False), default=None,
    help="Weights to measure (safetensors); default: those shipped.",
)  # fmt: skip


@click.group(epilog="\b\nExample:\n  kinebench-drake perception evaluate samples/")
def perception() -> None:
    """Train and measure the perception networks."""


@perception.command(epilog="\b\nExample:\n  kinebench-drake perception train --out data/training")
@_DATA
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), default=Path("data/training"), show_default=True,
    help="Folder for checkpoints and weights; an interrupted run goes on from there.",
)  # fmt: skip
@click.option(
    "--scenes", type=click.IntRange(1), default=600, show_default=True, help="Scenes of 20 frames to train on."
)
@click.option("--steps", type=click.IntRange(1), default=4000, show_default=True, help="Training steps.")
@click.option("--batch-size", type=click.IntRange(2), default=32, show_default=True, help="Crops a step.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of crops and weights.")
@_JOBS
def train(data: Path, out: Path, scenes: int, steps: int, batch_size: int, seed: int, jobs: int) -> None:
    """Render frames and train the gripper network on them, on the GPU when there is one."""
    from kinebench_drake.grounding.training.render import render
    from kinebench_drake.grounding.training.train import TrainingConfig
    from kinebench_drake.grounding.training.train import train as run

    render(data, range(scenes), jobs, click.echo)
    config = TrainingConfig(data=data, out=out, seed=seed, steps=steps, batch_size=batch_size)
    weights = run(config, click.echo)
    click.echo(f"weights: {weights}; next: kinebench-drake perception calibrate --weights {weights}")


@perception.command(
    epilog="\b\nExample:\n  kinebench-drake perception calibrate --out models/perception/confidence.json"
)
@click.option(
    "--data", type=click.Path(path_type=Path, file_okay=False), default=Path("data/held-out"), show_default=True,
    help="Folder of held-out frames; missing ones are rendered into it.",
)  # fmt: skip
@_WEIGHTS
@click.option("--scenes", type=click.IntRange(2), default=40, show_default=True, help="Held-out scenes of 20 frames.")
@click.option(
    "--out", type=click.Path(path_type=Path, dir_okay=False), default=None, help="Write the calibration here."
)
@_JOBS
def calibrate(data: Path, weights: Path | None, scenes: int, out: Path | None, jobs: int) -> None:
    """Measure single frames of unseen scenes and fit the confidence to them.

    Half of the frames fit the confidence, the other half say how well it is calibrated.
    """
    from kinebench_drake.grounding.training.report import holdout_lines

    for line in holdout_lines(data, weights, scenes, out, jobs):
        click.echo(line)


@perception.command(epilog="\b\nExample:\n  kinebench-drake perception evaluate samples/ --true-depth")
@click.argument("folder", type=click.Path(path_type=Path, exists=True, file_okay=False))
@_WEIGHTS
@click.option("--true-depth", is_flag=True, help="Give true mask and depth: what remains is the registration's error.")
@click.option("--limit", type=click.IntRange(1), default=None, help="Measure the first so many videos only.")
@click.option(
    "--json", "json_out", type=click.Path(path_type=Path, dir_okay=False), help="Write the figures here, too."
)
def evaluate(folder: Path, weights: Path | None, true_depth: bool, limit: int | None, json_out: Path | None) -> None:
    """Hold the tracks of videos against their ground truth.

    FOLDER is what `python -m kinebench_drake.suites.samples` writes: videos, camera.json, manifest.jsonl and truth/.
    """
    from kinebench_drake.grounding.training.report import video_lines

    for line in video_lines(folder, weights, true_depth, limit, json_out):
        click.echo(line)
