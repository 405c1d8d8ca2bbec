"""Commands that measure poses and cameras against the truth, and render videos for it."""

import os
from pathlib import Path

import click

from benchmarks.options import (
    COUNT,
    EXISTING_FOLDER,
    FILE,
    FOLDER,
    jobs_option,
    log,
    one_thread,
    out_option,
    weights_option,
    work_folder,
    write_section,
)
from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.errors import member_of
from kinebench_drake.io.atomic import write_atomically

KINDS = tuple(kind.value for kind in AnomalyKind)


_keep_option = click.option("--keep", type=FILE, help="File of finished measurements; an earlier run is resumed.")
_limit_option = click.option("--limit", type=COUNT, help="Number of videos, tasks in turn.", metavar="N")


@click.command(
    epilog="""\b
tracked_when_seen     tracked frames / frames that show at least 30 % of the gripper
lasting_flips         runs of 3 or more tracked frames with the gripper turned by 180 degrees
open_or_closed_right  gap above or below the middle of the episode's range (of 0..80 mm if the range is smaller than
                      16 mm), in frames whose true gap is more than 8 mm from there
tracked_frames_off_by_3_cm  share of tracked frames that are off by more, or show no gripper
cpu_median_s          processor time for 49 frames

\b
Example:
  kinebench-drake suite demos --suite 2 --split unseen --episodes 5 --out heldout
  python -m benchmarks evaluate heldout --keep heldout.jsonl"""
)
@click.argument("folder", type=EXISTING_FOLDER)
@weights_option
@_limit_option
@_keep_option
@jobs_option
def evaluate(folder: Path, weights: Path | None, limit: int | None, keep: Path | None, jobs: int) -> None:
    """Measure the errors of gripper tracks against ground truth.

    FOLDER is the output of `suite demos` or `python -m benchmarks planted-videos`: videos, camera.json,
    manifest.jsonl and truth/.
    """
    from benchmarks.perception import study, tables
    from benchmarks.perception.summary import reliability
    from kinebench_drake.cli.progress import ProgressView
    from kinebench_drake.executors.local import LocalExecutor

    plan = study.StudyPlan(folder=folder, weights=weights, limit=limit, keep=keep)
    with ProgressView("videos") as view:
        outcome = study.run_study([study.CLEAN], plan, LocalExecutor(jobs=jobs), view)
    (results,) = outcome.results.values()
    click.echo("median and 95th percentile of position and rotation error of panda_hand; frames are 0-based")
    for errors in results:
        click.echo(tables.video_line(errors))
    for lines in (
        tables.task_table(results),
        tables.pooled_lines(results, plan.seed),
        tables.reliability_lines(reliability(results)),
    ):
        click.echo("")
        for line in lines:
            click.echo(line)


@click.command(epilog="\b\nExample:\n  python -m benchmarks budget heldout --limit 20 --keep budget.jsonl --jobs 2")
@click.argument("folder", type=EXISTING_FOLDER)
@_limit_option
@_keep_option
@jobs_option
def budget(folder: Path, limit: int | None, keep: Path | None, jobs: int) -> None:
    """Measure the error budget: each stage's output replaced by ground truth, one at a time and all together.

    FOLDER is the output of `suite demos --with-depth`.
    """
    from benchmarks.perception import study
    from kinebench_drake.cli.progress import ProgressView
    from kinebench_drake.executors.local import LocalExecutor

    plan = study.StudyPlan(folder=folder, limit=limit, keep=keep)
    with ProgressView("measurements") as view:
        outcome = study.run_study(study.BUDGET, plan, LocalExecutor(jobs=jobs), view)
    for line in outcome.lines():
        click.echo(line)


