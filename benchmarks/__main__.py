"""`python -m benchmarks`: validation studies and benchmarks."""

import math
from pathlib import Path

import click

from benchmarks import speed
from benchmarks.options import (
    COUNT,
    EXISTING_FILE,
    EXISTING_FOLDER,
    FILE,
    FOLDER,
    baseline_option,
    errors,
    jobs_option,
    log,
    one_thread,
    out_option,
    write_section,
)
from kinebench_drake.errors import KinebenchError
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.io.jsonl import dump, finite
from kinebench_drake.types import AnomalyKind

KINDS = tuple(kind.value for kind in AnomalyKind)


@click.group(
    epilog="\b\nExample:\n"
    "  python -m benchmarks trajectories make --out tracks --kind infeasible --count 1000 --jobs 2\n"
    "  kinebench-drake audit tracks --out results\n"
    "  python -m benchmarks trajectories check results tracks",
)
def main() -> None:
    """Validation studies and benchmarks; each command has an example."""


for command in speed.COMMANDS:
    main.add_command(command)


@main.command(
    epilog="\b\nExample:\n"
    "  kinebench-drake suite demos --suite 2 --split unseen --episodes 5 --out heldout\n"
    "  python -m benchmarks calibration heldout --limit 20",
)
@click.argument("folder", type=EXISTING_FOLDER)
@click.option("--limit", type=COUNT, help="Maximum number of videos, tasks in turn.", metavar="N")
@click.option(
    "--frames", type=click.IntRange(min=4), default=12, show_default=True, help="Frames a video.", metavar="N"
)
@click.option(
    "--part",
    type=click.FloatRange(min=0.3, max=1.0),
    default=1.0,
    show_default=True,
    help="Keep the middle of each image only, this share of its sides: a longer focal length.",
)
@click.option("--quick", is_flag=True, help="Only with the joint angles of all frames.")
@click.option("--json", "json_out", type=FILE, help="All figures, as JSON.")
def calibration(folder: Path, limit: int | None, frames: int, part: float, quick: bool, json_out: Path | None) -> None:
    """Calibrate the cameras of rendered videos with all kinds of prior information about the robot."""
    from benchmarks.calibration import CONDITIONS, measure, trial_table
    from kinebench_drake.calibration.result import CalibrationMethod

    conditions = [c for c in CONDITIONS if c.method is CalibrationMethod.JOINTS] if quick else CONDITIONS
    trials = []
    with errors():
        for trial in measure(folder, limit=limit, frames=frames, part=part, conditions=conditions):
            trials.append(trial)
            if trial.condition == conditions[-1]:
                log(trial.clip)
        if json_out is not None:
            write_atomically(json_out, dump(finite([trial.to_json() for trial in trials]), indent=1).encode())
    for line in trial_table(trials):
        click.echo(line)


@main.command(epilog="\b\nExample:\n  python -m benchmarks causes --episodes 5 --jobs 2")
@click.option("--episodes", type=COUNT, default=5, show_default=True, help="Episodes of each task.", metavar="K")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="First seed.")
@click.option("--limit", type=COUNT, help="Run the first N cases only.", metavar="N")
@jobs_option
def causes(episodes: int, seed: int, limit: int | None, jobs: int) -> None:
    """Run episodes in closed loop with one planted cause of failure each, and compare with the verdicts."""
    from benchmarks.causes import cause_cases, cause_table, run_cases
    from kinebench_drake.executors.base import ExecutorKind, create_executor
    from kinebench_drake.suites.suite import load_suite

    suite = load_suite(0)
    split = suite.split_name("test")
    specs = [spec for task in suite.tasks_of(split) for spec in suite.specs(split, task, episodes, offset=seed)]
    cases = cause_cases(specs)[:limit]
    with (
        errors(),
        click.progressbar(run_cases(create_executor(ExecutorKind.LOCAL, jobs), cases), length=len(cases)) as results,
    ):
        ordered = sorted(results, key=lambda r: (r.case.spec.id, r.case.planted.name))
    for line in cause_table(ordered):
        click.echo(line)


