"""`kinebench-drake score`, `ground`, `audit`, `reading` and `export-commands`."""

from pathlib import Path
from typing import Any

import click

from kinebench_drake.cli.click_options import (
    GroupedCommand,
    PathParameter,
    check_parent,
    check_suffix,
    config_options,
    echo,
)
from kinebench_drake.errors import UsageError, name_options
from kinebench_drake.runs.audit import AuditConfig
from kinebench_drake.runs.config import FollowConfig, RunKind, ScoreConfig


def _one_path(ctx: click.Context, param: click.Parameter, paths: tuple[Path, ...]) -> Path:
    """Return the only path; several, as of an expanded `*.mp4`, are refused with what to do."""
    if len(paths) > 1:
        names = ", ".join([path.name for path in paths[:2]] + ["..."] * (len(paths) > 2))
        raise UsageError(
            f"{ctx.info_name} reads one PATH, found {len(paths)} ({names}): name their folder, or a "
            'manifest.jsonl with a line {"video": "FILE"} for each'
        )
    return paths[0]


_source_argument = click.argument(
    "source", metavar="PATH", nargs=-1, required=True, type=PathParameter(), callback=_one_path
)
_OF_VERDICT = (
    *("robot", "limits", "payload_kg", "obstacles", "table_height_m", "replays"),
    *("fail_on", "fail_under", "sarif", "write_kept"),
)
"""Options of `score` without a meaning where no motion is judged."""
_UNFOLLOWED = ("format", "limits", "payload_kg", "obstacles", "replays", "fail_on", "sarif", "write_kept")
"""Options of `score` without a meaning where a motion is compared."""
_GROUPS = {
    "Start": ("dry_run", "out", "actions", "reference", "reference_view"),
    "Input": (
        *("frame_period_s", "task_duration_s", "rate_hz", "reading", "camera_key"),
        *("task", "model", "model_from", "tags", "pixels_only", "masks", "depth", "depth_exact", "poses"),
    ),
    "Camera": ("view", "camera", "mirrored", "table_height_m"),
    "Robot": ("robot", "gripper", "tool", "limits", "payload_kg", "obstacles", "package_path"),
    "Output": ("overlay", "replays", "format", "write_kept", "sarif"),
    "Running": ("jobs", "overwrite", "limit", "shard", "engine", "address", "seed"),
    "Gate": ("fail_on", "fail_under"),
}
"""Options of `score`, `ground` and `audit` by their purpose, in the order of the help."""


def _needs_no_output(ctx: click.Context, param: click.Parameter, is_dry: bool) -> bool:
    """Make --out optional where nothing is written."""
    if is_dry:
        ctx.default_map = {**(ctx.default_map or {}), "out": "."}
    return is_dry


_dry_run_option = click.option(
    "--dry-run", is_flag=True, is_eager=True, callback=_needs_no_output,
    help="List samples, frame periods, cameras and first frames; measure and write nothing. --out is not needed.",
)  # fmt: skip


@click.command(
    cls=GroupedCommand,
    groups=_GROUPS,
    epilog=(
        "\b\nExamples:\n"
        "  kinebench-drake score videos/ --out results/\n"
        "  kinebench-drake score videos/manifest.jsonl --out results/ --jobs 4 --tag run=7\n"
        "  kinebench-drake score episode.mp4 --out results/ --frame-period 0.2 --overlay\n"
        "  kinebench-drake score videos/ --dry-run\n"
        "  kinebench-drake score pairs/ --out results/ --view bottom-left   # a generated row below a real one\n"
        "  kinebench-drake score models/ --out results/ --model-from folder   # models/wan/a.mp4, ...\n"
        "  kinebench-drake score lerobot-dataset/ --out results/ --camera-key observation.images.front\n"
        "  kinebench-drake score heldout/manifest.jsonl --out results/ --masks heldout --depth heldout"
    ),
)
@_source_argument
@config_options(ScoreConfig, omit=("source", "format"))
@_dry_run_option
@click.pass_context
def score(ctx: click.Context, /, dry_run: bool, **options: Any) -> None:
    """Score the videos of PATH: gripper tracks, kinematic metrics, report.

    PATH is a video (mp4, mov, avi, gif, webm, mkv), a folder of videos or frame folders, a npy or npz file
    (T,H,W,3 uint8), an HDF5 file, a LeRobot dataset (v2 or v3), a folder of KineBench or Dream.exe, a submission to
    WorldArena, or a manifest.jsonl. A camera.json beside the videos gives their camera (docs/formats.md).

    Clips that a model resized, cropped or stretched: save the picture that the model was given, not a frame of the
    clip, as ID.png beside ID.mp4. The change is undone then; without it such a clip takes minutes, and may stay
    undecided (docs/footage.md).

    --masks, --depth and --poses replace stages of the grounding by results of other tools. Each DIR holds ID.npz,
    ID.npy or a folder ID/ for every video (docs/overrides.md), or is a demonstration folder with its truth.
    """
    ctx.exit(_score(ScoreConfig(**options), dry_run=dry_run))