@click.command(
    epilog="\b\nExample:\n"
    "  kinebench-drake suite demos --suite 2 --split unseen --episodes 5 --out heldout\n"
    "  python -m benchmarks calibration heldout --limit 20",
)
@click.argument("folder", type=EXISTING_FOLDER)
@_limit_option
@click.option(
    "--frames", type=click.IntRange(min=4), default=12, show_default=True, help="Frames a video.", metavar="N"
)
@click.option("--quick", is_flag=True, help="Only with the joint angles of all frames.")
def calibration(folder: Path, limit: int | None, frames: int, quick: bool) -> None:
    """Calibrate the cameras of rendered videos with all kinds of prior information about the robot."""
    from benchmarks.calibration import CONDITIONS, measure, trial_table
    from kinebench_drake.grounding.camera.calibrate import CalibrationMethod

    conditions = [c for c in CONDITIONS if c.method is CalibrationMethod.JOINTS] if quick else CONDITIONS
    trials = []
    for trial in measure(folder, limit=limit, frames=frames, conditions=conditions):
        trials.append(trial)
        if trial.condition == conditions[-1]:
            log(trial.clip)
    for line in trial_table(trials):
        click.echo(line)


@click.command(
    epilog="\b\nExample:\n  python -m benchmarks icp heldout --keep icp.jsonl --out docs/grounding-evidence.md"
)
@click.argument("videos", type=EXISTING_FOLDER)
@click.option("--keep", type=FILE, required=True, help="File of finished measurements; an earlier run is resumed.")
@_limit_option
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@jobs_option
@out_option
def icp(videos: Path, keep: Path, limit: int | None, seed: int, jobs: int, out: Path | None) -> None:
    """Measure the contribution of ICP to the poses of VIDEOS, a folder of `suite demos --with-depth`."""
    from benchmarks.registration import measure, section
    from kinebench_drake.cli.progress import ProgressView
    from kinebench_drake.executors.local import LocalExecutor

    with ProgressView("steps") as view:
        results = measure(videos, keep, limit, seed, LocalExecutor(jobs=jobs), view)
    write_section(out, section(results))


@click.command(
    epilog="\b\nExamples:\n"
    "  python -m benchmarks footage ../videos --out measured\n"
    "  python -m benchmarks footage ../videos --gripper none --out arm-alone",
)
@click.argument("folder", type=EXISTING_FOLDER)
@click.option("--out", type=FOLDER, required=True, help="Folder for footage.json, footage.md, tracks and overlays.")
@click.option(
    "--gripper", type=click.Choice(["franka", "robotiq-2f85", "none"]), default="franka", show_default=True,
    help="none: measure the arm alone.",
)  # fmt: skip
def footage(folder: Path, out: Path, gripper: str) -> None:
    """Ground the videos of other programs and cameras in FOLDER, and compare with their references.

    FOLDER, or each of its subfolders, has a manifest.jsonl with a camera for each video. References are exact poses
    (NAME.gt.npz), poses from joint angles (gt/NAME.npz) or edges (gt/NAME.edge.npz), or labels by eye. What is measured
    is kept in tracks.jsonl: the same command resumes.
    """
    one_thread()
    from benchmarks.footage_report import measure
    from kinebench_drake.cli.progress import ProgressView
    from kinebench_drake.models.panda.description import GripperKind

    with ProgressView("videos") as view:
        text = measure(folder, out, GripperKind(gripper), view)
    click.echo(text)


