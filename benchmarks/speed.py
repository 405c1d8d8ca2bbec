"""Commands that measure accuracy, speed and memory: each writes a result file and compares it with the one before."""

import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import click

from benchmarks.options import (
    COUNT,
    EXAMPLES,
    EXISTING_FOLDER,
    FOLDER,
    baseline_option,
    jobs_option,
    log,
    one_thread,
    work_folder,
    work_option,
)
from benchmarks.record import PAGES, RESULTS, BenchmarkRecord, compare_records, sources_hash, write_pages

results_option = click.option(
    "--results", type=FOLDER, default=RESULTS, show_default=True, help="Folder of the result files."
)

video_option = click.option(
    "--video", type=click.Path(path_type=Path, dir_okay=False, exists=True),
    default=EXAMPLES / "StackCube-v1_s0010_unseen.mp4", show_default=True, help="Video that is processed.",
)  # fmt: skip

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


@click.command(epilog="\b\nExample:\n  python -m benchmarks audit")
@results_option
@click.option("--tracks", type=COUNT, default=1000, show_default=True, help="Tracks without optimisation.")
@click.option("--audits", type=COUNT, default=200, show_default=True, help="Whole audits.")
def audit(results: Path, tracks: int, audits: int) -> None:
    """Measure the speed of the audit in one process."""
    one_thread()
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


@click.command(epilog="\b\nExample:\n  python -m benchmarks gpu")
@results_option
@work_option
@video_option
@click.option("--count", type=click.IntRange(9), default=16, show_default=True, help="Copies of the video.")
@click.option("--turns", type=COUNT, default=2, show_default=True, help="Measurements with and without the GPU.")
def gpu(results: Path, work: Path | None, video: Path, count: int, turns: int) -> None:
    """Measure networks, training, images of the simulator and whole runs with and without the GPU."""
    from benchmarks.gpu import figures, measure, section

    with work_folder(work) as folder:
        costs = measure(video, folder, videos=count, turns=turns, log=log)
    _record("gpu", results, figures(costs), section(costs))


@click.command(epilog="\b\nExample:\n  python -m benchmarks streaming")
@results_option
@work_option
@click.option("--videos", type=EXISTING_FOLDER, default=EXAMPLES, show_default=True, help="Folder of mp4 files.")
@click.option("--samples", type=click.IntRange(80), default=2000, show_default=True, help="Videos scored.")
@click.option("--frames", type=click.IntRange(2), default=4, show_default=True, help="Frames of each video.")
@click.option("--jobs", type=COUNT, default=2, show_default=True, help="Worker processes.")
def streaming(results: Path, work: Path | None, videos: Path, samples: int, frames: int, jobs: int) -> None:
    """Score very many short videos; measure memory, the report and a second run."""
    from benchmarks.streaming import figures, measure, section

    with work_folder(work) as folder:
        result = measure(videos, folder, samples=samples, frames=frames, jobs=jobs, log=log)
    _record("streaming", results, figures(result), section(result))


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


@click.command(epilog="\b\nExample:\n  python -m benchmarks cluster")
@results_option
@work_option
@click.option(
    "--videos", type=click.Path(path_type=Path, exists=True), default=EXAMPLES / "manifest.jsonl", show_default=True,
    help="Videos scored.",
)  # fmt: skip
@click.option(
    "--tasks", default="PullCube-v1,OpenDrawer-v1", show_default=True, help="Tasks of the suite run.", metavar="A,B"
)
@click.option("--episodes", type=COUNT, default=2, show_default=True, help="Episodes of each task.", metavar="K")
def cluster(results: Path, work: Path | None, videos: Path, tasks: str, episodes: int) -> None:
    """Score and run a suite on a Ray cluster of two local nodes, kill a worker, and compare with local runs."""
    from benchmarks.cluster import SUITE, compare_runs, section

    suite = ["suite", "run", *SUITE, "--tasks", tasks, "--episodes", str(episodes)]
    commands = [["score", str(videos), "--overlay"], suite]
    with work_folder(work) as folder:
        text = section(compare_runs(commands, folder, log))
    _record("cluster", results, {}, text)


@click.command(epilog="\b\nExample:\n  python -m benchmarks simulation")
@results_option
@click.option("--tasks", help="Tasks, comma-separated.  [default: all]", metavar="A,B")
def simulation(results: Path, tasks: str | None) -> None:
    """Measure the speed of environments, rendering and demonstrations."""
    from benchmarks.simulation import figures, measure, section
    from kinebench_drake.suites.families.registry import TASKS

    timings, steps, images = measure(list(TASKS) if tasks is None else tasks.split(","))
    _record("simulation", results, figures(timings), section(timings, steps, images))


@click.command(epilog="\b\nExample:\n  python -m benchmarks rounds --tasks StackCube-v1,OpenDrawer-v1 --episodes 2")
@results_option
@work_option
@click.option("--tasks", help="Tasks, comma-separated.  [default: all of suite 0]", metavar="A,B")
@click.option("--episodes", type=COUNT, default=1, show_default=True, help="Episodes of each task.", metavar="K")
def rounds(results: Path, work: Path | None, tasks: str | None, episodes: int) -> None:
    """Measure the time of a round of the closed loop, stage by stage."""
    one_thread()
    from benchmarks.rounds import figures, measure, section
    from kinebench_drake.cli.progress import ProgressView

    with work_folder(work) as folder, ProgressView("episodes") as view:
        timing = measure(tasks, episodes, folder / "rounds", view)
    _record("rounds", results, figures(timing), section(timing))


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
        measured = measure(_heldout(heldout, work), others, work, view, log)
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


@click.command(
    epilog="\b\nExamples:\n"
    "  python -m benchmarks figures\n"
    "  python -m benchmarks figures --measure accuracy --others robosuite --others clips",
)
@results_option
@click.option(
    "--measure", type=FOLDER, metavar="WORK",
    help="Measure first what was measured with other sources; hours. WORK keeps finished poses.",
)  # fmt: skip
@others_option
def figures(results: Path, measure: Path | None, others: tuple[Path, ...]) -> None:
    """Write the tables of the pages from the result files.

    With --measure benchmarks run one after the other. Their results are kept: after an interruption the same command
    goes on with the next one.
    """
    arguments = {
        "accuracy": ["--work", str(measure), *(part for path in others for part in ("--others", str(path)))],
        "robustness": ["--work", str(measure)],
    }
    for name in PAGES if measure else ():
        record = BenchmarkRecord.read(name, results)
        if record is None or record.sources_sha256 != sources_hash():
            command = [sys.executable, "-m", "benchmarks", name, "--results", str(results)]
            if subprocess.run([*command, *arguments.get(name, [])]).returncode:
                log(f"{name} failed")
    for line in write_pages(results):
        click.echo(line)


COMMANDS = (
    accuracy,
    robustness,
    ik,
    audit,
    throughput,
    gpu,
    streaming,
    scale,
    cluster,
    simulation,
    rounds,
    figures,
)
