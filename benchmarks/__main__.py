"""`python -m benchmarks`: validation studies and benchmarks."""

from pathlib import Path

import click

from benchmarks import poses, speed, verdicts
from benchmarks.options import COUNT, EXISTING_FOLDER, FILE, FOLDER, CommandGroup, jobs_option
from kinebench_drake.models.panda.description import GripperKind


@click.group(
    cls=CommandGroup,
    epilog="\b\nExample:\n"
    "  python -m benchmarks trajectories make --out tracks --kind infeasible --count 1000 --jobs 2\n"
    "  kinebench-drake audit tracks --out results\n"
    "  python -m benchmarks trajectories check results tracks",
)
def main() -> None:
    """Validation studies and benchmarks; each command has an example."""


for command in (*speed.COMMANDS, *verdicts.COMMANDS, *poses.COMMANDS):
    main.add_command(command)


@main.command(epilog="\b\nExample:\n  python -m benchmarks schema")
def schema() -> None:
    """Write the JSON schema of `samples.jsonl` and the table of its keys in docs/formats.md from the model of a row."""
    from benchmarks.row_schema import write_files

    write_files(Path.cwd())


@main.command(epilog="\b\nExample:\n  python -m benchmarks tolerance --episodes 2 --out docs/tolerance.png --jobs 2")
@click.option("--episodes", type=COUNT, default=2, show_default=True, help="Episodes of each task of suite 0.")
@click.option("--out", type=FILE, required=True, help="Image to write.")
@jobs_option
def tolerance(episodes: int, out: Path, jobs: int) -> None:
    """Execute the experts' true tracks with errors of graded size; draw success against error, task by task."""
    from benchmarks.tolerance import SIZES, draw_tolerance, measure_tolerance, success_share
    from kinebench_drake.suites.catalog import load_suite

    todo = [spec.episode() for spec in load_suite(0).specs("test", episodes)]
    attempts = list(measure_tolerance(todo, jobs))
    for error, sizes in SIZES.items():
        shares = (f"{size:g}: {success_share(attempts, error, size):.1%}" for size in sizes)
        click.echo(f"success under {error.value}: {', '.join(shares)}")
    draw_tolerance(attempts, out)


@main.command(
    epilog="\b\nExamples:\n"
    "  python -m benchmarks following --work planted\n"
    "  python -m benchmarks following --work joints --joints recordings/ --gripper robotiq-2f85\n"
    "  python -m benchmarks following --pairs tiles/"
)
@click.option("--work", type=FOLDER, help="Folder for the clips and their output folder; not needed with --pairs.")
@click.option("--joints", type=EXISTING_FOLDER, help="Recordings NAME_VIEW.mp4 with their joint angles in NAME.json.")
@click.option("--gripper", type=click.Choice([k.value for k in GripperKind]), default="auto", help="Their gripper.")
@click.option("--limit", type=COUNT, help="Recordings at most.")
@click.option("--pairs", type=EXISTING_FOLDER, help="Tiles of a real row above a generated one, CHECKPOINT_SAMPLE.mp4.")
def following(work: Path | None, joints: Path | None, gripper: str, limit: int | None, pairs: Path | None) -> None:
    """Compare clips with actions or real clips: planted faults, recordings of others, or tiles beside their labels.

    Without --joints and --pairs clips with planted lags, gains and a drift are drawn by the learned world model.
    """
    from benchmarks.followed import compare_labels, compare_models, measure_joints, measure_pairs
    from benchmarks.following import measure_planted
    from benchmarks.options import EXAMPLES
    from benchmarks.pair_labels import read_pair_labels

    if pairs is not None:
        views = measure_pairs(pairs)
        lines = [*compare_labels(views, read_pair_labels()), "", *compare_models(views)]
    elif work is None:
        raise click.UsageError("--work FOLDER is needed")
    elif joints is not None:
        lines = [*measure_joints(joints, work, GripperKind(gripper), limit)]
    else:
        lines = [*measure_planted(EXAMPLES, Path("examples/worldmodel/weights"), work / "clips", work / "out")]
    click.echo("\n".join(lines))


@main.command(epilog="\b\nExample:\n  python -m benchmarks tasks --seed 4 --out docs/tasks.jpg")
@click.option("--seed", type=click.IntRange(0), default=4, show_default=True, help="Seed of the episodes.")
@click.option("--out", type=FILE, required=True, help="Image to write.")
def tasks(seed: int, out: Path) -> None:
    """Draw the first and the last frame of each task's expert."""
    from benchmarks.task_sheet import draw_task_sheet

    draw_task_sheet(seed, out)


if __name__ == "__main__":
    main(prog_name="python -m benchmarks")