@click.command(
    epilog="\b\nExamples:\n"
    "  python -m benchmarks cameras ../videos --out cameras\n"
    "  python -m benchmarks cameras heldout --out cameras --limit 20 --presented plain,mirrored,middle,opengl_axes"
)
@click.argument("folder", type=EXISTING_FOLDER)
@click.option("--out", type=FOLDER, required=True, help="Folder for cameras.md and cameras.jsonl.")
@click.option("--presented", default="plain,named", show_default=True, help="Presentations, comma-separated.")
@_limit_option
@jobs_option
def cameras(folder: Path, out: Path, presented: str, limit: int | None, jobs: int) -> None:
    """Ground the videos in FOLDER with and without their cameras, mirrored, cropped or turned; compare with the truth.

    FOLDER has a manifest.jsonl and the true poses, as `suite demos` writes them or as NAME.gt.npz. The same command
    resumes.
    """
    one_thread()
    from benchmarks.perception.clip import choose, find_clips
    from benchmarks.presentations import Presentation, Trial, measure, outcome_table, summary_table
    from kinebench_drake.cli.progress import ProgressView
    from kinebench_drake.executors.local import LocalExecutor

    with ProgressView("videos") as view:
        kinds = [member_of(Presentation, name, "presented") for name in presented.split(",")]
        trials = [Trial(clip=clip, presentation=kind) for kind in kinds for clip in choose(find_clips(folder), limit)]
        out.mkdir(parents=True, exist_ok=True)
        outcomes = measure(trials, LocalExecutor(jobs=jobs), view, out / "cameras.jsonl")
        text = "\n".join([*summary_table(outcomes), "", *outcome_table(outcomes)]) + "\n"
        write_atomically(out / "cameras.md", text.encode())
    click.echo("\n".join(summary_table(outcomes)))


@click.command(epilog="\b\nExample:\n  KINEBENCH_GATE_CLIPS=../videos python -m benchmarks gate --jobs 2")
@jobs_option
def gate(jobs: int) -> None:
    """Ground short clips of several programs, with and without cameras, mirrored and cropped; exit 1 if one is wrong.

    Two of them are also scored in float32 and in bfloat16: no verdict may be yes in one and no in the other. The clips
    and their bounds are in tests/gate. The environment variable KINEBENCH_GATE_CLIPS adds a folder of your own, as
    `cameras` takes it.
    """
    one_thread()
    from benchmarks.precision import find_flips, score_both
    from benchmarks.presentations import CLIPS, CLIPS_VARIABLE, run_gate
    from kinebench_drake.cli.progress import ProgressView
    from kinebench_drake.executors.local import LocalExecutor

    extra = os.environ.get(CLIPS_VARIABLE)
    with ProgressView("videos") as view:
        faults = run_gate(CLIPS, Path(extra) if extra else None, LocalExecutor(jobs=jobs), view)
    with work_folder(None) as work:
        rows = score_both(CLIPS / "manifest.jsonl", work, jobs, log, limit=2)
    faults += [
        f"{flip.id}: {flip.name} is {flip.values[0]} in float32, {flip.values[1]} in bfloat16 ({flip.measure})"
        for flip in find_flips(*rows)
        if flip.is_contradiction
    ]
    for fault in faults:
        click.echo(fault)
    if faults:
        raise SystemExit(1)
    click.echo("the gate holds")


@click.command(epilog="\b\nExample:\n  python -m benchmarks flange heldout --out flange")
@click.argument("demos", type=EXISTING_FOLDER)
@click.option("--out", type=FOLDER, required=True, help="Folder for flange.jsonl and flange.md.")
@click.option(
    "--count", type=COUNT, default=12, show_default=True, help="Demonstrations, and as many random scenes with boxes."
)
@click.option("--calibrate", is_flag=True, help="Fit the confidence of the arm alone and write it into the package.")
def flange(demos: Path, out: Path, count: int, calibrate: bool) -> None:
    """Track the flange in DEMOS (of `suite demos`) without the hand, and in scenes with boxes.

    The same command resumes.
    """
    one_thread()
    from benchmarks.flange import measure, summarize, write_confidence

    measured = measure(demos, out, count=count, log=log)
    if calibrate:
        write_confidence(measured)
    click.echo(summarize(measured, out))


