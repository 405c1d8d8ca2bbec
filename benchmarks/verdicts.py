"""Commands that compare verdicts, causes of failure and metrics with planted ones."""

import math
from pathlib import Path

import click

from benchmarks import markdown
from benchmarks.options import (
    COUNT,
    EXAMPLES,
    EXISTING_FOLDER,
    FOLDER,
    baseline_option,
    jobs_option,
    log,
    out_option,
    write_section,
)


@click.command(epilog="\b\nExample:\n  python -m benchmarks causes --episodes 5 --jobs 2")
@click.option("--episodes", type=COUNT, default=5, show_default=True, help="Episodes of each task.", metavar="K")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="First seed.")
@click.option("--limit", type=COUNT, help="Run the first N cases only.", metavar="N")
@jobs_option
def causes(episodes: int, seed: int, limit: int | None, jobs: int) -> None:
    """Run episodes in closed loop with one planted cause of failure each, and compare with the verdicts."""
    from benchmarks.causes import CauseWorker, cause_cases, cause_table
    from benchmarks.trials import run_all
    from kinebench_drake.suites.catalog import load_suite

    suite = load_suite(0)
    split = suite.split_name("test")
    specs = suite.specs(split, episodes, offset=seed)
    cases = cause_cases(specs)[:limit]
    with click.progressbar(run_all(CauseWorker, cases, jobs), length=len(cases)) as results:
        ordered = sorted(results, key=lambda r: (r.case.spec.id, r.case.planted.name))
    for line in cause_table(ordered):
        click.echo(line)


@click.command(epilog="\b\nExample:\n  python -m benchmarks loss --count 1000 --jobs 2")
@click.option("--count", type=COUNT, default=1000, show_default=True, help="Random tracks.", metavar="N")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@jobs_option
def loss(count: int, seed: int, jobs: int) -> None:
    """Replace frames of random tracks by lost or unreachable ones; exit status 1 if a number improves."""
    from benchmarks.loss import LossWorker, loss_table
    from benchmarks.trials import run_trials

    with click.progressbar(run_trials(LossWorker, count, seed, jobs), length=count) as trials:
        ordered = sorted(trials, key=lambda trial: trial.index)
    for line in loss_table(ordered):
        click.echo(line)
    if any(trial.improved for trial in ordered):
        raise SystemExit(1)


@click.group()
def validity() -> None:
    """Numbers of videos with planted faults: which of them respond to which fault, and which predict success."""


@validity.command(
    name="measure", epilog="\b\nExample:\n  python -m benchmarks validity measure --work validity --jobs 2"
)
@click.option("--work", type=FOLDER, required=True, help="Folder of videos and results; an earlier run is resumed.")
@click.option("--episodes", type=COUNT, default=40, show_default=True, help="Clean episodes, tasks in turn.")
@click.option("--sizes", type=click.IntRange(1, 3), default=3, show_default=True, help="Sizes of each kind of fault.")
@jobs_option
def validity_measure(work: Path, episodes: int, sizes: int, jobs: int) -> None:
    """Render episodes without and with planted faults, score the videos and execute their tracks.

    An interrupted run continues where it was; more --episodes extend an earlier run.
    """
    from benchmarks.validity import measure
    from kinebench_drake.cli.progress import ProgressView

    work.mkdir(parents=True, exist_ok=True)
    with ProgressView("steps") as view:
        measure(work, episodes, sizes, jobs, view)
    click.echo(work)


@validity.command(
    name="report", epilog="\b\nExample:\n  python -m benchmarks validity report validity --out docs/validity.md"
)
@click.argument("work", type=EXISTING_FOLDER)
@out_option
def validity_report(work: Path, out: Path | None) -> None:
    """Print the tables of the study in the folder WORK, and write tables and figures into a page."""
    from benchmarks.validity import read_study
    from benchmarks.validity_report import write_report

    sections = write_report(*read_study(work), work if out is None else out.parent)
    for text in sections:
        write_section(out, text)


@click.command(
    epilog="\b\nExamples:\n"
    "  python -m benchmarks validity measure --work validity --jobs 2\n"
    "  python -m benchmarks extractors validity --jobs 2 --out docs/validity.md"
)
@click.argument("work", type=EXISTING_FOLDER)
@baseline_option
@jobs_option
@out_option
def extractors(work: Path, weights: Path, jobs: int, out: Path | None) -> None:
    """Execute the videos of a validity study through truth, grounding and baseline, and count changed outcomes.

    WORK is the folder of `validity measure`. An interrupted run continues where it was.
    """
    from benchmarks.extractors import FIGURE, draw, measure, section
    from kinebench_drake.cli.progress import ProgressView
    from kinebench_drake.io.figure import save
    from training.baseline.network import Baseline

    with ProgressView("executions") as view:
        done = measure(work, weights, jobs, view)
        save(draw(done), (work if out is None else out.parent) / FIGURE)
        text = section(done, Baseline.load(weights).training)
    write_section(out, text)


@click.command(epilog="\b\nExample:\n  python -m benchmarks generated study --jobs 2 --out docs/worldmodel.md")
@click.argument("study", type=EXISTING_FOLDER)
@baseline_option
@jobs_option
@out_option
def generated(study: Path, weights: Path, jobs: int, out: Path | None) -> None:
    """Tabulate the success of generated videos, and compare verdicts and tracks with what a person sees.

    STUDY is the folder that examples/worldmodel/study.sh made. An interrupted run continues where it was.
    """
    from benchmarks.generated import BEST, sections
    from benchmarks.generated_labels import EyeStudy
    from kinebench_drake.cli.progress import ProgressView

    texts = [*sections(study)]
    if (study / BEST).exists():
        with ProgressView("clips") as view:
            texts += EyeStudy(study, weights).sections(jobs, view)
    for text in texts:
        write_section(out, text)


