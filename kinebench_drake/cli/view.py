"""`kinebench-drake view`."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click

from kinebench_drake.errors import InputError, UsageError

if TYPE_CHECKING:
    from kinebench_drake.kinematics.plant import ArmPlant


@click.command(epilog="\b\nExample:\n  kinebench-drake view results/ episode_0003 --open")
@click.argument("out", metavar="OUT", type=click.Path(path_type=Path))
@click.argument("id", metavar="ID")
@click.option(
    "--robot",
    "urdf",
    type=click.Path(path_type=Path),
    help="URDF of the robot, for a run judged with another robot than the Panda.",
    metavar="URDF",
)
@click.option("--open/--no-open", "opened", default=False, help="Open it in the browser.")
def view(out: Path, id: str, urdf: Path | None, opened: bool) -> None:
    """Write a 3D replay of sample ID of the output folder OUT and print its path.

    The replay, OUT/replays/ID.html, opens in any browser. It shows the motion of the arm, coloured by the limits that
    it violates.
    """
    from difflib import get_close_matches

    from kinebench_drake.results.store import SAMPLES, artifact_path, read_rows

    if not (out / SAMPLES).is_file():
        raise UsageError(f"{out}: holds no {SAMPLES}, expected the output folder of a run")
    try:
        rows = read_rows(out)
        if id not in rows:
            near = get_close_matches(id, rows, n=3, cutoff=0.5) or sorted(rows)[:3]
            hint = f"such as {', '.join(near)}" if near else "it is empty"
            raise UsageError(f"{out}: holds no sample {id!r} ({len(rows)} samples, {hint})")
        row = rows[id]
        if not artifact_path(out, "tracks", id).is_file():
            raise UsageError(f"{id}: has no track to show ({row.reason or f'tracks/{id}.npz is absent'})")
        from kinebench_drake.report.replay import write_replays

        paths = write_replays(out, [id], _plant(out, urdf))
    except InputError as error:
        raise UsageError(str(error)) from None
    if not paths:
        raise UsageError(f"{id}: no frame is tracked, there is nothing to show")
    click.echo(paths[0])
    if opened and click.launch(paths[0].resolve().as_uri()) != 0:
        click.echo("no browser could be started; open the file yourself", err=True)


def _plant(out: Path, urdf: Path | None) -> "ArmPlant":
    """Load the robot that a run was judged with."""
    from kinebench_drake.report.page import read_results

    config = read_results(out).get("config")
    robot, tcp_frame = (config.get(key) if isinstance(config, Mapping) else None for key in ("robot", "tcp_frame"))
    if robot is None and urdf is not None:
        raise UsageError(f"{out}: was judged with the Panda, leave out --robot")
    if robot is not None and urdf is None:
        raise UsageError(f"{out}: was judged with {robot}, name that file with --robot")
    if urdf is not None and urdf.name != robot:
        raise UsageError(f"{out}: was judged with {robot}, but --robot names {urdf.name}")
    from kinebench_drake.kinematics.plant import ArmPlant
    from kinebench_drake.models.arm import choose_robot

    return ArmPlant(choose_robot(urdf, None if tcp_frame is None else str(tcp_frame)))
