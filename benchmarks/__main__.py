"""`python -m benchmarks`: trajectories with known truth, and an audit's results held against it."""

import math
import os
from pathlib import Path

import click

from benchmarks.scale import COMMANDS
from kinebench_drake.errors import KinebenchError
from kinebench_drake.io.jsonl import dump, finite


@click.group(
    epilog="\b\nExample:\n"
    "  python -m benchmarks make --out tracks --kind infeasible --count 1000 --seed 0 --jobs 2\n"
    "  kinebench-drake audit tracks --out results\n"
    "  python -m benchmarks check results tracks",
)
def main() -> None:
    """Trajectories whose truth is known by proof."""


@main.command(
    epilog="\b\nExample:\n  python -m benchmarks make --out tracks --kind feasible --count 1000",
)
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder; made if absent.")
@click.option(
    "--kind",
    type=click.Choice(["feasible", "infeasible", "perturbed", "noisy"]),
    required=True,
    help="What to draw: motions the arm can make (also with noise), planted faults, or anything at all.",
)
@click.option("--count", type=click.IntRange(min=1), default=1000, show_default=True, metavar="N")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@click.option(
    "--noise-mm",
    type=click.FloatRange(min=0.0),
    default=0.0,
    help="Noise of `noisy`: standard deviation along each axis [mm]; half as many degrees about each.",
)
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True, help="Worker processes.")
def make(out: Path, kind: str, count: int, seed: int, noise_mm: float, jobs: int) -> None:
    """Draw trajectories and write them as npz files, with truth.jsonl beside them."""
    from benchmarks.tracks import Recipe, Set
    from benchmarks.tracks import make as make_set

    if noise_mm and kind != "noisy":
        raise click.UsageError(f"--noise-mm goes with --kind noisy, found --kind {kind}")
    recipe = Recipe(set=Set(kind), seed=seed, noise_m=1e-3 * noise_mm, noise_rad=math.radians(0.5 * noise_mm))
    try:
        with click.progressbar(make_set(recipe, count, out, jobs=jobs), length=count, label=kind) as truths:
            for _ in truths:
                pass
    except KinebenchError as error:
        raise click.ClickException(str(error)) from None
    click.echo(out)


@main.command(
    epilog="\b\nExample:\n  python -m benchmarks check results tracks",
)
@click.argument("results", type=click.Path(path_type=Path, exists=True))
@click.argument("tracks", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
def check(results: Path, tracks: Path, as_json: bool) -> None:
    """Compare an audit's output folder RESULTS with the truth in the folder TRACKS."""
    from benchmarks.check import compare, read_rows, table
    from benchmarks.sample import TRUTH, read_truth

    try:
        verdicts = compare(read_rows(results), read_truth(tracks / TRUTH))
    except KinebenchError as error:
        raise click.ClickException(str(error)) from None
    click.echo(dump([v.to_json() for v in verdicts], indent=2) if as_json else table(verdicts))


@main.command(
    epilog="\b\nExample:\n  python -m benchmarks bench --out docs/benchmarks.md",
)
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="Markdown file.  [default: on screen]")
@click.option("--json", "json_out", type=click.Path(path_type=Path, dir_okay=False), help="All numbers, as JSON.")
@click.option("--repeats", type=click.IntRange(min=1), default=9, show_default=True, help="Turns of each solver.")
@click.option("--tracks", type=click.IntRange(min=1), default=1000, show_default=True, help="Tracks of the throughput.")
@click.option("--audits", type=click.IntRange(min=1), default=200, show_default=True, help="Tracks audited whole.")
def bench(out: Path | None, json_out: Path | None, repeats: int, tracks: int, audits: int) -> None:
    """Measure the audit's speed, and its inverse kinematics beside that of other packages.

    Those that are not installed are left out and said to be: pip install 'kinebench-drake[bench]' brings them.
    """
    # Before NumPy is loaded: afterwards its libraries do not listen.
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))
    from benchmarks.bench import run_bench
    from benchmarks.markdown import keep_sections
    from benchmarks.page import document

    try:
        result = run_bench(repeats=repeats, tracks=tracks, audits=audits, note=lambda text: click.echo(text, err=True))
    except KinebenchError as error:
        raise click.ClickException(str(error)) from None
    if json_out is not None:
        json_out.write_text(dump(result.to_json(), indent=2))
    if out is None:
        click.echo(document(result))
    else:
        out.write_text(keep_sections(document(result), out.read_text() if out.is_file() else ""))
        click.echo(out)


