"""Recording of a rollout into which faults are planted, and rendering with faults or with a view that changes."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike

from benchmarks.faults.fault import FaultForm, PlantedFault
from benchmarks.faults.fault_simulator import FaultSimulator
from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError
from kinebench_drake.geometry import make_pose, rotation_exp
from kinebench_drake.suites.rollout import Rollout, RolloutVideo, join_videos, render_video
from kinebench_drake.suites.simulator import Snapshot

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


def move_camera(
    camera: Camera, *, rotation: ArrayLike = (0.0, 0.0, 0.0), translation: ArrayLike = (0.0, 0.0, 0.0)
) -> Camera:
    """Return the camera rotated by a rotation vector (3,) [rad] and moved by `translation` (3,) [m] in its own axes."""
    return replace(camera, X_BC=camera.X_BC @ make_pose(rotation_exp(rotation), translation))
