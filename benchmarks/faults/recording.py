"""Recording of a rollout into which faults are planted, and rendering with faults or with a view that changes."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from enum import Enum

import cv2
import numpy as np
from numpy.typing import ArrayLike

from benchmarks.faults.fault import FaultForm, PlantedFault
from benchmarks.faults.fault_simulator import FaultSimulator
from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, make_pose, rotation_exp
from kinebench_drake.suites.rollout import Rollout, RolloutVideo, join_videos, render_video
from kinebench_drake.suites.simulator import Snapshot
from training.viewpoint import place_camera

LEAST_VISIBLE = 0.01
"""Share of the image that the gripper must cover for a fault to be visible."""
_UNCHANGED = ("camera", "t_s")
"""Fields that no fault changes."""


def _render_prepared(
    simulator: FaultSimulator, snapshots: Sequence[Snapshot], frames: Iterable[int], prepare: Callable[[int], None]
) -> RolloutVideo:
    """Render consecutive frames, each after `prepare` has set a fault; faults are cleared at the end."""
    parts = []
    camera = simulator.camera
    try:
        for i in frames:
            simulator.set_snapshot(snapshots[i])
            prepare(i)
            parts.append(render_video(simulator, [snapshots[i]], first_frame=i))
    finally:
        simulator.clear_faults(camera)
    return join_videos(parts, camera)


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """Rollout with its video."""

    simulator: FaultSimulator
    """Simulator, reset to the episode of the rollout."""
    rollout: Rollout
    video: RolloutVideo
    """Video of the rollout without fault."""

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.video.t_s)

    def render_again(self, frames: Iterable[int], prepare: Callable[[int], None]) -> RolloutVideo:
        """Render consecutive frames again, each after `prepare` has set a fault; faults are cleared at the end."""
        return _render_prepared(self.simulator, self.rollout.snapshots, frames, prepare)

    def plant(
        self, part: RolloutVideo, start: int, kind: AnomalyKind, size: float, form: FaultForm | None = None
    ) -> tuple[RolloutVideo, PlantedFault]:
        """Return the video with a faulty part from frame `start` on, and the description of the fault."""
        end = start + len(part.t_s)
        merged = {}
        for field in fields(RolloutVideo):
            if field.name not in _UNCHANGED:
                merged[field.name] = getattr(self.video, field.name).copy()
                merged[field.name][start:end] = getattr(part, field.name)
        fault = PlantedFault(kind=kind, frame_start=start, frame_end=end - 1, size=size, form=form)
        return replace(self.video, **merged), fault

    def visible_starts(self, frames: int) -> list[int]:
        """Return first frames of all stretches of `frames` frames with the gripper in view, fastest motion first.

        Stretches begin three frames after the start of the video and end two before its end, so that it recovers.

        Raises:
            InputError: there is none.
        """
        visible = self.video.mask.mean(axis=(1, 2)) >= LEAST_VISIBLE
        p = self.video.X_BG[:, :3, 3]
        starts = [i for i in range(3, len(p) - frames - 1) if visible[i - 1 : i + frames + 1].all()]
        if not starts:
            raise InputError(
                f"in no {frames} frames in a row the gripper covers {LEAST_VISIBLE:.0%} of the image; take another seed"
            )
        path = {i: float(np.linalg.norm(np.diff(p[i - 1 : i + frames + 1], axis=0), axis=1).sum()) for i in starts}
        return sorted(starts, key=lambda i: (-path[i], i))


class ViewKind(Enum):
    """Kind of a change of view, as in generated videos."""

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
    """Growing or constant."""


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
    camera = simulator.camera
    course = np.asarray(change.size * change.form.course(len(snapshots)))
    direction = rng.normal(size=3) * (1.0, 1.0, change.kind is ViewKind.MOVE)
    direction /= np.linalg.norm(direction)

    def displace(i: int) -> None:
        offset = course[i] * direction
        if change.kind is ViewKind.TURN:
            place_camera(simulator, move_camera(camera, rotation=np.deg2rad(offset)))
        elif change.kind is ViewKind.MOVE:
            place_camera(simulator, move_camera(camera, translation=offset))

    video = _render_prepared(simulator, snapshots, range(len(snapshots)), displace)
    return _zoom(video, 1.0 + course) if change.kind is ViewKind.ZOOM else video


def move_camera(
    camera: Camera, *, rotation: ArrayLike = (0.0, 0.0, 0.0), translation: ArrayLike = (0.0, 0.0, 0.0)
) -> Camera:
    """Return the camera rotated by a rotation vector (3,) [rad] and moved by `translation` (3,) [m] in its own axes."""
    return replace(camera, X_BC=camera.X_BC @ make_pose(rotation_exp(rotation), translation))


def _zoom(video: RolloutVideo, zoom: Array) -> RolloutVideo:
    """Return the video with its images magnified about the principal point by `zoom` (T,)."""
    camera = video.camera
    size = (video.camera.width, video.camera.height)
    centre = np.array([camera.cx, camera.cy]) - 0.5  # OpenCV's pixel centres are integers
    images = {name: getattr(video, name).copy() for name in ("rgb", "depth_mm", "mask", "robot")}
    for i, factor in enumerate(zoom):
        M = np.column_stack([factor * np.eye(2), (1.0 - factor) * centre])
        for name, values in images.items():
            flags = cv2.INTER_CUBIC if name == "rgb" else cv2.INTER_NEAREST
            image = values[i].astype(np.uint8) if values.dtype == np.bool_ else values[i]
            values[i] = cv2.warpAffine(image, M, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return replace(video, **images)
