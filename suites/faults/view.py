"""Clips whose view changes: the camera turns or moves, or the image is zoomed, as in generated videos."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import cv2
import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, make_pose, rotation_exp
from kinebench_drake.suites.faults.fault import FaultForm
from kinebench_drake.suites.faults.fault_simulator import FaultSimulator
from kinebench_drake.suites.rollout import RolloutVideo, join_videos, render_video
from kinebench_drake.suites.simulator import Snapshot


class ViewKind(Enum):
    """Kind of a change of view."""

    ZOOM = "zoom"
    """Relative magnification about the centre of the image; negative: reduction."""
    TURN = "turn"
    """Rotation of the camera about an axis across its line of sight [degrees]."""
    MOVE = "move"
    """Translation of the camera [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewChange:
    """Change of the view along a clip."""

    kind: ViewKind
    size: float
    """Largest change, in the unit of the kind."""
    form: FaultForm = FaultForm.GROWING
    """Growing from the first frame to the last, or constant from the first frame on."""

    def course(self, frames: int) -> Array:
        """Return the change (T,) in each frame, in the unit of the kind."""
        share = np.ones(frames) if self.form is FaultForm.CONSTANT else np.linspace(0.0, 1.0, frames)
        return np.asarray(self.size * share)


def render_view(
    simulator: FaultSimulator, snapshots: Sequence[Snapshot], change: ViewChange, rng: np.random.Generator
) -> RolloutVideo:
    """Render snapshots with a changing view; poses are those in the camera of each frame.

    Args:
        simulator: simulator, reset to the scene of the snapshots.
        snapshots: states, one per frame.
        change: change of the view.
        rng: draws the direction of a turn or move.
    """
    camera, course = simulator.camera, change.course(len(snapshots))
    direction = rng.normal(size=3) * (1.0, 1.0, change.kind is ViewKind.MOVE)
    direction /= np.linalg.norm(direction)
    parts = []
    try:
        for i, (snapshot, size) in enumerate(zip(snapshots, course, strict=True)):
            if change.kind is not ViewKind.ZOOM:
                simulator.set_camera_pose(_moved(camera, change.kind, size * direction))
            parts.append(render_video(simulator, [snapshot], first_frame=i))
    finally:
        simulator.clear_faults(camera)
    video = join_videos(parts, camera)
    return _zoomed(video, 1.0 + course) if change.kind is ViewKind.ZOOM else video


def _moved(camera: Camera, kind: ViewKind, offset: Array) -> Camera:
    if kind is ViewKind.TURN:
        X_CD = make_pose(rotation_exp(np.deg2rad(offset)), np.zeros(3))
    else:
        X_CD = make_pose(np.eye(3), offset)
    return replace(camera, X_BC=camera.X_BC @ X_CD)


def _zoomed(video: RolloutVideo, zoom: Array) -> RolloutVideo:
    """Return the video with its images magnified about the principal point by `zoom` (T,)."""
    camera, size = video.camera, (video.camera.width, video.camera.height)
    centre = np.array([camera.cx, camera.cy]) - 0.5  # OpenCV's pixel centres are integers
    images = {name: getattr(video, name).copy() for name in ("rgb", "depth_mm", "mask", "robot")}
    for i, factor in enumerate(zoom):
        M = np.column_stack([factor * np.eye(2), (1.0 - factor) * centre])
        for name, values in images.items():
            flags = cv2.INTER_CUBIC if name == "rgb" else cv2.INTER_NEAREST
            image = values[i].astype(np.uint8) if values.dtype == np.bool_ else values[i]
            values[i] = cv2.warpAffine(image, M, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return replace(video, **images)
