"""A replay of one track in 3D: a Meshcat page that needs nothing but a browser, coloured by feasibility."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import escape
from pydrake.geometry import Meshcat, MeshcatParams

from kinebench_drake.errors import SetupError, UnmeasurableError, UsageError, cause
from kinebench_drake.geometry import Array
from kinebench_drake.io.atomic import disk_errors, write_atomically
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.report.frames import anomalies_of, frame_states
from kinebench_drake.report.link_meshes import link_meshes
from kinebench_drake.report.page import read_results
from kinebench_drake.report.replay_scene import COLORS, ReplayScene, posed_frames
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.store import artifact_path, read_rows
from kinebench_drake.results.trackfile import TrackFile, read_track
from kinebench_drake.types import Json

_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; "
    "img-src data: blob:; connect-src data: blob:"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Mark:
    """One fault as the page lists it."""

    text: str
    time: float
    """When it begins, after the track's start [s]."""
    css: str


class ReplayWriter:
    """Writes replays of one robot; simplifies its meshes once (some two seconds)."""

    def __init__(self, plant: ArmPlant | None = None) -> None:
        """Take the robot; None takes the Panda.

        Raises:
            SetupError: the robot's files or Open3D's native libraries are missing.
        """
        self._plant = plant or ArmPlant()
        self._surfaces = link_meshes(self._plant)

    def write(self, path: Path, row: SampleRow, file: TrackFile, *, table_height_m: float = 0.0) -> None:
        """Write the replay of a track; the same track gives the same bytes.

        The path of the gripper is coloured by `frame_states`. Along it moves the arm where joint angles are known,
        coloured likewise, the link of a joint at fault in full red; the gripper alone where none are. Where arm and
        wanted pose lie apart, a second, translucent gripper shows what was wanted, and a blue line what was reached.
        Frames that are not tracked are bridged.

        Args:
            path: the html file.
            row: verdict, violations and anomalies.
            file: the track.
            table_height_m: height of the table in B [m].

        Raises:
            UnmeasurableError: no frame is tracked.
            SetupError: writing failed.
        """
        write_atomically(path, self.page(row, file, table_height_m=table_height_m).encode())

    def page(self, row: SampleRow, file: TrackFile, *, table_height_m: float = 0.0) -> str:
        """The html text that `write` writes."""
        if not posed_frames(file).any():
            raise UnmeasurableError(f"{row.id}: no frame is tracked, there is nothing to show")
        meshcat = _server()
        scene = ReplayScene(self._plant, self._surfaces, meshcat, row, file)
        scene.draw_table(table_height_m)
        scene.draw_paths()
        scene.animate()
        scene.place_camera()
        return _finished(str(meshcat.StaticHtml()), row, file, scene.has_arm)


def write_replays(out: Path, ids: Sequence[str], plant: ArmPlant | None = None) -> list[Path]:
    """Write `replays/ID.html` of some samples of an output folder; samples without a track are passed over.

    Args:
        out: output folder of a run.
        ids: samples of it.
        plant: the robot that the run was judged with; None takes the Panda.

    Raises:
        InputError: a sample's track file is damaged.
        SetupError: writing failed, or the robot's files are missing.
        UsageError: the folder holds no such sample.
    """
    rows = read_rows(out)
    written = []
    writer = None
    for id in ids:
        if id not in rows:
            raise UsageError(f"{out}: holds no sample {id!r}")
        if not artifact_path(out, "tracks", id).is_file():
            continue
        file = read_track(artifact_path(out, "tracks", id))
        if not posed_frames(file).any():
            continue
        writer = writer or ReplayWriter(plant)
        path = replay_path(out, id)
        with disk_errors(f"replays/{path.name}"):
            path.parent.mkdir(exist_ok=True)
        writer.write(path, rows[id], file, table_height_m=_table_height_m(out))
        written.append(path)
    return written


def replay_path(out: Path, id: str) -> Path:
    """Where a sample's replay lies."""
    return artifact_path(out, "replays", id)


def _table_height_m(out: Path) -> float:
    config = read_results(out).get("config")
    height = config.get("table_height_m") if isinstance(config, Mapping) else None
    return float(height) if isinstance(height, int | float) else 0.0


def _server() -> Any:
    """A Meshcat server on a free port of this machine alone; gone with its last name.

    Raises:
        SetupError: no port can be opened.
    """
    log = logging.getLogger("drake")
    level = log.level
    log.setLevel(logging.WARNING)  # else it tells of its port, which nobody needs
    try:
        server = Meshcat(MeshcatParams(host="localhost", port=0))
    except RuntimeError as error:
        raise SetupError(f"Meshcat, which draws replays, cannot open a port of this machine ({cause(error)})") from None
    finally:
        log.setLevel(level)
    return server


def _finished(html: str, row: SampleRow, file: TrackFile, has_arm: bool) -> str:
    """The page with its name, controls and key, shut off from the network."""
    t_s = file.track.t_s
    marks = [_mark(v, "broken", t_s) for v in row.violations] + [_mark(a, "doubt", t_s) for a in anomalies_of(row)]
    states = [state.value for state in frame_states(row, file)]
    environment = Environment(
        loader=PackageLoader("kinebench_drake.report", "."), autoescape=True, undefined=StrictUndefined
    )
    panel = environment.get_template("replay.html.j2").render(
        id=row.id,
        verdict={True: "Feasible for the robot", False: "Infeasible for the robot", None: "Not judged"}[row.feasible],
        marks=marks,
        colors={state.value: "#" + "".join(f"{round(255 * v):02x}" for v in rgb) for state, rgb in COLORS.items()},
        stretches=[(state, len(list(group))) for state, group in groupby(states)],
        start=float(t_s[0]),
        duration=float(t_s[-1] - t_s[0]),
        has_arm=has_arm,
    )
    head = f'<meta charset="utf-8">\n<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
    html = html.replace("<meta charset=utf-8>", head, 1)
    html = html.replace("<title>Drake MeshCat</title>", f"<title>{escape(row.id)} · kinebench-drake</title>", 1)
    before, end, after = html.rpartition("</body>")
    return before + panel + end + after


def _mark(fault: Mapping[str, Json], css: str, t_s: Array) -> Mark:
    start, end = (fault.get(key) for key in ("frame_start", "frame_end"))
    first, last = (min(max(k, 0), len(t_s) - 1) if isinstance(k, int) else 0 for k in (start, end))
    joint = f", {fault['joint']}" if fault.get("joint") is not None else ""
    span = f"{t_s[first]:.2f}" if first == last else f"{t_s[first]:.2f} to {t_s[last]:.2f}"
    kind = str(fault.get("kind")).replace("_", " ")
    return Mark(text=f"{kind}{joint}: {span} s", time=float(t_s[first] - t_s[0]), css=css)
