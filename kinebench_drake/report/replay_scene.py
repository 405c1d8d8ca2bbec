"""Scene of a replay: arm, wanted gripper, paths and table as objects of a Meshcat server, and their motion."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Box, MeshcatAnimation, Rgba
from pydrake.math import RigidTransform
from scipy.spatial.transform import Rotation, Slerp

from kinebench_drake.geometry import Array, invert, make_pose, pose_difference
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.report.timeline import FrameState, covered_frames, frame_states
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.trackfile import TrackFile
from kinebench_drake.segments import segments

Color = tuple[float, float, float]

COLORS = {
    FrameState.OK: (0.36, 0.45, 0.57),
    FrameState.DOUBT: (0.93, 0.58, 0.07),
    FrameState.UNTRACKED: (0.60, 0.64, 0.69),
    FrameState.BROKEN: (0.84, 0.16, 0.09),
}
"""sRGB of the path and of the legend."""
_ARM_COLORS = {
    FrameState.OK: (0.90, 0.91, 0.92),
    FrameState.DOUBT: (0.97, 0.84, 0.62),
    FrameState.UNTRACKED: (0.66, 0.69, 0.73),
    FrameState.BROKEN: (0.95, 0.62, 0.57),
}
_AXES = {"x": (0.8, 0.0, 0.0), "y": (0.0, 0.6, 0.0), "z": (0.0, 0.0, 0.8)}
"""sRGB of the axes of the small frame at the TCP."""
_TICKS_PER_S = 1000.0
"""Time resolution of the animation: keyframes lie on whole ticks."""
_MAX_POINTS = 500
_SIDES = 6


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


class ReplayScene:
    """Objects of one track and their motion, in a Meshcat server."""

    def __init__(
        self, plant: ArmPlant, meshes: Sequence[LinkMesh], meshcat: Any, row: SampleRow, file: TrackFile
    ) -> None:
        """Prepare the scene.

        Args:
            file: the track, with a pose in at least one frame.
        """
        self._plant = plant
        self._meshes = meshes
        self._meshcat = meshcat
        self._row = row
        self._t_s = file.track.t_s
        self._X_BG = file.track.X_BG
        self._q = file.q
        self._posed = posed_frames(file)
        self._solved = np.isfinite(file.q).all(axis=-1)
        self._states = frame_states(row, file)
        self.has_arm = bool(self._solved.any())
        """True if any frame has joint angles."""
        width = file.track.finger_width_m
        measured = np.isfinite(width)
        self._width = (
            np.interp(self._t_s, self._t_s[measured], width[measured])
            if measured.any()
            else np.full(len(width), plant.finger_width_m)
        )
        self._reached = plant.forward_path(file.q[self._solved])
        self._apart = np.zeros(len(self._t_s), dtype=bool)
        both = self._solved & self._posed
        distance, angle = pose_difference(self._reached[both[self._solved]], self._X_BG[both])
        # Errors beyond which the wanted gripper is shown beside the arm's own [m], [rad].
        self._apart[both] = (distance > 0.002) | (angle > 0.02)

    def draw_table(self, height_m: float) -> None:
        """Draw the table's top as a thin slab, instead of Meshcat's grid."""
        for path in ("/Grid", "/Axes"):
            self._meshcat.SetProperty(path, "visible", False)
        self._meshcat.SetProperty("/Background/<object>", "top_color", [0.97, 0.98, 1.0])
        self._meshcat.SetProperty("/Background/<object>", "bottom_color", [0.80, 0.83, 0.87])
        self._meshcat.SetObject("/table", Box(1.2, 1.4, 0.01), Rgba(0.62, 0.53, 0.42, 0.35))
        self._meshcat.SetTransform("/table", RigidTransform([0.4, 0.0, height_m - 0.005]))

    def draw_paths(self) -> None:
        """Draw the wanted path, coloured by state, with beads at violations; and the path reached if it differs."""
        frames = np.flatnonzero(self._posed)
        points = self._X_BG[frames, :3, 3]
        for k in np.flatnonzero(np.diff(frames) > 1):
            self._mesh(f"/wanted/gap{k}", *tube(points[k : k + 2], 0.002), COLORS[FrameState.UNTRACKED])
        for run in segments(self._posed):
            kept = _thin(run.start, run.stop)
            color = np.array([linear_color(COLORS[self._states[k]]) for k in kept])
            vertices, faces = tube(self._X_BG[kept, :3, 3], 0.004)
            colors = np.repeat(color, _SIDES, axis=0)
            arrays = (np.asfortranarray(array.T) for array in (vertices, faces, colors))
            self._meshcat.SetTriangleColorMesh(f"/wanted/{run.start}", *arrays)
        broken = [k for k in frames if self._states[k] is FrameState.BROKEN]
        broken = broken[:: -(-len(broken) // 300) or 1]
        if broken:
            bead = trimesh.creation.icosphere(1, 0.008)
            beads = trimesh.util.concatenate([bead.copy().apply_translation(self._X_BG[k, :3, 3]) for k in broken])
            self._mesh("/broken", beads.vertices, beads.faces, COLORS[FrameState.BROKEN])
        if self._apart.any():
            reached = self._reached[_thin(0, len(self._reached)), :3, 3]
            self._mesh("/reached", *tube(reached, 0.0025), (0.13, 0.38, 0.75))

    def place_camera(self) -> None:
        """Point the camera at base and path from the robot's front left."""
        points = np.vstack([self._X_BG[self._posed, :3, 3], [[0.0, 0.0, 0.0], [0.0, 0.0, 0.6]]])
        centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
        radius = max(float(np.linalg.norm(points - centre, axis=-1).max()), 0.35)
        self._meshcat.SetCameraPose(centre + 1.6 * radius * np.array([0.75, 0.85, 0.55]), centre)

    def animate(self) -> None:
        """Animate arm, wanted gripper and TCP frame at the track's own speed."""
        times = self._times()
        animation = MeshcatAnimation(_TICKS_PER_S)
        animation.set_loop_mode(MeshcatAnimation.LoopMode.kLoopRepeat)
        animation.set_repetitions(1_000_000)
        wanted = interpolate_poses(times, self._t_s[self._posed], self._X_BG[self._posed])
        width = np.interp(times, self._t_s, self._width)
        self._move(animation, "/tcp", times, wanted)
        for axis, (name, color) in enumerate(_AXES.items()):
            ends = np.stack([np.zeros(3), 0.06 * np.eye(3)[axis]])
            self._mesh(f"/tcp/{name}", *tube(ends, 0.002), color)
        if self.has_arm:
            t_solved = self._t_s[self._solved]
            q_solved = self._q[self._solved]
            q = np.stack([np.interp(times, t_solved, q_solved[:, j]) for j in range(q_solved.shape[1])], axis=-1)
            for mesh, poses in zip(self._meshes, pose_links(self._plant, self._meshes, q, width), strict=True):
                path = f"/arm/{mesh.link}"
                self._mesh(path, mesh.vertices, mesh.faces, _ARM_COLORS[FrameState.OK])
                self._move(animation, path, times, poses)
                self._tint(animation, path, self._link_colors(mesh.link))
        if self.has_arm and not self._apart.any():
            self._meshcat.SetAnimation(animation)
            return
        gripper = self._gripper()
        rest = np.broadcast_to(self._plant.robot.rest_q, (len(times), 7))
        X_GB = invert(self._plant.forward(self._plant.robot.rest_q))
        self._move(animation, "/gripper", times, wanted)
        # 0.45: opacity of the wanted gripper beside the arm
        opacity, colors = (0.45, COLORS) if self.has_arm else (1.0, _ARM_COLORS)
        for mesh, poses in zip(gripper, pose_links(self._plant, gripper, rest, width), strict=True):
            path = f"/gripper/{mesh.link}"
            self._mesh(path, mesh.vertices, mesh.faces, _ARM_COLORS[FrameState.OK], opacity)
            self._move(animation, path, times, X_GB @ poses)
            self._tint(animation, path, [colors[state] for state in self._states])
        if self.has_arm:
            for tick, apart in self._changes([bool(a) for a in self._apart]):
                animation.SetProperty(tick, "/gripper", "visible", apart)
        self._meshcat.SetAnimation(animation)

    def _times(self) -> Array:
        """Return evenly spaced keyframes (N,) [s]; they include the frames if these are even and not too many."""
        duration = float(self._t_s[-1] - self._t_s[0])
        frames = max(len(self._t_s) - 1, 1)
        steps = frames * max(round(duration / frames / 0.04), 1)  # greatest time between keyframes
        return np.linspace(self._t_s[0], self._t_s[-1], min(steps, 400) + 1)

    def _gripper(self) -> list[LinkMesh]:
        """Return the meshes of hand and fingers."""
        robot = self._plant.robot
        fingers = {self._plant.drake.GetJointByName(name).child_body().name() for name in robot.finger_joints}
        return [mesh for mesh in self._meshes if mesh.link in fingers | {robot.hand_link}]

    def _link_colors(self, link: str) -> list[Color]:
        """Return the colour of a link in each frame: full red where its own joint violates a limit."""
        colors = [_ARM_COLORS[state] for state in self._states]
        joints = [
            j for j in self._plant.robot.joints if self._plant.drake.GetJointByName(j).child_body().name() == link
        ]
        broken = covered_frames([v for v in self._row.violations if v.joint in joints], len(colors))
        return [COLORS[FrameState.BROKEN] if b else color for color, b in zip(colors, broken, strict=True)]

    def _mesh(self, path: str, vertices: ArrayLike, faces: ArrayLike, color: Color, opacity: float = 1.0) -> None:
        self._meshcat.SetTriangleMesh(
            path,
            np.asfortranarray(np.asarray(vertices, dtype=np.float64).T),
            np.asfortranarray(np.asarray(faces, dtype=np.int32).T),
            Rgba(*color, opacity),
        )

    def _tick(self, t: float) -> int:
        return round((t - float(self._t_s[0])) * _TICKS_PER_S)

    def _move(self, animation: Any, path: str, times: Array, poses: Array) -> None:
        moving = len(poses) > 1 and not np.allclose(poses, poses[0], atol=1e-7)
        for t, X in zip(times, poses, strict=True) if moving else [(times[0], poses[0])]:
            animation.SetTransform(self._tick(t), path, RigidTransform(X))

    def _changes(self, values: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """Yield the ticks half-way between frames at which a value per frame changes, with the values on both sides."""
        yield 0, values[0]
        for k in range(1, len(values)):
            if values[k] != values[k - 1]:
                tick = self._tick(0.5 * float(self._t_s[k - 1] + self._t_s[k]))
                yield tick, values[k - 1]
                yield tick + 1, values[k]

    def _tint(self, animation: Any, path: str, colors: Sequence[Color]) -> None:
        for tick, color in self._changes(colors):
            animation.SetProperty(tick, f"{path}/<object>", "material.color", linear_color(color))


def interpolate_poses(times: Array, t_s: Array, X: Array) -> Array:
    """Interpolate poses `X` (T, 4, 4) at `t_s` (T,) to `times` (N,): linearly, rotations by slerp."""
    if len(t_s) == 1:
        return np.repeat(X, len(times), axis=0)
    inside = np.clip(times, t_s[0], t_s[-1])
    p = np.stack([np.interp(inside, t_s, X[:, k, 3]) for k in range(3)], axis=-1)
    return make_pose(Slerp(t_s, Rotation.from_matrix(X[:, :3, :3]))(inside).as_matrix(), p)


def _thin(start: int, stop: int) -> NDArray[np.intp]:
    """Return at most _MAX_POINTS frames from `start` to `stop`, both ends included."""
    return np.unique(np.linspace(start, stop - 1, min(stop - start, _MAX_POINTS)).round().astype(np.intp))


def tube(points: Array, radius: float) -> tuple[Array, NDArray[np.int32]]:
    """Compute vertices (_SIDES T, 3) and faces of a thin tube along `points` (T, 3), one ring per point in order."""
    n = len(points)
    along = np.gradient(points, axis=0) if n > 1 else np.zeros((1, 3))
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    along = np.where(length > 1e-12, along / np.maximum(length, 1e-12), [0.0, 0.0, 1.0])
    aside = np.cross(along, np.eye(3)[np.argmin(np.abs(along), axis=-1)])
    aside /= np.linalg.norm(aside, axis=-1, keepdims=True)
    up = np.cross(along, aside)
    angle = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    ring = np.cos(angle)[None, :, None] * aside[:, None] + np.sin(angle)[None, :, None] * up[:, None]
    k, s = np.meshgrid(np.arange(n - 1) * _SIDES, np.arange(_SIDES), indexing="ij")
    a = (k + s).ravel()
    b = (k + (s + 1) % _SIDES).ravel()
    faces = np.concatenate([np.stack([a, b, b + _SIDES], axis=-1), np.stack([a, b + _SIDES, a + _SIDES], axis=-1)])
    return (points[:, None] + radius * ring).reshape(-1, 3), faces.astype(np.int32)


def linear_color(color: Color) -> list[float]:
    """Convert an sRGB colour to linear light (IEC 61966-2-1), the scale of animated material colours."""
    c = np.asarray(color)
    return [float(v) for v in np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)]