@main.command(epilog="\b\nExample:\n  python -m benchmarks loss --count 1000 --jobs 2")
@click.option("--count", type=COUNT, default=1000, show_default=True, help="Random tracks.", metavar="N")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@jobs_option
def loss(count: int, seed: int, jobs: int) -> None:
    """Replace frames of random tracks by lost or unreachable ones; exit status 1 if a number improves."""
    from benchmarks.loss import loss_table, run_trials

    with errors(), click.progressbar(run_trials(count, seed, jobs), length=count) as trials:
        ordered = sorted(trials, key=lambda trial: trial.index)
    for line in loss_table(ordered):
        click.echo(line)
    if any(trial.improved for trial in ordered):
        raise SystemExit(1)


@main.command(epilog="\b\nExample:\n  python -m benchmarks icp heldout --keep icp.jsonl --out docs/grounding.md")
@click.argument("videos", type=EXISTING_FOLDER)
@click.option("--keep", type=FILE, required=True, help="File of finished measurements; an earlier run is resumed.")
@click.option("--limit", type=COUNT, help="Number of videos, tasks in turn.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@jobs_option
@out_option
def icp(videos: Path, keep: Path, limit: int | None, seed: int, jobs: int, out: Path | None) -> None:
    """Measure the contribution of ICP to the poses of VIDEOS, a folder of `suite demos --with-depth`."""
    from benchmarks.registration import measure, section
    from kinebench_drake.cli.run import ProgressView
    from kinebench_drake.executors.local import LocalExecutor

    with errors(), ProgressView("steps") as view:
        results = measure(videos, keep, limit, seed, LocalExecutor(jobs=jobs), view)
    write_section(out, "\n".join(section(results)))


@main.group()
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
    from kinebench_drake.cli.run import ProgressView

    work.mkdir(parents=True, exist_ok=True)
    with errors(), ProgressView("steps") as view:
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

    with errors():
        sections = write_report(*read_study(work), work if out is None else out.parent)
    for text in sections:
        write_section(out, text)


@main.command(
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
    from kinebench_drake.cli.run import ProgressView
    from kinebench_drake.grounding.baseline.network import Baseline
    from kinebench_drake.io.figure import save

    with errors(), ProgressView("executions") as view:
        done = measure(work, weights, jobs, view)
        save(draw(done), (work if out is None else out.parent) / FIGURE)
        text = "\n".join(section(done, Baseline.load(weights).training))
    write_section(out, text)


@main.command(epilog="\b\nExample:\n  python -m benchmarks baseline --out baseline --jobs 2")
@click.option("--out", type=FOLDER, required=True, help="Folder of demonstrations, checkpoints and weights.")
@click.option("--episodes", type=COUNT, default=100, show_default=True, help="Demonstrations of each training task.")
@click.option("--steps", type=COUNT, default=6000, show_default=True, help="Training steps.")
@click.option("--size", type=COUNT, default=224, show_default=True, help="Width of the frames, a multiple of 32 [px].")
@jobs_option
def baseline(out: Path, episodes: int, steps: int, size: int, jobs: int) -> None:
    """Train the inverse-dynamics baseline as published: on 100 demonstrations of each training task of suite 1.

    Both the demonstrations and the training continue where an interrupted run stopped.
    """
    from benchmarks.extractors import train_baseline
    from kinebench_drake.cli.run import ProgressView

    with errors(), ProgressView("demonstrations") as view:
        weights = train_baseline(out, episodes, steps, size, jobs, view, click.echo)
    click.echo(weights)


@main.group()
def trajectories() -> None:
    """Trajectories with ground truth by proof, and audits compared with it."""


@trajectories.command(
    epilog="\b\nExample:\n  python -m benchmarks trajectories make --out tracks --kind feasible --count 1000",
)
@click.option("--out", type=FOLDER, required=True, help="Folder; created if absent.")
@click.option(
    "--kind",
    type=click.Choice(["feasible", "infeasible", "perturbed", "noisy"]),
    required=True,
    help="Feasible motions (also with noise), planted faults, or random disturbances.",
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
    with errors(), click.progressbar(write_set(recipe, count, out, jobs=jobs), length=count, label=kind) as truths:
        for _ in truths:
            pass
    click.echo(out)


@trajectories.command(epilog="\b\nExample:\n  python -m benchmarks trajectories check results tracks")
@click.argument("results", type=click.Path(path_type=Path, exists=True))
@click.argument("tracks", type=EXISTING_FOLDER)
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
def check(results: Path, tracks: Path, as_json: bool) -> None:
    """Compare an audit's output folder RESULTS with the ground truth in the folder TRACKS."""
    from benchmarks.check import compare, read_rows, summary_table
    from benchmarks.trajectory import TRUTH, read_truths

    with errors():
        summaries = compare(read_rows(results), read_truths(tracks / TRUTH))
    click.echo(dump([s.to_json() for s in summaries], indent=2) if as_json else summary_table(summaries))


@main.command(
    name="planted-videos",
    epilog="\b\nExamples:\n"
    "  python -m benchmarks planted-videos --out faults --suite 2 --split unseen --episodes 1 --sizes gated\n"
    "  python -m benchmarks planted-videos --out jumps --tasks StackCube-v1 --seeds 0:5 --kinds teleport "
    "--sizes 0.03,0.05",
)
@click.option("--out", type=FOLDER, required=True, help="Folder to write to.")
@click.option("--tasks", metavar="A,B", help="Tasks, comma-separated.  [default: all]")
@click.option("--seeds", default="0:1", show_default=True, help="Seeds: 7, 0:5 (end excluded), 0:5,9.")
@click.option("--suite", type=click.IntRange(0, 3), metavar="N", help="Use a suite's episodes instead of --seeds.")
@click.option("--split", default="test", show_default=True, help="Split of the suite.")
@click.option("--episodes", type=COUNT, default=1, show_default=True, help="Episodes of each task.")
@click.option("--seed", "first", type=click.IntRange(0), default=0, show_default=True, help="First seed of the split.")
@click.option("--robot", type=click.Choice(["panda", "panda_wristcam"]), default="panda", show_default=True)
@click.option("--with-depth", is_flag=True, help="Keep depth and gripper masks in truth/ (some MB a video).")
@click.option("--kinds", default=",".join(KINDS), show_default=True, help="Kinds of faults.")
@click.option(
    "--sizes", default="all", show_default=True, help="all, gated (must be detected), or numbers for one kind."
)
@click.option("--each", type=COUNT, metavar="N", help="Each fault N times, on the episodes in turn.  [default: on all]")
@click.option("--crf", type=click.IntRange(0, 51), default=16, show_default=True, help="H.264 quality, 0 is lossless.")
@jobs_option
def planted_videos(
    out: Path,
    tasks: str | None,
    seeds: str,
    suite: int | None,
    split: str,
    episodes: int,
    first: int,
    robot: str,
    with_depth: bool,
    kinds: str,
    sizes: str,
    each: int | None,
    crf: int,
    jobs: int,
) -> None:
    """Render videos of the Panda, each with one planted fault, and their ground truth."""
    from benchmarks.planted_videos import (
        PlantedVideo,
        PlantingOrder,
        choose_episodes,
        make_videos,
        parse_kinds,
        write_index,
    )
    from kinebench_drake.suites.faults.fault import choose

    with errors():
        grades = choose(parse_kinds(kinds), sizes)
        specs = choose_episodes(tasks, seeds, suite, split, episodes, first)
    orders = [
        PlantingOrder(
            spec=spec,
            robot=robot,
            grades=grades if each is None else tuple(dict.fromkeys((grades * each)[i :: len(specs)])),
            with_depth=with_depth,
            crf=crf,
            out=out,
        )
        for i, spec in enumerate(specs)
    ]
    (out / "truth").mkdir(parents=True, exist_ok=True)
    videos: list[PlantedVideo] = []
    with errors():
        for result in make_videos([order for order in orders if order.grades], jobs):
            videos += result.videos
            for problem in result.problems:
                log(problem)
            for video in result.videos:
                click.echo(video.id)
    if not videos:
        raise click.ClickException("no video was made; the reasons are printed above")
    write_index(out, videos)


@main.command(
    epilog="\b\nExamples:\n"
    "  python -m benchmarks footage ../videos --out before\n"
    "  python -m benchmarks footage ../videos --out after --weights gripper.safetensors --calibration confidence.json",
)
@click.argument("folder", type=EXISTING_FOLDER)
@click.option("--out", type=FOLDER, required=True, help="Folder for footage.json, footage.md, tracks and overlays.")
@click.option("--videos", metavar="A,B", help="Ids of videos, comma-separated.  [default: all]")
@click.option("--weights", type=EXISTING_FILE, help="Network weights (safetensors).  [default: those shipped]")
@click.option("--calibration", type=EXISTING_FILE, help="Calibration of the confidence.  [default: that shipped]")
@click.option(
    "--gripper", type=click.Choice(["franka", "none"]), default="franka", show_default=True,
    help="none: measure the arm alone.",
)  # fmt: skip
@click.option("--window", is_flag=True, help="Cut frames to where the reference is: errors without those of detection.")
def footage(
    folder: Path,
    out: Path,
    videos: str | None,
    weights: Path | None,
    calibration: Path | None,
    gripper: str,
    window: bool,
) -> None:
    """Ground the videos of other programs and cameras in FOLDER, and compare with their references.

    FOLDER, or each of its subfolders, has a manifest.jsonl with a camera for each video. References are exact poses
    (NAME.gt.npz), poses from joint angles (gt/NAME.npz) or edges (gt/NAME.edge.npz), or labels by eye. What is measured
    is kept in tracks.jsonl: the same command resumes.
    """
    one_thread()
    from benchmarks.footage_report import measure
    from kinebench_drake.types import GripperKind

    names = None if videos is None else videos.split(",")
    with errors():
        kind = GripperKind(gripper)
        text = measure(
            folder, out, names, weights=weights, calibration=calibration, gripper=kind, window=window, log=log
        )
    click.echo(text)


@main.command(epilog="\b\nExample:\n  python -m benchmarks cameras ../videos --out cameras")
@click.argument("folder", type=EXISTING_FOLDER)
@click.option("--out", type=FOLDER, required=True, help="Folder for cameras.md and cameras.jsonl.")
@click.option("--videos", metavar="A,B", help="Ids of videos, comma-separated.  [default: all]")
def cameras(folder: Path, out: Path, videos: str | None) -> None:
    """Score the videos in FOLDER as if nobody named their cameras, and compare cameras and tracks with the true ones.

    FOLDER is as for `footage`; videos without reference poses are left out. The same command resumes.
    """
    one_thread()
    from benchmarks.cameras import measure

    names = None if videos is None else videos.split(",")
    with errors():
        text = measure(folder, out, names, log=log)
    click.echo(text)


@main.command(epilog="\b\nExample:\n  python -m benchmarks focal heldout --limit 8 --out focal")
@click.argument("folder", type=EXISTING_FOLDER)
@click.option("--out", type=FOLDER, required=True, help="Folder for focal.md and focal.jsonl.")
@click.option("--factors", default="1,0.7,1.4", show_default=True, help="Focal lengths over the true one.")
@click.option("--limit", type=COUNT, help="Maximum number of videos, tasks in turn.", metavar="N")
def focal(folder: Path, out: Path, factors: str, limit: int | None) -> None:
    """Give right and wrong focal lengths as the cameras of videos, and count those that the arm contradicts.

    FOLDER is as `suite demos` or `perception render` write it. The same command resumes.
    """
    one_thread()
    from benchmarks.contradiction import measure

    with errors():
        text = measure(folder, out, [float(f) for f in factors.split(",")], limit=limit, log=log)
    click.echo(text)


@main.command(epilog="\b\nExample:\n  python -m benchmarks views --out views")
@click.option("--out", type=FOLDER, required=True, help="Folder for clips, views.jsonl and views.md.")
@click.option("--changes", default="turn,move", show_default=True, help="Of still, turn, move, zoom; in turn.")
@click.option("--episodes", type=COUNT, default=1, show_default=True, help="Episodes of each task.", metavar="K")
@click.option("--seed", type=click.IntRange(min=0), default=40, show_default=True, help="First seed of the split.")
@click.option("--limit", type=COUNT, help="Number of clips.")
def views(out: Path, changes: str, episodes: int, seed: int, limit: int | None) -> None:
    """Ground clips whose camera turns by 10 degrees, moves by 10 cm or zooms by 5 %, and compare with true poses.

    The scenes are those of suite 2, unseen, with the expert's first clip. The same command resumes.
    """
    one_thread()
    from benchmarks.views import CHANGES, measure
    from kinebench_drake.suites.suite import load_suite

    names = changes.split(",")
    if unknown := sorted(set(names) - set(CHANGES)):
        raise click.UsageError(f"--changes {','.join(unknown)}: there are {', '.join(CHANGES)}")
    suite = load_suite(2)
    specs = [s for task in suite.tasks_of("unseen") for s in suite.specs("unseen", task, episodes, offset=seed)]
    with errors():
        text = measure(specs[:limit], names, out, log=log)
    click.echo(text)


@main.command(epilog="\b\nExample:\n  python -m benchmarks flange heldout --out flange")
@click.argument("demos", type=EXISTING_FOLDER)
@click.option("--out", type=FOLDER, required=True, help="Folder for flange.jsonl and flange.md.")
@click.option(
    "--count", type=COUNT, default=12, show_default=True, help="Demonstrations, and as many random scenes with boxes."
)
@click.option("--calibrate", is_flag=True, help="Fit the confidence of the arm alone and write it into the package.")
def flange(demos: Path, out: Path, count: int, calibrate: bool) -> None:
    """Track the flange in DEMOS (of `suite demos`) without the hand, and in scenes with boxes or a Robotiq 2F-85.

    The same command resumes.
    """
    one_thread()
    from benchmarks.flange import measure, summarize, write_confidence

    with errors():
        measured = measure(demos, out, count=count, log=log)
        if calibrate:
            write_confidence(measured)
        click.echo(summarize(measured, out))


@main.command(epilog="\b\nExample:\n  python -m benchmarks equivalence results-before results-after")
@click.argument("before", type=EXISTING_FOLDER)
@click.argument("after", type=EXISTING_FOLDER)
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


@main.command(epilog="\b\nExample:\n  python -m benchmarks structure --revision v0.1.0 --revision HEAD")
@click.option(
    "--revision", "revisions", multiple=True, default=("HEAD",), show_default=True, help="Revision; repeatable.",
    metavar="REV",
)  # fmt: skip
def structure(revisions: tuple[str, ...]) -> None:
    """Count files, lines and names of the sources at revisions, as a Markdown table."""
    from benchmarks.structure import count_revision, structure_table

    repository = Path(__file__).parent.parent
    with errors():
        counts = [(revision, count_revision(repository, revision)) for revision in revisions]
    click.echo(structure_table(counts))


if __name__ == "__main__":
    main(prog_name="python -m benchmarks")
