"""Commands that measure accuracy, speed and memory: each writes a result file and compares it with the one before."""

from collections.abc import Mapping
from functools import partial
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
    one_thread,
    out_option,
    work_folder,
    work_option,
    write_section,
)
from benchmarks.record import RESULTS, BenchmarkRecord, compare_records, write_pages

results_option = click.option(
    "--results", type=FOLDER, default=RESULTS, show_default=True, help="Folder of the result files."
)

others_option = click.option(
    "--others", type=EXISTING_FOLDER, multiple=True, help="Videos of others, as `footage` takes them; repeatable."
)

heldout_option = click.option(
    "--heldout", type=EXISTING_FOLDER, help="Output folder of `suite demos`.  [default: made in --work]"
)


def _record(name: str, results: Path, figures: Mapping[str, float], section: str) -> None:
    """Print the section, write the result, and print what became worse since the result before."""
    click.echo(section)
    before = BenchmarkRecord.read(name, results)
    now = BenchmarkRecord.of(name, figures, section)
    log(now.write(results))
    for line in compare_records(before, now) if before else ():
        log(line)


def _score(videos: Path, out: Path) -> Path:
    """Score a folder of videos; returns the output folder."""
    from benchmarks.process import run_program

    run_program(["score", str(videos), "--out", str(out), "--replays", "0", "--frame-period", "0.2"])
    return out


def _heldout(heldout: Path | None, work: Path) -> Path:
    """Return the folder of held-out renderings, made in the work folder if none is named."""
    from benchmarks.accuracy import HELDOUT
    from benchmarks.process import run_program

    work.mkdir(parents=True, exist_ok=True)
    if heldout is None:
        heldout = work / "heldout"
        run_program([*HELDOUT, "--out", str(heldout)])
    return heldout


@click.command(epilog="\b\nExample:\n  python -m benchmarks ik")
@results_option
@click.option("--repeats", type=COUNT, default=9, show_default=True, help="Turns of each solver.")
def ik(results: Path, repeats: int) -> None:
    """Compare inverse kinematics with that of other packages.

    Packages that are not installed are listed as such: pip install 'kinebench-drake[bench]' installs them.
    """
    one_thread()
    from benchmarks.ik import compare_ik, figures, section

    result = compare_ik(repeats=repeats, log=log)
    _record("ik", results, figures(result), section(result))


@click.command(
    epilog="\b\nExamples:\n  python -m benchmarks audit\n  python -m benchmarks audit --robot so100 --robot ur5e"
)
@results_option
@click.option("--tracks", type=COUNT, default=1000, show_default=True, help="Tracks without optimisation.")
@click.option(
    "--audits", type=COUNT, default=200, show_default=True, help="Whole audits; of each arm half with faults."
)
@click.option("--robot", "robots", multiple=True, help="Arm by name whose verdicts are compared with planted faults.")
def audit(results: Path, tracks: int, audits: int, robots: tuple[str, ...]) -> None:
    """Measure the speed of the audit in one process, or compare the verdicts on arms by name with planted faults."""
    one_thread()
    if robots:
        from benchmarks.arms import ArmWorker, arm_table
        from benchmarks.trials import run_trials

        trials = [(name, trial) for name in robots for trial in run_trials(partial(ArmWorker, name), audits, seed=0)]
        click.echo("\n".join(arm_table(trials)))
        return
    from benchmarks.audit import figures, measure, section

    result = measure(tracks=tracks, audits=audits, log=log)
    _record("audit", results, figures(result), section(result))


@click.command(epilog="\b\nExample:\n  python -m benchmarks throughput")
@results_option
@work_option
@click.option(
    "--videos", type=EXISTING_FOLDER,
    help="Output folder of `suite demos` with 24 different videos or more.  [default: made in --work]",
)  # fmt: skip
@click.option("--tracks", type=click.IntRange(3), default=200, show_default=True, help="Trajectories audited.")
@click.option("--turns", type=COUNT, default=3, show_default=True, help="Runs of each setting.")
def throughput(results: Path, work: Path | None, videos: Path | None, tracks: int, turns: int) -> None:
    """Measure runs of score and audit with one and two processes, without a GPU; score in both precisions."""
    from benchmarks.throughput import figures, measure, section

    with work_folder(work) as folder:
        costs = measure(_heldout(videos, folder), folder, tracks=tracks, turns=turns, log=log)
    _record("throughput", results, figures(costs), section(costs, tracks=tracks))


@click.command(epilog="\b\nExample:\n  python -m benchmarks scale --rows 100000")
@results_option
@work_option
@click.option("--videos", type=EXISTING_FOLDER, default=EXAMPLES, show_default=True, help="Folder of mp4 files.")
@click.option(
    "--template", type=EXISTING_FOLDER, help="Output folder of `score` whose rows are returned.  [default: made first]"
)
@click.option("--rows", type=click.IntRange(10), default=100_000, show_default=True, help="Samples.")
@click.option("--jobs", type=COUNT, default=2, show_default=True, help="Worker processes.")
def scale(results: Path, work: Path | None, videos: Path, template: Path | None, rows: int, jobs: int) -> None:
    """Measure time and memory of a run of very many samples whose measurements are replaced."""
    from benchmarks.scale import figures, measure, section

    with work_folder(work) as folder:
        model = template or _score(videos, folder / "template")
        result = measure(videos, model, folder, rows=rows, jobs=jobs, log=log)
    _record("scale", results, figures(result), section(result))


