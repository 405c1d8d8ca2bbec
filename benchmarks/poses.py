"""Commands that measure poses and cameras against the truth, and render videos for it."""

import os
from pathlib import Path

import click

from benchmarks.options import (
    COUNT,
    EXISTING_FILE,
    EXISTING_FOLDER,
    FILE,
    FOLDER,
    jobs_option,
    log,
    one_thread,
    out_option,
    work_folder,
    write_section,
)
from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.errors import member_of
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.io.jsonl import dump, finite

KINDS = tuple(kind.value for kind in AnomalyKind)


@click.command(
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
    from kinebench_drake.grounding.camera.calibration_result import CalibrationMethod

    conditions = [c for c in CONDITIONS if c.method is CalibrationMethod.JOINTS] if quick else CONDITIONS
    trials = []
    for trial in measure(folder, limit=limit, frames=frames, part=part, conditions=conditions):
        trials.append(trial)
        if trial.condition == conditions[-1]:
            log(trial.clip)
    if json_out is not None:
        write_atomically(json_out, dump(finite([trial.to_json() for trial in trials]), indent=1).encode())
    for line in trial_table(trials):
        click.echo(line)


@click.command(
    epilog="\b\nExample:\n  python -m benchmarks icp heldout --keep icp.jsonl --out docs/grounding-evidence.md"
)
@click.argument("videos", type=EXISTING_FOLDER)
@click.option("--keep", type=FILE, required=True, help="File of finished measurements; an earlier run is resumed.")
@click.option("--limit", type=COUNT, help="Number of videos, tasks in turn.")
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
    from kinebench_drake.models.panda.description import GripperKind

    names = None if videos is None else videos.split(",")
    kind = GripperKind(gripper)
    text = measure(folder, out, names, weights=weights, calibration=calibration, gripper=kind, window=window, log=log)
    click.echo(text)


@click.command(
    epilog="\b\nExamples:\n"
    "  python -m benchmarks cameras ../videos --out cameras\n"
    "  python -m benchmarks cameras heldout --out cameras --limit 20 --presented plain,mirrored,middle,opengl_axes"
)
@click.argument("folder", type=EXISTING_FOLDER)
@click.option("--out", type=FOLDER, required=True, help="Folder for cameras.md and cameras.jsonl.")
@click.option("--presented", default="plain,named", show_default=True, help="Presentations, comma-separated.")
@click.option("--limit", type=COUNT, help="Maximum number of videos, tasks in turn.", metavar="N")
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


@click.command(epilog="\b\nExample:\n  python -m benchmarks views --out views")
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
    from kinebench_drake.suites.catalog import load_suite

    names = changes.split(",")
    if unknown := sorted(set(names) - set(CHANGES)):
        raise click.UsageError(f"--changes {','.join(unknown)}: there are {', '.join(CHANGES)}")
    suite = load_suite(2)
    specs = suite.specs("unseen", episodes, offset=seed)
    text = measure(specs[:limit], names, out, log=log)
    click.echo(text)


@click.command(epilog="\b\nExample:\n  python -m benchmarks flange heldout --out flange")
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

    measured = measure(demos, out, count=count, log=log)
    if calibrate:
        write_confidence(measured)
    click.echo(summarize(measured, out))


@click.command(
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
    from benchmarks.faults.fault import choose
    from benchmarks.planted_videos import (
        PlantedVideo,
        PlantingOrder,
        choose_episodes,
        make_planter,
        write_index,
    )
    from kinebench_drake.executors.base import WorkerCrash
    from kinebench_drake.executors.local import LocalExecutor

    grades = choose([member_of(AnomalyKind, kind, "kinds") for kind in kinds.split(",")], sizes)
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
    for done in LocalExecutor(jobs=jobs).run(make_planter, [order for order in orders if order.grades]):
        if isinstance(done, WorkerCrash):
            log(f"{done.item.spec.id}: {done.reason}")
            continue
        videos += done.result.videos
        for problem in done.result.problems:
            log(problem)
        for video in done.result.videos:
            click.echo(video.id)
    if not videos:
        raise click.ClickException("no video was made; the reasons are printed above")
    write_index(out, videos)


COMMANDS = (calibration, icp, footage, cameras, gate, views, flange, planted_videos)
