"""3D replay of one track: a self-contained Meshcat page."""

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from markupsafe import escape
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Ellipsoid, Mesh, Meshcat, MeshcatParams, Role, Sphere
from pydrake.multibody.tree import BodyIndex

from kinebench_drake.errors import SetupError, UnmeasurableError, UsageError, cause
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.io.jsonl import as_object
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.panda.cad import simplify
from kinebench_drake.report.limit_table import locate_fault
from kinebench_drake.report.replay_scene import LinkMesh, draw_scene, posed_frames
from kinebench_drake.report.run import read_results
from kinebench_drake.report.table import template_environment
from kinebench_drake.report.verdict import describe_verdict
from kinebench_drake.results.inputs import table_height
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.store import artifact_path, read_rows
from kinebench_drake.results.trackfile import TrackFile, read_track
from kinebench_drake.segments import finite_rows

MAX_TRIANGLES = 1600
"""Triangles that a link is simplified to."""
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; "
    "img-src data: blob:; connect-src data: blob:"
)


def write_replays(out: Path, ids: Sequence[str], plant: ArmPlant | None = None) -> list[Path]:
    """Write `replays/ID.html` of some samples of an output folder; samples without a tracked frame are skipped.

    Args:
        plant: the robot that the run was judged with; None is the Panda.

    Returns:
        The files written.

    Raises:
        InputError: a sample's track file is damaged.
        SetupError: writing failed, or the robot's files or Open3D's native libraries are missing.
        UsageError: the folder holds no such sample.
    """
    rows = read_rows(out)
    config = as_object(read_results(out).get("config"))
    written = []
    meshes: Sequence[LinkMesh] = ()
    for id in ids:
        if id not in rows:
            raise UsageError(f"{out}: holds no sample {id!r}")
        track = artifact_path(out, "tracks", id)
        path = artifact_path(out, "replays", id)
        file = read_track(track) if track.is_file() else None
        if file is None or not posed_frames(file).any():
            continue
        plant = plant or ArmPlant()
        meshes = meshes or link_meshes(plant)
        height_m = table_height(rows[id], config)
        write_atomically(path, build_replay(plant, meshes, rows[id], file, table_height_m=height_m).encode())
        written.append(path)
    return written


def build_replay(
    plant: ArmPlant, meshes: Sequence[LinkMesh], row: SampleRow, file: TrackFile, *, table_height_m: float = 0.0
) -> str:
    """Build the html of a track's replay, see `draw_scene`; the same track gives the same bytes.

    Args:
        table_height_m: height of the table in B [m].

    Raises:
        UnmeasurableError: no frame is tracked.
        SetupError: no port can be opened.
    """
    if not posed_frames(file).any():
        raise UnmeasurableError(f"{row.id}: no frame is tracked, there is nothing to show")
    meshcat = _start_server()
    draw_scene(meshcat, plant, meshes, file, table_height_m)
    return _add_controls(str(meshcat.StaticHtml()), row, file)


def _start_server() -> Any:
    """Start a Meshcat server on a free local port; it stops when it is garbage-collected."""
    log = logging.getLogger("drake")
    level = log.level
    log.setLevel(logging.WARNING)  # else it logs its port
    try:
        return Meshcat(MeshcatParams(host="localhost", port=0))
    except RuntimeError as error:
        raise SetupError(
            f"no 3D replay was drawn: Meshcat cannot open a port of this machine ({cause(error)}); $replays=0 leaves "
            "replays out"
        ) from None
    finally:
        log.setLevel(level)


def _add_controls(html: str, row: SampleRow, file: TrackFile) -> str:
    """Add title and controls to Meshcat's page, and forbid it network access."""
    t_s = file.track.t_s
    panel = template_environment().get_template("replay.html.j2")
    controls = panel.render(
        id=row.id,
        verdict=describe_verdict(row),
        faults=[locate_fault(fault, t_s) for faults in (row.violations, row.anomalies) for fault in faults],
        start=float(t_s[0]),
        duration=float(t_s[-1] - t_s[0]),
        has_arm=bool(finite_rows(file.q).any()),
    )
    head = f'<meta charset="utf-8">\n<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
    html = html.replace("<meta charset=utf-8>", head, 1)
    html = html.replace("<title>Drake MeshCat</title>", f"<title>{escape(row.id)} · kinebench-drake</title>", 1)
    before, end, after = html.rpartition("</body>")
    return before + controls + end + after


def link_meshes(plant: ArmPlant) -> tuple[LinkMesh, ...]:
    """Compute simplified surfaces of all links that have one (about three seconds for the Panda).

    They are those of the URDF's visual elements, or of its collision elements for links without visual ones.
    """
    inspector = plant.diagram.GetSubsystemByName("scene_graph").model_inspector()
    meshes = []
    for index in range(plant.drake.num_bodies()):
        body = plant.drake.get_body(BodyIndex(index))
        frame = plant.drake.GetBodyFrameIdIfExists(body.index())
        if frame is None:
            continue
        roles = [inspector.GetGeometries(frame, role) for role in (Role.kPerception, Role.kProximity)]
        parts = []
        for geometry in next((geometries for geometries in roles if geometries), ()):
            part = _to_mesh(inspector.GetShape(geometry))
            if part is not None:
                parts.append(part.apply_transform(inspector.GetPoseInFrame(geometry).GetAsMatrix4()))
        if parts:
            meshes.append(_simplify(body.name(), trimesh.util.concatenate(parts)))
    return tuple(meshes)


def _to_mesh(shape: Any) -> Any:
    """Convert a shape of Drake's to a mesh of trimesh's; None for one without a surface."""
    match shape:
        case Mesh() | Convex():
            mesh = trimesh.load(str(shape.source().path()), force="mesh", process=False)
            mesh.merge_vertices(merge_tex=True, merge_norm=True)
            return mesh.apply_transform(np.diag([*shape.scale3(), 1.0]))
        case Box():
            return trimesh.creation.box(shape.size())
        case Cylinder():
            return trimesh.creation.cylinder(shape.radius(), shape.length(), sections=32)
        case Capsule():
            return trimesh.creation.capsule(shape.length(), shape.radius())
        case Sphere():
            return trimesh.creation.icosphere(2, shape.radius())
        case Ellipsoid():
            return trimesh.creation.icosphere(2).apply_transform(np.diag([shape.a(), shape.b(), shape.c(), 1.0]))
    return None


def _simplify(link: str, mesh: Any) -> LinkMesh:
    """Reduce a mesh to MAX_TRIANGLES at most."""
    vertices = mesh.vertices
    faces = mesh.faces
    if len(faces) > MAX_TRIANGLES:
        vertices, faces = simplify(vertices, faces, MAX_TRIANGLES)
    return LinkMesh(link=link, vertices=np.asarray(vertices, dtype=np.float64), faces=np.asarray(faces, dtype=np.int32))