@click.group()
def trajectories() -> None:
    """Trajectories with ground truth by proof, and audits compared with it."""


@trajectories.command(
    epilog="\b\nExample:\n  python -m benchmarks trajectories make --out tracks --kind feasible --count 1000",
)
@click.option("--out", type=FOLDER, required=True, help="Folder; created if absent.")
@click.option(
    "--kind",
    type=click.Choice(["feasible", "infeasible", "noisy"]),
    required=True,
    help="Feasible motions (also with noise), or planted faults.",
)
@click.option("--count", type=COUNT, default=1000, show_default=True, metavar="N")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@click.option(
    "--noise-mm",
    type=click.FloatRange(min=0.0),
    default=0.0,
    help="Noise of `noisy`: standard deviation along each axis [mm]; half as many degrees about each.",
)
@jobs_option
def make(out: Path, kind: str, count: int, seed: int, noise_mm: float, jobs: int) -> None:
    """Draw trajectories and write them as npz files, with truth.jsonl."""
    from benchmarks.trajectory_sets import Recipe, TrajectorySet, write_set

    if noise_mm and kind != "noisy":
        raise click.UsageError(f"--noise-mm goes with --kind noisy, found --kind {kind}")
    noise_rad = math.radians(0.5 * noise_mm)
    recipe = Recipe(set=TrajectorySet(kind), seed=seed, noise_m=1e-3 * noise_mm, noise_rad=noise_rad)
    with click.progressbar(write_set(recipe, count, out, jobs=jobs), length=count, label=kind) as truths:
        for _ in truths:
            pass
    click.echo(out)


@trajectories.command(epilog="\b\nExample:\n  python -m benchmarks trajectories check results tracks")
@click.argument("results", type=click.Path(path_type=Path, exists=True))
@click.argument("tracks", type=EXISTING_FOLDER)
def check(results: Path, tracks: Path) -> None:
    """Compare an audit's output folder RESULTS with the ground truth in the folder TRACKS."""
    from benchmarks.check import compare, read_rows, summary_table
    from benchmarks.trajectory import TRUTH, read_truths

    click.echo(summary_table(compare(read_rows(results), read_truths(tracks / TRUTH))))


@trajectories.command(epilog="\b\nExample:\n  python -m benchmarks trajectories robots --count 1000 --jobs 2")
@click.option("--count", type=COUNT, default=1000, show_default=True, help="Random motions.", metavar="N")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@jobs_option
def robots(count: int, seed: int, jobs: int) -> None:
    """Judge motions within the limits of the Panda or of the FR3 by those of both, and compare with their proofs."""
    from benchmarks.robots import RobotWorker, robot_table
    from benchmarks.trials import run_trials

    with click.progressbar(run_trials(RobotWorker, count, seed, jobs), length=count) as trials:
        ordered = sorted(trials, key=lambda trial: trial.index)
    for line in robot_table(ordered):
        click.echo(line)


@click.command(
    epilog="\b\nExample:\n  python -m benchmarks precision heldout examples/videos/manifest.jsonl --work precision"
)
@click.argument("videos", type=click.Path(path_type=Path, exists=True), nargs=-1, required=True)
@click.option("--work", type=FOLDER, required=True, help="Output folders of score; an earlier run is resumed.")
@jobs_option
@out_option
def precision(videos: tuple[Path, ...], work: Path, jobs: int, out: Path | None) -> None:
    """Score VIDEOS with the networks in float32 and in bfloat16 and list each verdict that differs.

    Exit 1 if one precision says yes where the other says no.
    """
    from benchmarks.precision import report, score_both

    results = {}
    for source in videos:
        name = (source if source.is_dir() else source.parent).name
        results[name] = score_both(source, work / name, jobs, log)
    text, contradictions = report(results)
    write_section(out, text)
    if contradictions:
        raise SystemExit(1)


@click.command(epilog="\b\nExample:\n  python -m benchmarks hacks")
@click.option(
    "--videos", type=EXISTING_FOLDER, default=EXAMPLES, show_default=True, help="Clean clips with their truth."
)
@click.option("--limit", type=COUNT, help="Number of clips.  [default: all]", metavar="N")
@out_option
def hacks(videos: Path, limit: int | None, out: Path | None) -> None:
    """Score clips that are no better than the honest one, beside it: none should pay more."""
    from benchmarks import reward

    scores = reward.measure_hacks(reward.read_clips(videos)[:limit], videos / "camera.json", log)
    write_section(out, markdown.section("Hacks", reward.hack_lines(scores)))


@click.command(epilog="\b\nExample:\n  python -m benchmarks executability --tracks results/tracks")
@click.option(
    "--videos", type=EXISTING_FOLDER, default=EXAMPLES, show_default=True, help="Clean clips with their truth."
)
@click.option("--limit", type=COUNT, help="Number of clips.  [default: all]", metavar="N")
@click.option("--tracks", type=EXISTING_FOLDER, multiple=True, help="Folder of track files.")
@out_option
def executability(videos: Path, limit: int | None, tracks: tuple[Path, ...], out: Path | None) -> None:
    """Score faults of eight sizes each in pictures and in tracks: the score should fall with the size."""
    from benchmarks import reward

    files = [file for folder in tracks for file in sorted(folder.glob("*.npz"))]
    clips = reward.read_clips(videos)[:limit]
    grades = [*reward.grade_tracks(files, log), *reward.grade_videos(clips, videos / "camera.json", log)]
    write_section(out, markdown.section("Graded faults", reward.grade_lines(grades)))


COMMANDS = (
    hacks,
    executability,
    precision,
    causes,
    loss,
    validity,
    extractors,
    generated,
    trajectories,
)
