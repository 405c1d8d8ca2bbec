"""`python -m kinebench_drake.validation`: trajectories with known truth, and an audit's results held against it."""

import math
import os
from pathlib import Path

import click

from kinebench_drake.errors import KinebenchError
from kinebench_drake.row import dump, finite
from kinebench_drake.validation.scale import COMMANDS


@click.group(
    epilog="\b\nExample:\n"
    "  python -m kinebench_drake.validation make --out tracks --kind infeasible --count 1000 --seed 0 --jobs 2\n"
    "  kinebench-drake audit tracks --out results\n"
    "  python -m kinebench_drake.validation check results tracks",
)
def main() -> None:
    """Trajectories whose truth is known by proof."""


@main.command(
    epilog="\b\nExample:\n  python -m kinebench_drake.validation make --out tracks --kind feasible --count 1000",
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
    from kinebench_drake.validation.tracks import Recipe, Set
    from kinebench_drake.validation.tracks import make as make_set

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
    epilog="\b\nExample:\n  python -m kinebench_drake.validation check results tracks",
)
@click.argument("results", type=click.Path(path_type=Path, exists=True))
@click.argument("tracks", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
def check(results: Path, tracks: Path, as_json: bool) -> None:
    """Compare an audit's output folder RESULTS with the truth in the folder TRACKS."""
    from kinebench_drake.validation.check import compare, read_rows, table
    from kinebench_drake.validation.sample import TRUTH, read_truth

    try:
        verdicts = compare(read_rows(results), read_truth(tracks / TRUTH))
    except KinebenchError as error:
        raise click.ClickException(str(error)) from None
    click.echo(dump([v.to_json() for v in verdicts], indent=2) if as_json else table(verdicts))


@main.command(
    epilog="\b\nExample:\n  python -m kinebench_drake.validation bench --out docs/benchmarks.md",
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
    from kinebench_drake.markdown import keep_sections
    from kinebench_drake.validation.bench import run_bench
    from kinebench_drake.validation.page import document

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
    epilog="\b\nExample:\n  python -m kinebench_drake.validation causes --episodes 5 --jobs 2",
)
@click.option("--episodes", type=click.IntRange(min=1), default=5, show_default=True, help="Of each task.", metavar="K")
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Number of the first of the seeds."
)
@click.option("--limit", type=click.IntRange(min=1), help="Run the first N cases only.", metavar="N")
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True, help="Worker processes.")
def causes(episodes: int, seed: int, limit: int | None, jobs: int) -> None:
    """Run episodes in closed loop with one planted cause of failure each, and see whether the verdict names it."""
    from kinebench_drake.engines import EngineKind, create_engine
    from kinebench_drake.suites.suite import load_suite
    from kinebench_drake.validation.causes import cases, finding_lines, run_cases

    suite = load_suite(0)
    split = suite.split_name("test")
    draws = [draw for task in suite.tasks_of(split) for draw in suite.draws(split, task, episodes, offset=seed)]
    todo = cases(draws)[:limit]
    try:
        with click.progressbar(run_cases(create_engine(EngineKind.LOCAL, jobs), todo), length=len(todo)) as done:
            findings = sorted(done, key=lambda f: (f.case.draw.id, f.case.planted.name))
    except KinebenchError as error:
        raise click.ClickException(str(error)) from None
    for line in finding_lines(findings):
        click.echo(line)


@main.command(
    epilog="\b\nExample:\n"
    "  kinebench-drake suite demos --suite 2 --split unseen --episodes 5 --out heldout\n"
    "  python -m kinebench_drake.validation calibration heldout --limit 20",
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
    from kinebench_drake.calibration.calibration import Method
    from kinebench_drake.storage import write_atomically
    from kinebench_drake.validation.calibration import CONDITIONS, measure, table

    chosen = [c for c in CONDITIONS if c.method is Method.JOINTS] if quick else CONDITIONS
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
    epilog="\b\nExample:\n  python -m kinebench_drake.validation fuzz --count 20000 --seed 0 --out fuzz",
)
@click.option("--count", type=click.IntRange(min=1), default=20_000, show_default=True, metavar="N")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@click.option("--first", type=click.IntRange(min=0), default=0, help="Number to begin with.", metavar="NUMBER")
@click.option("--only", type=click.IntRange(min=0), multiple=True, metavar="NUMBER", help="Read these inputs alone.")
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder for the inputs that fail."
)
def fuzz(count: int, seed: int, first: int, only: tuple[int, ...], out: Path) -> None:
    """Make valid inputs of every kind wrong and have the program read them.

    Each has to be read, or refused in one line: without traceback, hang, crash or a flood of memory.
    """
    from kinebench_drake.validation.fuzz.campaign import Campaign, Trial, distinct, table

    numbers = only or range(first, first + count)
    trials: list[Trial] = []
    try:
        with click.progressbar(Campaign(seed).run(numbers, out), length=len(numbers), label="fuzz") as done:
            trials.extend(done)
    except KeyboardInterrupt:
        click.echo(f"interrupted after {len(trials)} of {len(numbers)} inputs", err=True)
    except KinebenchError as error:
        raise click.ClickException(str(error)) from None
    for line in table(trials):
        click.echo(line)
    failed = distinct(trials)
    for told, which in failed.items():
        click.echo(f"{len(which)} x {told} (such as {which[0]})")
    if failed:
        raise SystemExit(1)


@main.command(
    epilog="\b\nExamples:\n"
    "  python -m kinebench_drake.validation kills --count 50 --seed 0 --out kills\n"
    "  python -m kinebench_drake.validation kills --count 50 --interrupt --out interrupts",
)
@click.option("--count", type=click.IntRange(min=1), default=50, show_default=True, metavar="N", help="Stops.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@click.option("--interrupt", is_flag=True, help="Interrupt (Ctrl-C) instead of kill -9.")
@click.option(
    "--videos", type=click.Path(path_type=Path, exists=True, file_okay=False), default=Path("examples/videos"),
    show_default=True, help="Videos for `score`.",
)  # fmt: skip
@click.option("--jobs", type=click.IntRange(min=1), default=2, show_default=True, help="Worker processes of each run.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder; made if absent.")
def kills(count: int, seed: int, interrupt: bool, videos: Path, jobs: int, out: Path) -> None:
    """Stop runs of `audit` and `score` at random moments, go on, and compare with runs that nobody stopped."""
    from kinebench_drake.validation.kills import Finished, Stop, make_jobs, torment

    if out.is_dir() and any(out.iterdir()):
        raise click.UsageError(f"--out {out}: holds something already; name a new folder")
    stops = [Stop.INTERRUPT] if interrupt else [Stop.ALL, Stop.ONE]
    faults = stopped = finished = 0
    try:
        for event in torment(make_jobs(videos, out, jobs), stops, count, seed, out):
            faults += bool(event.fault)
            if isinstance(event, Finished):
                finished += 1
                told = f"{event.job} finished after {event.stops} stops: {event.fault or 'the same files'}"
            else:
                stopped += 1
                told = (
                    f"{event.job}: {event.stop.value} after {event.at_s:.1f} s, {event.before} then {event.after} done"
                )
                told += f": {event.fault}" if event.fault else ""
            click.echo(told, err=True)
    except KinebenchError as error:
        raise click.ClickException(str(error)) from None
    click.echo(f"{stopped} stops, {finished} runs brought to their end, {faults} faults")
    if faults:
        raise SystemExit(1)


for command in COMMANDS:
    main.add_command(command)


if __name__ == "__main__":
    main(prog_name="python -m kinebench_drake.validation")