@main.command(
    epilog="\b\nExample:\n  python -m benchmarks causes --episodes 5 --jobs 2",
)
@click.option("--episodes", type=click.IntRange(min=1), default=5, show_default=True, help="Of each task.", metavar="K")
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Number of the first of the seeds."
)
@click.option("--limit", type=click.IntRange(min=1), help="Run the first N cases only.", metavar="N")
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True, help="Worker processes.")
def causes(episodes: int, seed: int, limit: int | None, jobs: int) -> None:
    """Run episodes in closed loop with one planted cause of failure each, and see whether the verdict names it."""
    from benchmarks.causes import cases, finding_lines, run_cases
    from kinebench_drake.executors.base import ExecutorKind, create_executor
    from kinebench_drake.suites.suite import load_suite

    suite = load_suite(0)
    split = suite.split_name("test")
    draws = [draw for task in suite.tasks_of(split) for draw in suite.specs(split, task, episodes, offset=seed)]
    todo = cases(draws)[:limit]
    try:
        with click.progressbar(run_cases(create_executor(ExecutorKind.LOCAL, jobs), todo), length=len(todo)) as done:
            findings = sorted(done, key=lambda f: (f.case.draw.id, f.case.planted.name))
    except KinebenchError as error:
        raise click.ClickException(str(error)) from None
    for line in finding_lines(findings):
        click.echo(line)


@main.command(
    epilog="\b\nExample:\n"
    "  kinebench-drake suite demos --suite 2 --split unseen --episodes 5 --out heldout\n"
    "  python -m benchmarks calibration heldout --limit 20",
)
@click.argument("folder", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option("--limit", type=click.IntRange(min=1), help="So many videos only, tasks in turn.", metavar="N")
@click.option("--frames", type=click.IntRange(min=4), default=12, show_default=True, help="Of each video.", metavar="N")
@click.option(
    "--part",
    type=click.FloatRange(min=0.3, max=1.0),
    default=1.0,
    show_default=True,
    help="Show the middle of each picture only, so much of its sides: a longer lens than the usual one.",
)
@click.option("--quick", is_flag=True, help="With joint angles of all frames only.")
@click.option("--json", "json_out", type=click.Path(path_type=Path, dir_okay=False), help="All numbers, as JSON.")
def calibration(folder: Path, limit: int | None, frames: int, part: float, quick: bool, json_out: Path | None) -> None:
    """Find the cameras of rendered videos again, by all that may be known of the robot."""
    from benchmarks.calibration import CONDITIONS, measure, table
    from kinebench_drake.calibration.result import CalibrationMethod
    from kinebench_drake.io.atomic import write_atomically

    chosen = [c for c in CONDITIONS if c.method is CalibrationMethod.JOINTS] if quick else CONDITIONS
    trials = []
    try:
        for trial in measure(folder, limit=limit, frames=frames, part=part, conditions=chosen):
            trials.append(trial)
            if trial.condition == chosen[-1]:
                click.echo(trial.clip, err=True)
        if json_out is not None:
            write_atomically(json_out, dump(finite([trial.to_json() for trial in trials]), indent=1).encode())
    except KinebenchError as error:
        raise click.ClickException(str(error)) from None
    for line in table(trials):
        click.echo(line)


@main.command(
    epilog="\b\nExample:\n  python -m benchmarks equivalence results-before results-after",
)
@click.argument("before", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.argument("after", type=click.Path(path_type=Path, exists=True, file_okay=False))
def equivalence(before: Path, after: Path) -> None:
    """Compare two output folders of score, audit, ground or suite run; exit 1 if results differ.

    Everything must be byte-equal but for hashes of the code, versions, host, wall times, the wording of messages,
    report.html and replays.
    """
    from benchmarks.equivalence import compare_folders

    try:
        result = compare_folders(before, after)
    except KinebenchError as error:
        raise click.ClickException(str(error)) from None
    for line in result.differences:
        click.echo(line)
    click.echo(
        f"{len(result.equal)} files equal, {len(result.uncompared)} not compared, {len(result.differences)} differences"
    )
    if result.differences:
        raise SystemExit(1)


for command in COMMANDS:
    main.add_command(command)


if __name__ == "__main__":
    main(prog_name="python -m benchmarks")
