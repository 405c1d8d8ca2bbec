"""Scene of a replay: arm, wanted gripper, paths and table as objects of a Meshcat server, and their motion."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Box, MeshcatAnimation, Rgba
from pydrake.math import RigidTransform

from kinebench_drake.geometry import Array, invert, pose_difference
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.results.trackfile import TrackFile
from kinebench_drake.segments import evenly, finite_rows

Color = tuple[float, float, float]

PATH_COLOR = (0.36, 0.45, 0.57)
_REACHED_COLOR = (0.13, 0.38, 0.75)
_ARM_COLOR = (0.90, 0.91, 0.92)
_AXES = {"x": (0.8, 0.0, 0.0), "y": (0.0, 0.6, 0.0), "z": (0.0, 0.0, 0.8)}
"""sRGB of the wanted path, of the path that the arm reaches, of the arm, and of the axes of the small frame at the
TCP."""
_GRIPPER_OPACITY = 0.45
"""Opacity of the wanted gripper beside the arm."""
_APART_M = 0.002
_APART_RAD = 0.02
"""Errors beyond which the wanted gripper is shown beside the arm's own."""
_TICKS_PER_S = 1000.0
"""Time resolution of the animation: keyframes lie on whole ticks."""
_KEY_PERIOD_S = 0.04
"""Greatest time between keyframes of the arm: between them links move on straight lines."""
_MAX_KEYS = 400
_MAX_POINTS = 500
"""Greatest number of keyframes, and of points of a path."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkMesh:
    """Surface of one link."""

    link: str
    vertices: Array
    """(N, 3) in the link's frame [m]."""
    faces: NDArray[np.int32]
    """(M, 3) indices of vertices."""


def posed_frames(file: TrackFile) -> NDArray[np.bool_]:
    """Return which frames (T,) have a pose."""
    return np.asarray(np.isfinite(file.track.X_BG).all(axis=(1, 2)), dtype=bool)


def pose_links(plant: ArmPlant, meshes: Sequence[LinkMesh], q: Array, width: Array) -> list[Array]:
    """Return the poses (N, 4, 4) in B of some links for joint angles (N, 7) and gaps between the pads (N,).

    An unknown gap is the plant's.
    """
    bodies = [plant.drake.GetBodyByName(mesh.link) for mesh in meshes]
    poses = np.empty((len(bodies), len(q), 4, 4))
    for k in range(len(q)):
        plant.set_posture(q[k], float(width[k]) if np.isfinite(width[k]) else None)
        for body, X in zip(bodies, poses, strict=True):
            X[k] = plant.drake.EvalBodyPoseInWorld(plant.context, body).GetAsMatrix4()
    return list(poses)


def draw_scene(
    meshcat: Any, plant: ArmPlant, meshes: Sequence[LinkMesh], file: TrackFile, table_height_m: float
) -> None:
    """Draw a track, with a pose in at least one frame, and animate it at its own speed.

    The arm moves where joint angles are known, interpolated between frames; without joint angles the gripper alone
    moves. Where arm and wanted pose differ, a translucent gripper shows the wanted pose and a line the path reached.

    Args:
        table_height_m: height of the table in B [m].
    """
    posed = posed_frames(file)
    solved = finite_rows(file.q)
    X_BG = file.track.X_BG[posed]
    reached = plant.forward_path(file.q[solved])
    apart = _find_apart(file, posed, solved, reached)
    _draw_table(meshcat, table_height_m)
    _draw_path(meshcat, "/wanted", X_BG[:, :3, 3], 0.004, PATH_COLOR)
    if apart.any():
        _draw_path(meshcat, "/reached", reached[:, :3, 3], 0.0025, _REACHED_COLOR)
    animation = MeshcatAnimation(_TICKS_PER_S)
    animation.set_loop_mode(MeshcatAnimation.LoopMode.kLoopRepeat)
    animation.set_repetitions(1_000_000)
    t_s = file.track.t_s - file.track.t_s[0]
    for name, direction, color in zip(_AXES, 0.06 * np.eye(3), _AXES.values(), strict=True):
        _draw_path(meshcat, f"/tcp/{name}", np.stack([np.zeros(3), direction]), 0.002, color)
    _move(animation, "/tcp", t_s[posed], X_BG)
    if solved.any():
        _animate_arm(meshcat, animation, plant, meshes, file)
    if apart.any() or not solved.any():
        robot = plant.robot
        fingers = {plant.drake.GetJointByName(name).child_body().name() for name in robot.finger_joints}
        hand = [mesh for mesh in meshes if mesh.link in fingers | {robot.hand_link}]
        opacity = _GRIPPER_OPACITY if solved.any() else 1.0
        X_GB = invert(plant.forward(robot.rest_q))
        rest_q = np.tile(robot.rest_q, (len(X_BG), 1))
        for mesh, poses in zip(hand, pose_links(plant, hand, rest_q, _widths(file, t_s[posed])), strict=True):
            _draw_mesh(meshcat, f"/gripper/{mesh.link}", mesh.vertices, mesh.faces, _ARM_COLOR, opacity)
            _move(animation, f"/gripper/{mesh.link}", t_s[posed], X_GB @ poses)
        _move(animation, "/gripper", t_s[posed], X_BG)
    if apart.any():
        for t, shown in zip(t_s, apart, strict=True):
            animation.SetProperty(round(t * _TICKS_PER_S), "/gripper", "visible", bool(shown))
    meshcat.SetAnimation(animation)
    points = np.vstack([X_BG[:, :3, 3], [[0.0, 0.0, 0.0], [0.0, 0.0, 0.6]]])
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = max(float(np.linalg.norm(points - centre, axis=-1).max()), 0.35)
    meshcat.SetCameraPose(centre + 1.6 * radius * np.array([0.75, 0.85, 0.55]), centre)