@click.command(epilog="\b\nExample:\n  python -m benchmarks simulation")
@results_option
@click.option("--tasks", help="Tasks, comma-separated.  [default: all]", metavar="A,B")
def simulation(results: Path, tasks: str | None) -> None:
    """Measure the speed of environments, rendering and demonstrations."""
    from benchmarks.simulation import figures, measure, section
    from kinebench_drake.suites.families.registry import TASKS

    timings = measure(list(TASKS) if tasks is None else tasks.split(","))
    _record("simulation", results, figures(timings), section(timings))


@click.command(
    epilog="\b\nExample:\n"
    "  python -m benchmarks accuracy --heldout heldout --others robosuite --others clips --work accuracy"
)
@results_option
@heldout_option
@others_option
@click.option("--work", type=FOLDER, required=True, help="Results; an earlier run is resumed.")
def accuracy(results: Path, heldout: Path | None, others: tuple[Path, ...], work: Path) -> None:
    """Measure the errors of poses on held-out renderings and on videos of other programs and cameras."""
    one_thread()
    from benchmarks.accuracy import figures, measure, section
    from kinebench_drake.cli.progress import ProgressView

    with ProgressView("videos") as view:
        measured = measure(_heldout(heldout, work), others, work, view)
    _record("accuracy", results, figures(*measured), section(*measured))


@click.command(epilog="\b\nExample:\n  python -m benchmarks robustness --heldout heldout --work robustness --jobs 2")
@results_option
@heldout_option
@click.option("--work", type=FOLDER, required=True, help="Finished measurements; an earlier run is resumed.")
@baseline_option
@click.option("--limit", type=COUNT, help="Number of videos, tasks in turn.  [default: all]", metavar="N")
@jobs_option
def robustness(results: Path, heldout: Path | None, work: Path, weights: Path, limit: int | None, jobs: int) -> None:
    """Measure grounding and inverse-dynamics baseline on held-out renderings, unchanged and perturbed.

    Also draws docs/robustness.png.
    """
    one_thread()
    from benchmarks.robustness import FIGURE, draw, figures, measure, section
    from kinebench_drake.cli.progress import ProgressView
    from kinebench_drake.io.figure import save
    from training.baseline.network import Baseline

    with ProgressView("measurements") as view:
        outcome = measure(_heldout(heldout, work), weights, work / "robustness.jsonl", limit, jobs, view)
        save(draw(outcome), FIGURE)
    baseline = Baseline.load(weights)
    _record("robustness", results, figures(outcome), section(outcome, baseline.training))


@click.command(epilog="\b\nExample:\n  python -m benchmarks figures")
@results_option
def figures(results: Path) -> None:
    """Write the tables of the pages from the result files."""
    for line in write_pages(results):
        click.echo(line)


@click.command(
    epilog="\b\nExamples:\n  python -m benchmarks rate --out docs/reward.md\n  python -m benchmarks rate --memory 2000"
)
@click.option(
    "--videos", type=EXISTING_FOLDER, default=EXAMPLES, show_default=True, help="Clean clips with their truth."
)
@click.option("--limit", type=COUNT, help="Number of clips.  [default: all]", metavar="N")
@click.option("--faults", type=click.IntRange(0), default=4, show_default=True, help="Faults in each clip, by itself.")
@click.option("--jobs", type=click.IntRange(0), default=2, show_default=True, help="Processes of the rate; 0: none.")
@click.option("--memory", type=COUNT, help="Only score N clips, and print the resident memory.", metavar="N")
@click.option("--stride", type=COUNT, default=2, show_default=True, help="Stride with --memory.")
@out_option
def rate(
    videos: Path, limit: int | None, faults: int, jobs: int, memory: int | None, stride: int, out: Path | None
) -> None:
    """Measure the reward of 25 frames of 256 px: processor time by stage, errors, faults of one frame, memory."""
    one_thread()
    from benchmarks.rate import cut_clips, measure, measure_memory, rate_section, wall_rates

    camera = videos / "camera.json"
    clips = cut_clips(videos)[:limit]
    if memory is not None:
        for count, seconds, resident_mb in measure_memory(clips, camera, memory, stride, max(1, jobs)):
            click.echo(f"{count} clips, {seconds:.0f} s: {' + '.join(f'{mb:.0f}' for mb in resident_mb)} MB")
        return
    runs, trials = measure(clips, camera, faults=faults, log=log)
    walls = wall_rates(clips, camera, jobs) if jobs else {}
    write_section(out, markdown.section("Rates", rate_section(runs, trials, walls)))


COMMANDS = (accuracy, robustness, ik, audit, throughput, scale, simulation, rate, figures)
