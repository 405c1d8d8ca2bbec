"""Commands on output folders: `report`, `compare`, `merge`, `view`."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from kinebench_drake.cli.click_options import PathParameter, echo
from kinebench_drake.cli.progress import ProgressView, run
from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.io.jsonl import as_object
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.store import artifact_path, read_rows, require_output

if TYPE_CHECKING:
    from kinebench_drake.kinematics.plant import ArmPlant

folders_argument = click.argument("folders", metavar="DIR...", nargs=-1, required=True, type=PathParameter())


@click.command(epilog="\b\nExample:\n  kinebench-drake report results/")
@folders_argument
def report(folders: tuple[Path, ...]) -> None:
    """Write report.html in each output folder DIR again, from its rows and tracks."""
    from kinebench_drake.report.page import write_report

    for folder in folders:
        require_output(folder)
        try:
            echo(write_report(folder))
        except InputError as error:
            raise UsageError(str(error)) from None


@click.command(
    epilog="\b\nExamples:\n"
    "  kinebench-drake compare scored/wan/ scored/cogvideox/ --out comparison/\n"
    "  kinebench-drake compare scored/                        # a run with several models\n"
    "  kinebench-drake compare runs/*/ --out comparison/"
)
@folders_argument
@click.option(
    "--out", type=PathParameter(file_okay=False),
    help="Also write report.html and tables (csv, LaTeX) to this folder.",
)  # fmt: skip
def compare(folders: tuple[Path, ...], out: Path | None) -> None:
    """Compare the models of runs DIR of one kind, two by two, on the samples or episodes that both have.

    Samples of `score` and `audit` are paired by task and seed, else by id or file name, episodes of suite runs by
    suite, task and seed: success and every headline number with their paired difference, 95 % intervals and p-value,
    for all tasks together, some for each.
    """
    from kinebench_drake.report.run import read_runs
    from kinebench_drake.report.sample_comparison import compare_samples
    from kinebench_drake.runs.benchmark_registry import load_benchmark
    from kinebench_drake.runs.config import RunKind

    runs = read_runs(folders)
    are_episodes = all(run.kind == RunKind.SUITE.value for run in runs)
    comparison = load_benchmark().compare(folders) if are_episodes else compare_samples(runs)
    for warning in comparison.warnings:
        echo(f"warning: {warning}", err=True)
    page = None if out is None else comparison.write(out)
    for line in comparison.lines:
        echo(line)
    if page is not None:
        echo(page)


class MergeView(ProgressView):
    """Progress of a merge: samples are counted, not printed."""

    def finish(self, row: SampleRow, wall_s: float) -> None:
        """Count the sample."""
        self._count()


@click.command(
    epilog="\b\nExamples:\n"
    "  kinebench-drake merge part1/ part2/ part3/ part4/ --out results/\n"
    "  kinebench-drake merge parts/* --out results/"
)
@folders_argument
@click.option(
    "--out", type=PathParameter(), required=True,
    help="Output folder; created if absent, extended if it holds an earlier merge of the run.",
)  # fmt: skip
@click.pass_context
def merge(ctx: click.Context, /, folders: tuple[Path, ...], out: Path) -> None:
    """Merge the output folders DIR of a run's shards (--shard I/N) into one, as if a single run had made them.

    Rows, tracks, videos and other files are copied, DIR is not changed; aggregates and report are computed from all
    rows. Shards must agree in all settings but --shard, --jobs, --engine and --limit. To complete a merged folder, run
    the original command without --shard and with the merged folder as --out: it processes the samples still absent.
    """
    from kinebench_drake.runs.merge import merge_folders

    ctx.exit(run(lambda observer: merge_folders(folders, out, observer), out, MergeView("samples")))


@click.command(epilog="\b\nExample:\n  kinebench-drake view results/ episode_0003 --open")
@click.argument("out", metavar="OUT", type=PathParameter())
@click.argument("id", metavar="ID")
@click.option("--open/--no-open", "opened", default=False, help="Open it in the browser.")
def view(out: Path, id: str, opened: bool) -> None:
    """Write a 3D replay of sample ID of the output folder OUT and print its path.

    The replay, OUT/replays/ID.html, opens in any browser. It shows the motion of the arm, and lists the
    violated limits with their times.
    """
    from difflib import get_close_matches

    require_output(out)
    try:
        rows = read_rows(out)
        if id not in rows:
            near = get_close_matches(id, rows, n=3, cutoff=0.5) or sorted(rows)[:3]
            hint = f"such as {', '.join(near)}" if near else "it is empty"
            raise UsageError(f"{out}: holds no sample {id!r} ({len(rows)} samples, {hint})")
        row = rows[id]
        if row.base_frame_reason is not None:
            raise UsageError(f"{id}: cannot be shown with the robot, it has no base frame: {row.base_frame_reason}")
        if row.arms is not None:
            raise UsageError(f"{id}: has two arms, whose motion is not shown; tracks/{id}.npz holds it")
        if not artifact_path(out, "tracks", id).is_file():
            raise UsageError(f"{id}: has no track to show ({row.reason or f'tracks/{id}.npz is absent'})")
        from kinebench_drake.report.replay import write_replays

        paths = write_replays(out, [id], _plant(out))
    except InputError as error:
        raise UsageError(str(error)) from None
    if not paths:
        raise UsageError(f"{id}: no frame is tracked, there is nothing to show")
    echo(paths[0])
    if opened and click.launch(paths[0].resolve().as_uri()) != 0:
        echo("no browser could be started; open the file yourself", err=True)


def _plant(out: Path) -> "ArmPlant":
    """Load the robot that a run was judged with."""
    from kinebench_drake.kinematics.plant import ArmPlant
    from kinebench_drake.models.arm import PANDA, load_converted, load_robot
    from kinebench_drake.models.named_arm import named_arms
    from kinebench_drake.report.run import read_results

    config = as_object(read_results(out).get("config"))
    id = config.get("robot_id")
    name = str(config.get("robot") or PANDA)
    robot = load_converted(str(id))
    if robot is None and name in named_arms():
        robot = load_robot(name)
        robot = robot if id in (None, robot.id) else None
    if robot is None:
        raise UsageError(f"{out}: its robot {name} is not in the cache of this machine; repeat the run here")
    return ArmPlant(robot)
