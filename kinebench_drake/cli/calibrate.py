"""`kinebench-drake calibrate`, `cameras` and `robots`."""

from pathlib import Path
from typing import Any

import click

from kinebench_drake.cli.click_options import PathParameter, check_suffix


@click.command(
    epilog=(
        "\b\nExamples:\n"
        "  kinebench-drake calibrate robot.mp4 --joints joints.csv --out camera.json --figure check.png\n"
        "  kinebench-drake calibrate robot.mp4 --joints dataset/ --episode 3 --out camera.json\n"
        "  kinebench-drake calibrate robot.mp4 --joints joints.npz --gripper robotiq-2f85 --out camera.json\n"
        "  kinebench-drake calibrate robot.mp4 --joints home --focal 610 --out camera.json\n"
        "  kinebench-drake calibrate robot.mp4 --out camera.json"
    )
)
@click.argument("video", metavar="VIDEO", type=PathParameter())
@click.option(
    "--out", type=PathParameter(dir_okay=False), required=True,
    help="Output file; `score` reads it as camera.json beside the videos.",
)  # fmt: skip
@click.option(
    "--joints", metavar="FILE|Q1,...,Q7|NAME",
    help="Joint angles: a file for the frames, or the posture of one frame [rad], or its name: home (start posture of "
    "Franka's programs), rest (ManiSkill).  [default: none]",
)  # fmt: skip
@click.option(
    "--joints-frame", type=click.IntRange(min=0), default=0, show_default=True, metavar="K",
    help="Frame of the single posture.",
)  # fmt: skip
@click.option("--episode", metavar="NAME", help="Episode of a dataset that the video shows.")
@click.option("--column", metavar="NAME", help="Array or column of the joint angles, if ambiguous.")
@click.option(
    "--frame-period", "frame_period_s", type=click.FloatRange(1e-4, 1e3), metavar="SECONDS",
    help="Time between two frames, for joint angles with times.  [default: from the video]",
)  # fmt: skip
@click.option(
    "--camera", type=PathParameter(dir_okay=False), metavar="FILE",
    help="camera.json with the intrinsics; its pose is a first guess where the posture of one frame is given.",
)  # fmt: skip
@click.option(
    "--focal",
    "focal_px",
    type=click.FloatRange(1.0, 1e5),
    metavar="PX",
    help="Focal length in pixels of the video.  [default: estimated]",
)
@click.option(
    "--frames", type=click.IntRange(min=1), default=24, show_default=True, metavar="N",
    help="Frames used at most; not more than 12 without --joints of all frames.",
)  # fmt: skip
@click.option(
    "--gripper", type=click.Choice(["auto", "franka", "robotiq-2f85", "none"]), default="auto", show_default=True,
    help="Gripper of the robot. With another one than Franka's, or none, the links alone are used: this needs joint "
    "angles of the frames. auto does so where the Franka hand gives no camera.",
)  # fmt: skip
@click.option(
    "--figure", type=PathParameter(dir_okay=False),
    help="Image of the CAD robot drawn over a frame with the calibrated camera (png).",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print all results as JSON.")
def calibrate(out: Path, figure: Path | None, as_json: bool, **options: Any) -> None:
    """Estimate camera pose (base_from_camera) and focal length of VIDEO from the robot that it shows.

    The camera must be static and its lens free of distortion. VIDEO is a video file, a folder of frames, npy or npz.
    Files of joint angles are those of `audit` (docs/calibration.md): npz with q, csv with q1_rad..q7_rad, ManiSkill h5,
    a LeRobot dataset; one row per frame, or times t_s. Poses of the TCP in the base frame may replace joint angles.

    The links alone also give the lag of the joint angles against the frames (up to 3 frames, either way) and, where the
    shape of the picture is unusual, the shape of its pixels (fy / fx).

    Without joint angles the camera is estimated from the arm and its base, as by `score --camera auto`. If the video
    does not determine the camera, the command fails with the reason.
    """
    from kinebench_drake.formats.camerafile import save_camera
    from kinebench_drake.grounding.camera.calibrate import CalibrationConfig, format_lines
    from kinebench_drake.grounding.camera.calibrate import calibrate as run_calibration
    from kinebench_drake.io.files import absence
    from kinebench_drake.io.jsonl import dump
    from kinebench_drake.models.panda.description import GripperKind

    if not options["video"].exists():
        raise click.UsageError(f"{options['video']}: {absence(options['video'])}")
    check_suffix("--out", out, ".json")
    check_suffix("--figure", figure, ".png")
    gripper = GripperKind(options.pop("gripper"))
    calibration = run_calibration(CalibrationConfig(**options, gripper=gripper))
    save_camera(calibration.camera, out)
    if figure is not None:
        from kinebench_drake.grounding.overlay import draw_robot, save_image

        middle = len(calibration.frames) // 2
        finger_m = float(calibration.scene.finger_m[middle])
        save_image(draw_robot(calibration.image, calibration.camera, calibration.drawn_parts(middle), finger_m), figure)
    if as_json:
        click.echo(dump(calibration.to_json(), indent=2), nl=False)
        return
    for line in format_lines(calibration):
        click.echo(line)
    click.echo(f"camera: {out}")


@click.command(epilog="\b\nExample:\n  kinebench-drake cameras --json")
@click.option("--json", "as_json", is_flag=True, help="All fields of each camera, as in camera.json.")
def cameras(as_json: bool) -> None:
    """List the cameras that `--camera NAME`, a manifest and the Python functions take by name.

    Each with its vertical field of view, the usual size of its pictures, the height of the table top in the base frame,
    on what it was checked, how its pictures are also published, and the source of its numbers.
    """
    from kinebench_drake.io.jsonl import dump
    from kinebench_drake.named_cameras import named_cameras

    listed = named_cameras().values()
    if as_json:
        click.echo(dump([camera.to_json() for camera in listed], indent=1), nl=False)
    else:
        click.echo("\n".join(camera.describe() for camera in listed))


@click.command(epilog="\b\nExample:\n  kinebench-drake robots --json")
@click.option("--json", "as_json", is_flag=True, help="One object an arm.")
def robots(as_json: bool) -> None:
    """List the arms that `audit --robot NAME` takes by name, and those that data sets choose by their robot_type.

    Each with its joints, the limits that are checked and those that are not, and the sources of description and limits.
    Arms whose package is not installed are listed with the command that installs it.
    """
    from kinebench_drake.io.jsonl import dump
    from kinebench_drake.models.arm import list_arms

    listed = list_arms()
    if as_json:
        click.echo(dump([*listed], indent=1), nl=False)
        return
    for arm in listed:
        kinds = {
            key: ", ".join(map(str, own)) for key in ("checked", "unchecked") if isinstance(own := arm.get(key), list)
        }
        limits = [f"limits {key}: {names}" for key, names in kinds.items() if names]
        lines = [arm["title"], *limits, *filter(None, [arm.get("missing")]), f"sources: {arm['source']}"]
        paragraphs = [click.wrap_text(str(line), 110, " " * 14, " " * 16) for line in lines]
        click.echo(f"{arm['name']:14}" + "\n".join(paragraphs).lstrip())