@click.command(
    name="planted-videos",
    epilog="\b\nExamples:\n"
    "  python -m benchmarks planted-videos --out faults --suite 2 --split unseen --sizes gated\n"
    "  python -m benchmarks planted-videos --out jumps --tasks StackCube-v1 --kinds teleport --sizes 0.03,0.05",
)
@click.option("--out", type=FOLDER, required=True, help="Folder to write to.")
@click.option("--tasks", metavar="A,B", help="Tasks, comma-separated.  [default: all]")
@click.option("--suite", type=click.IntRange(0, 3), default=0, show_default=True, metavar="N", help="Suite.")
@click.option("--split", default="test", show_default=True, help="Split of the suite.")
@click.option("--episodes", type=COUNT, default=1, show_default=True, help="Episodes of each task.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="First seed of the split.")
@click.option("--kinds", default=",".join(KINDS), show_default=True, help="Kinds of faults.")
@click.option(
    "--sizes", default="all", show_default=True, help="all, gated (must be detected), or numbers for one kind."
)
@click.option("--each", type=COUNT, metavar="N", help="Each fault N times, on the episodes in turn.  [default: on all]")
@jobs_option
def planted_videos(
    out: Path,
    tasks: str | None,
    suite: int,
    split: str,
    episodes: int,
    seed: int,
    kinds: str,
    sizes: str,
    each: int | None,
    jobs: int,
) -> None:
    """Render videos of the Panda, each with one planted fault, and their ground truth."""
    from benchmarks.faults.fault import choose
    from benchmarks.planted_videos import PlantedVideo, PlantingOrder, make_planter, write_index
    from benchmarks.trials import run_all
    from kinebench_drake.suites.catalog import load_suite

    grades = choose([member_of(AnomalyKind, kind, "kinds") for kind in kinds.split(",")], sizes)
    names = None if tasks is None else tasks.split(",")
    specs = load_suite(suite).specs(split, episodes, tasks=names, offset=seed)
    orders = [
        PlantingOrder(
            spec=spec,
            grades=grades if each is None else tuple(dict.fromkeys((grades * each)[i :: len(specs)])),
            out=out,
        )
        for i, spec in enumerate(specs)
    ]
    (out / "truth").mkdir(parents=True, exist_ok=True)
    videos: list[PlantedVideo] = []
    for result in run_all(make_planter, [order for order in orders if order.grades], jobs):
        videos += result.videos
        for problem in result.problems:
            log(problem)
        for video in result.videos:
            click.echo(video.id)
    if not videos:
        raise click.ClickException("no video was made; the reasons are printed above")
    write_index(out, videos)


@click.group()
def panels() -> None:
    """Tiled clips in the layouts of published models, and the panels that are read of them."""


@panels.command("make", epilog="\b\nExample:\n  python -m benchmarks panels make --out tiles --count 100")
@click.option("--out", type=FOLDER, required=True, help="Folder; created if absent.")
@click.option("--count", type=COUNT, default=100, show_default=True, help="Clips.", metavar="N")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
def make_panels(out: Path, count: int, seed: int) -> None:
    """Tile the example videos in random layouts, sizes and orders, with bars, text and compression."""
    from benchmarks.panels import make_clips

    out.mkdir(parents=True, exist_ok=True)
    make_clips(out, count, seed)


@panels.command("check", epilog="\b\nExample:\n  python -m benchmarks panels check tiles")
@click.argument("folder", type=EXISTING_FOLDER)
def check_panels(folder: Path) -> None:
    """Count the clips of FOLDER whose panels are exact to the pixel, and the panels of the right kind."""
    from benchmarks.panels import check_clips

    checks = []
    for check in check_clips(folder):
        checks.append(check)
        if check.right < len(check.truth):
            click.echo(f"{check.id}: {check.panels}, expected {check.truth}")
    click.echo(f"all rectangles exact in {sum(c.is_exact for c in checks)} of {len(checks)} clips")
    click.echo(
        f"rectangle and kind right in {sum(c.right for c in checks)} of {sum(len(c.truth) for c in checks)} panels"
    )


COMMANDS = (evaluate, budget, calibration, icp, footage, cameras, gate, flange, planted_videos, panels)
