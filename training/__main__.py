"""`python -m training`: training and calibration of the networks, training of the learned baseline."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from benchmarks.options import (
    COUNT,
    EXISTING_FILE,
    EXISTING_FOLDER,
    FILE,
    FOLDER,
    CommandGroup,
    jobs_option,
    weights_option,
)

_DATA = click.option(
    "--data", type=FOLDER, default=Path("data/frames"), show_default=True,
    help="Folder of rendered frames; missing ones are rendered into it.",
)  # fmt: skip
_JOBS = click.option("--jobs", type=COUNT, default=2, show_default=True, help="Rendering processes.")


def _demos(purpose: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    return click.option(
        "--demos", multiple=True, type=EXISTING_FOLDER,
        help=f"Folder of `python -m training stills` {purpose} as well; repeatable.",
    )  # fmt: skip


@click.group(cls=CommandGroup, epilog="\b\nExample:\n  python -m training render data/vtk --videos 40")
def main() -> None:
    """Train and calibrate the perception networks and the learned baseline."""


@main.command(
    epilog="\b\nExample:\n"
    "  python -m training stills data/demos --episodes 40\n"
    "  python -m training train --demos data/demos --out data/training"
)
@_DATA
@click.option(
    "--out", type=FOLDER, default=Path("data/training"), show_default=True,
    help="Folder for checkpoints and weights; an interrupted run resumes from it.",
)  # fmt: skip
@click.option("--scenes", type=COUNT, default=600, show_default=True, help="Number of scenes of 20 frames.")
@click.option("--steps", type=COUNT, default=4000, show_default=True, help="Training steps.")
@click.option("--batch-size", type=click.IntRange(2), default=32, show_default=True, help="Crops per step.")
@click.option(
    "--learning-rate", type=click.FloatRange(0.0, min_open=True), default=1.2e-3, show_default=True,
    help="Maximum learning rate of AdamW, reached after the warm-up.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of crops and weights.")
@_demos("to train on")
@click.option(
    "--network", type=click.Choice(["gripper", "robotiq", "arm"]), default="gripper", show_default=True,
    help="Network of the Franka hand, of the Robotiq 2F-85, or of the arm alone; each needs its own --data.",
)  # fmt: skip
@click.option(
    "--start", type=EXISTING_FILE,
    help="Initial weights (safetensors).  [default: an encoder trained on ImageNet]",
)  # fmt: skip
@_JOBS
def train(
    data: Path,
    out: Path,
    scenes: int,
    steps: int,
    batch_size: int,
    learning_rate: float,
    seed: int,
    demos: tuple[Path, ...],
    network: str,
    start: Path | None,
    jobs: int,
) -> None:
    """Render frames and train the gripper network on them, on the GPU if there is one."""
    from training.layout import TrainedNetwork
    from training.loop import Schedule
    from training.render import render
    from training.train import TrainingConfig
    from training.train import train as run

    trained = TrainedNetwork(network)
    render(data, range(scenes), jobs, click.echo, trained)
    schedule = Schedule(steps=steps, learning_rate=learning_rate, batch_size=batch_size, seed=seed)
    weights = run(
        TrainingConfig(data=(data, *demos), out=out, start=start, schedule=schedule, network=trained), click.echo
    )
    click.echo(f"weights: {weights}; next: python -m training calibrate --weights {weights}")


@main.command(
    epilog="\b\nExample:\n"
    "  kinebench-drake suite demos --suite 2 --split seen --episodes 3 --out data/held-out\n"
    "  python -m training render data/vtk --videos 40\n"
    "  python -m training calibrate data/held-out data/vtk --out models/perception/confidence.json --jobs 2"
)
@click.argument("folders", nargs=-1, required=True, type=EXISTING_FOLDER)
@weights_option
@click.option("--limit", type=click.IntRange(2), help="Number of videos of each folder.  [default: all]")
@click.option(
    "--out", type=FILE, help="File for the calibration; measurements are kept beside it, so that a run resumes."
)
@jobs_option
def calibrate(folders: tuple[Path, ...], weights: Path | None, limit: int | None, out: Path | None, jobs: int) -> None:
    """Fit the confidence to the errors on held-out videos of FOLDERS, of `suite demos` or `python -m training render`.

    Each video is measured as it is, and degraded, occluded, without its gripper or with a wrong camera. The printed
    reliability is that of a fit to half of the videos, measured on the other half; videos with a wrong camera are only
    measured.
    """
    from kinebench_drake.cli.progress import ProgressView
    from kinebench_drake.executors.local import LocalExecutor
    from kinebench_drake.grounding.tracking.pose import save_confidence
    from training.calibration import ConfidenceCalibration, calibrate_confidence

    keep = None if out is None else out.with_name(f"{out.stem}_poses.jsonl")
    config = ConfidenceCalibration(videos=folders, weights=weights, limit=limit, keep=keep)
    with ProgressView("measurements") as view:
        confidence, lines = calibrate_confidence(config, LocalExecutor(jobs=jobs), view)
    for line in lines:
        click.echo(line)
    if out is not None:
        save_confidence(confidence, out)
        click.echo(f"calibration fitted to all videos: {out}")


@main.command(epilog="\b\nExample:\n  python -m training stills data/demos --episodes 40")
@click.argument("out", type=FOLDER)
@click.option("--episodes", type=COUNT, default=5, show_default=True, help="Episodes of each task of suite 2.")
@_JOBS
def stills(out: Path, episodes: int, jobs: int) -> None:
    """Render labelled frames of the experts' rollouts in ManiSkill; those that OUT holds already are kept."""
    from kinebench_drake.suites.catalog import load_suite
    from training.stills import render_rollouts

    render_rollouts(out, load_suite(2).specs("train", episodes), jobs, click.echo)