def _find_apart(
    file: TrackFile, posed: NDArray[np.bool_], solved: NDArray[np.bool_], reached: Array
) -> NDArray[np.bool_]:
    """Return the frames (T,) in which the arm, at the poses `reached` where solved, misses the wanted pose."""
    apart = np.zeros(len(posed), dtype=bool)
    both = solved & posed
    distance_m, angle_rad = pose_difference(reached[both[solved]], file.track.X_BG[both])
    apart[both] = (distance_m > _APART_M) | (angle_rad > _APART_RAD)
    return apart


def _animate_arm(
    meshcat: Any, animation: MeshcatAnimation, plant: ArmPlant, meshes: Sequence[LinkMesh], file: TrackFile
) -> None:
    t_s = file.track.t_s - file.track.t_s[0]
    solved = finite_rows(file.q)
    frames = max(len(t_s) - 1, 1)
    steps = frames * max(round(t_s[-1] / frames / _KEY_PERIOD_S), 1)
    times = np.linspace(0.0, t_s[-1], min(steps, _MAX_KEYS) + 1)
    q = np.stack([np.interp(times, t_s[solved], angle) for angle in file.q[solved].T], axis=-1)
    for mesh, poses in zip(meshes, pose_links(plant, meshes, q, _widths(file, times)), strict=True):
        _draw_mesh(meshcat, f"/arm/{mesh.link}", mesh.vertices, mesh.faces, _ARM_COLOR)
        _move(animation, f"/arm/{mesh.link}", times, poses)


def _widths(file: TrackFile, times: Array) -> Array:
    """Return the gaps between the pads at some times (N,) after the track's start; NaN if none was measured."""
    width_m = file.track.finger_width_m
    measured = np.isfinite(width_m)
    if not measured.any():
        return np.full(len(times), np.nan)
    return np.interp(times, file.track.t_s[measured] - file.track.t_s[0], width_m[measured])


def _draw_table(meshcat: Any, height_m: float) -> None:
    """Draw the table's top as a thin slab, instead of Meshcat's grid."""
    for path in ("/Grid", "/Axes"):
        meshcat.SetProperty(path, "visible", False)
    meshcat.SetProperty("/Background/<object>", "top_color", [0.97, 0.98, 1.0])
    meshcat.SetProperty("/Background/<object>", "bottom_color", [0.80, 0.83, 0.87])
    meshcat.SetObject("/table", Box(1.2, 1.4, 0.01), Rgba(0.62, 0.53, 0.42, 0.35))
    meshcat.SetTransform("/table", RigidTransform([0.4, 0.0, height_m - 0.005]))


def _draw_path(meshcat: Any, path: str, points: Array, radius: float, color: Color) -> None:
    """Draw a thin tube along points (N, 3), at most _MAX_POINTS of them."""
    pairs = pairwise(points[evenly(len(points), _MAX_POINTS)])
    pieces = [
        trimesh.creation.cylinder(radius, sections=6, segment=pair) for pair in pairs if np.ptp(pair, axis=0).any()
    ]
    pieces = pieces or [trimesh.creation.icosphere(1, radius).apply_translation(points[0])]
    tube = trimesh.util.concatenate(pieces)
    _draw_mesh(meshcat, path, tube.vertices, tube.faces, color)


def _draw_mesh(
    meshcat: Any, path: str, vertices: ArrayLike, faces: ArrayLike, color: Color, opacity: float = 1.0
) -> None:
    meshcat.SetTriangleMesh(
        path,
        np.asfortranarray(np.asarray(vertices, dtype=np.float64).T),
        np.asfortranarray(np.asarray(faces, dtype=np.int32).T),
        Rgba(*color, opacity),
    )


def _move(animation: MeshcatAnimation, path: str, times: Array, poses: Array) -> None:
    moving = not np.allclose(poses, poses[0], atol=1e-7)
    for t, X in zip(times, poses, strict=True) if moving else [(times[0], poses[0])]:
        animation.SetTransform(round(t * _TICKS_PER_S), path, RigidTransform(X))
