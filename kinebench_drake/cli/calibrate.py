"""`kinebench-drake calibrate`."""

from pathlib import Path
from typing import Any

import click


@click.command(
    epilog=(
        "\b\nExamples:\n"
        "  kinebench-drake calibrate robot.mp4 --joints joints.csv --out camera.json --figure check.png\n"
        "  kinebench-drake calibrate robot.mp4 --joints dataset/ --episode 3 --out camera.json\n"
        "  kinebench-drake calibrate robot.mp4 --joints home --focal 610 --out camera.json\n"
        "  kinebench-drake calibrate robot.mp4 --out camera.json"
    )
)
@click.argument("video", metavar="VIDEO", type=click.Path(path_type=Path))
@click.option(
    "--out", type=click.Path(path_type=Path, dir_okay=False), required=True,
    help="Write the camera here; as camera.json beside videos it is what `score` takes.",
)  # fmt: skip
@click.option(
    "--joints", metavar="FILE|Q1,...,Q7|NAME",
    help="Joint angles: a file with those of the frames, or the posture of one frame [rad], or its name: home "
    "(Franka's start), rest (ManiSkill's).  [default: none are known]",
)  # fmt: skip
@click.option(
    "--joints-frame", type=click.IntRange(min=0), default=0, show_default=True, metavar="K",
    help="The frame in which the robot is in that one posture.",
)  # fmt: skip
@click.option("--episode", metavar="NAME", help="Which episode of a dataset the video shows.")
@click.option("--column", metavar="NAME", help="Array or column that holds the joint angles, where it is ambiguous.")
@click.option(
    "--frame-period", "frame_period_s", type=float, metavar="SECONDS",
    help="Time between two frames, where the joint angles have times of their own.  [default: the film's]",
)  # fmt: skip
@click.option(
    "--camera", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE",
    help="camera.json whose focal length and centre are right; without joint angles the search begins at its pose.",
)  # fmt: skip
@click.option(
    "--focal", "focal_px", type=float, metavar="PX", help="Focal length of the video's pixels.  [default: estimated]"
)
@click.option(
    "--frames", type=click.IntRange(min=1), default=24, show_default=True, metavar="N", help="Frames used at most."
)
@click.option(
    "--figure", type=click.Path(path_type=Path, dir_okay=False),
    help="Draw the CAD robot over a frame with the camera found (png).",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print all figures as JSON.")
def calibrate(out: Path, figure: Path | None, as_json: bool, **options: Any) -> None:
    """Find where the camera of VIDEO stands (base_from_camera), and its focal length, from the robot it shows.

    The camera must stand still, and its lens be free of distortion. VIDEO is a film, a folder of frames, npy or npz.
    Joint angles are files as `audit` takes them (docs/calibration.md): npz with q, csv with q1_rad..q7_rad, ManiSkill
    h5, a LeRobot dataset; as many rows as frames, or times t_s. Poses of the TCP in the base frame do as well.

    Without joint angles the robot's motion tells the camera, if the base is seen. What is not determined is refused,
    with the reason.
    """
    from kinebench_drake.calibration.calibrate import CalibrationConfig
    from kinebench_drake.calibration.calibrate import calibrate as find
    from kinebench_drake.calibration.result import lines
    from kinebench_drake.io.camerafile import save_camera
    from kinebench_drake.io.jsonl import dump

    for name, path, suffix in (("--out", out, ".json"), ("--figure", figure, ".png")):
        if path is not None and path.suffix.lower() != suffix:
            raise click.UsageError(f"{name} {path.name}: expected a name that ends in {suffix}")
    found = find(CalibrationConfig(**options))
    save_camera(found.calibration.camera, out)
    if figure is not None:
        from kinebench_drake.calibration.overlay import draw_robot, save

        save(draw_robot(found.frame, found.calibration.camera, found.X_BP, found.finger_m), figure)
    if as_json:
        click.echo(dump(found.calibration.to_json(), indent=2), nl=False)
        return
    for line in lines(found.calibration):
        click.echo(line)
    click.echo(f"camera: {out}")