@main.command(epilog="\b\nExample:\n  python -m training render data/vtk --videos 40")
@click.argument("out", type=FOLDER)
@click.option("--videos", type=COUNT, default=20, show_default=True, help="Number of videos.")
def render(out: Path, videos: int) -> None:
    """Render videos with ground truth with Drake's VTK renderer, on which the networks are not trained.

    Videos that OUT holds already are kept. Cameras stand anywhere around the arm, and images have several sizes and
    shapes.
    """
    from training.video import render_videos

    render_videos(out, range(videos), click.echo)


@main.command(epilog="\b\nExample:\n  python -m training baseline --out baseline --jobs 2")
@click.option("--out", type=FOLDER, required=True, help="Folder of demonstrations, checkpoints and weights.")
@click.option("--episodes", type=COUNT, default=100, show_default=True, help="Demonstrations of each training task.")
@click.option("--steps", type=COUNT, default=6000, show_default=True, help="Training steps.")
@click.option("--size", type=COUNT, default=224, show_default=True, help="Width of the frames, a multiple of 32 [px].")
@jobs_option
def baseline(out: Path, episodes: int, steps: int, size: int, jobs: int) -> None:
    """Train the inverse-dynamics baseline on demonstrations of each training task of suite 1, made first.

    It represents the networks of other benchmarks that map pixels directly to poses, for comparison only. Both the
    demonstrations and the training continue where an interrupted run stopped.
    """
    from kinebench_drake.cli.progress import ProgressView
    from training.baseline.fitting import SCHEDULE, BaselineConfig, make_demonstrations
    from training.baseline.fitting import train as run

    with ProgressView("demonstrations") as view:
        data = make_demonstrations(out / "demonstrations", episodes, jobs, view)
    schedule = replace(SCHEDULE, steps=steps)
    click.echo(run(BaselineConfig(data=data, out=out, schedule=schedule, size=size), click.echo))


if __name__ == "__main__":
    main(prog_name="python -m training")