@click.command(
    cls=GroupedCommand,
    groups=_GROUPS,
    epilog=(
        "\b\nExamples:\n"
        "  kinebench-drake ground videos/ --out tracks/ --overlay\n"
        "  kinebench-drake ground videos/ --out tracks/ --masks yolo/ --depth my_depth:Estimator\n"
        "  kinebench-drake ground videos/ --out tracks/ --poses foundationpose/\n"
        "  kinebench-drake ground videos/ --out tracks/ --format lerobot-v3 --frame-period 0.2"
    ),
)
@_source_argument
@config_options(ScoreConfig, omit=("source", *_OF_VERDICT))
@_dry_run_option
@click.pass_context
def ground(ctx: click.Context, /, dry_run: bool, **options: Any) -> None:
    """Extract the gripper track of each video of PATH, without judging it.

    PATH is as in `score`. Tracks are written to tracks/ID.npz in the output folder, videos with the tracked gripper
    to overlays/ID.mp4.

    --masks, --depth and --poses replace stages of the grounding by results of other tools. Each DIR holds ID.npz,
    ID.npy or a folder ID/ for every video (docs/overrides.md), or is a demonstration folder with its truth.
    """
    ctx.exit(_score(ScoreConfig(kind=RunKind.GROUND, replays=None, **options), dry_run=dry_run))


@click.command(
    cls=GroupedCommand,
    groups=_GROUPS,
    epilog=(
        "\b\nExamples:\n"
        "  kinebench-drake follow videos/ --actions actions/ --out results/     # videos/a.mp4, actions/a.npz\n"
        "  kinebench-drake follow videos/manifest.jsonl --out results/          # key actions of each line\n"
        "  kinebench-drake follow generated/ --reference real/ --out results/\n"
        "  kinebench-drake follow tiles/ --view bottom --reference tiles/ --reference-view top --out out/\n"
        "  kinebench-drake follow videos/ --actions actions/ --dry-run"
    ),
)
@_source_argument
@config_options(FollowConfig, omit=("source", *_UNFOLLOWED))
@_dry_run_option
@click.pass_context
def follow(ctx: click.Context, /, dry_run: bool, **options: Any) -> None:
    """Compare the videos of PATH with the actions, or the real clips, that they should show.

    PATH is as in `score`. The motion of the gripper is measured, and compared with the commanded one: how far it is
    from it, how late, how large, from which frame on it drifts, and whether it follows. The same is done with
    shuffled, reversed and still actions: what follows those as well proves nothing (docs/following.md).

    Actions are joint angles or poses of the TCP, one row per frame or with times (docs/formats.md); --reading states
    what their names leave open, also changes from frame to frame. The camera, if none is named, is fitted to the arm in
    the commanded postures, on frames that are not judged.
    """
    ctx.exit(_score(FollowConfig(replays=None, **options), dry_run=dry_run))


@click.command(
    cls=GroupedCommand,
    groups=_GROUPS,
    epilog=(
        "\b\nExamples:\n"
        "  kinebench-drake audit track.npz --out results/\n"
        "  kinebench-drake audit demos/trajectory.h5 --out results/ --jobs 4\n"
        "  kinebench-drake audit dataset/ --out results/ --reading reading.json\n"
        "  kinebench-drake audit score-results/ --out results/ --table-height -0.02\n"
        "  kinebench-drake audit track.csv --out results/ --robot fr3 --payload 0.5\n"
        "  kinebench-drake audit track.csv --out results/ --robot arm.urdf --tool tool0 --limits limits.json\n"
        "  kinebench-drake audit dataset/ --out results/ --fail-on infeasible --fail-under feasible=0.95"
    ),
)
@_source_argument
@config_options(AuditConfig, omit=("source",))
@click.pass_context
def audit(ctx: click.Context, /, **options: Any) -> None:
    """Check the trajectories of PATH: whether and how well the robot executes each, and if not, why not.

    PATH is an npz, csv, h5 (ManiSkill, robomimic, LIBERO), npy, txt, json or parquet file, a LeRobot dataset (v2, v3),
    an output folder of score or ground or its tracks/, or a folder of these. Joint angles are judged as recorded; poses
    are infeasible only if no joint path follows them. Columns, units and rotations follow from their names
    (docs/formats.md); where others fit the robot far better, the row says so and is undecided. --reading says how to
    read; `kinebench-drake reading PATH` prints such a file.
    """
    from kinebench_drake.cli.progress import run
    from kinebench_drake.runs.audit import audit_trajectories

    config = AuditConfig(**options)
    ctx.exit(run(lambda observer: audit_trajectories(config, observer), config.out))


@click.command(epilog="\b\nExample:\n  kinebench-drake reading dataset/ > reading.json")
@click.argument("source", metavar="PATH", type=PathParameter())
@config_options(AuditConfig, "table_height_m", "robot", "tool")
def reading(source: Path, table_height_m: float, robot: str, tool: str | None) -> None:
    """Print how the trajectories of PATH would be read, as the JSON of a reading file, with other readings.

    The cost says how badly the numbers fit the robot: 0 is best. Edit the keys of "reading" (docs/formats.md) and name
    the file by `audit --reading`.
    """
    import json

    from kinebench_drake.runs.reading_check import assess_path
    from kinebench_drake.runs.resources import RobotOptions

    options = RobotOptions(table_height_m=table_height_m, robot=robot, tool=tool)
    click.echo(json.dumps(assess_path(source, options).to_json(), indent=2))


@click.command(
    epilog=(
        "\b\nExamples:\n"
        "  kinebench-drake export-commands results/tracks/push_0.npz --rate 1000 --out push.npz\n"
        "  kinebench-drake export-commands track.csv --out commands.csv --robot fr3 --obstacles scene.json"
    )
)
@click.argument("source", metavar="TRACK", type=PathParameter())
@click.option(
    "--out", type=PathParameter(dir_okay=False), required=True, metavar="FILE.npz|.csv", help="File of the commands."
)
@click.option(
    "--rate", "rate_hz", type=float, default=1000.0, show_default=True, metavar="HZ", help="Commands per second."
)
@config_options(
    AuditConfig,
    *("reading", "table_height_m", "robot", "limits", "tool", "payload_kg", "obstacles", "package_path"),
)
def export_commands(source: Path, out: Path, rate_hz: float, reading: Path | None, **robot: Any) -> None:
    """Write the joint angles with which a robot executes TRACK, from rest to rest and within every limit.

    TRACK is one trajectory as `audit` takes it. Position, speed, acceleration, jerk, torque and torque rate are checked
    by finite differences of what was written. Where no motion in the tube about the track keeps them, a line says why,
    and the exit status is 1.
    """
    from kinebench_drake.formats.trajectories.reading import Reading, TrajectoryOptions
    from kinebench_drake.runs.command_export import export_commands
    from kinebench_drake.runs.resources import RobotOptions

    check_suffix("--out", out, ".npz", ".csv")
    check_parent("--out", out)
    choice = TrajectoryOptions(reading=None if reading is None else Reading.parse(reading))
    for line in export_commands(source, out, rate_hz, RobotOptions(**robot), choice):
        echo(line)


def _score(config: ScoreConfig, *, dry_run: bool) -> int:
    """Carry out a run, or list what it would read; return the exit status."""
    from kinebench_drake.cli.progress import ProgressView, run
    from kinebench_drake.results.inputs import input_lines
    from kinebench_drake.results.row import Status
    from kinebench_drake.runs.follow import follow_videos, plan_following
    from kinebench_drake.runs.preparation import row_warnings
    from kinebench_drake.runs.score import plan_videos, score_videos

    if not dry_run and isinstance(config, FollowConfig):
        return run(lambda observer: follow_videos(config, observer), config.out)
    if not dry_run:
        return run(lambda observer: score_videos(config, observer), config.out)
    sources = plan_following(config) if isinstance(config, FollowConfig) else {}
    rows = []
    for sample, row in plan_videos(config, ProgressView("samples")):
        rows.append(row)
        picture = []
        if sample.first_frame is not None:
            picture = [f"given picture: {sample.first_frame.name}"]
        elif row.status is Status.OK and not sample.camera_source.is_named:
            picture = [f"no {row.id}.png: minutes if resized or cropped"]
        size = f"{row.frames} frames of {row.width} x {row.height} px" if row.status is Status.OK else str(row.reason)
        labels = [
            f"{key} {value}"
            for key, value in (("task", row.task), ("model", row.model), ("view", row.view))
            if value is not None
        ]
        echo("; ".join([f"{row.id}: {size}", *input_lines([row]), *picture, *labels, *sources.get(row.id, ())]))
    readable = [row for row in rows if row.status is Status.OK]
    echo(f"{len(readable)} of {len(rows)} samples can be read; nothing was measured or written")
    for warning in row_warnings(rows):
        echo(f"warning: {name_options(warning)}", err=True)
    for line in input_lines(readable):
        echo(line)
    return 0 if readable else 1
