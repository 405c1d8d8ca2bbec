"""Recording of a rollout into which faults are planted, and re-rendering of parts of it."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace

import numpy as np

from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.errors import InputError
from kinebench_drake.suites.faults.fault import FaultForm, PlantedFault
from kinebench_drake.suites.faults.fault_simulator import FaultSimulator
from kinebench_drake.suites.rollout import Rollout, RolloutVideo, join_videos, render_video

LEAST_VISIBLE = 0.01
"""Share of the image that the gripper must cover for a fault to be visible."""
_UNCHANGED = ("camera", "t_s")  # fields that no fault changes


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
        parts = []
        try:
            for i in frames:
                self.simulator.set_snapshot(self.rollout.snapshots[i])
                prepare(i)
                parts.append(render_video(self.simulator, [self.rollout.snapshots[i]], first_frame=i))
        finally:
            self.simulator.clear_faults(self.video.camera)
        return join_videos(parts, self.video.camera)

    def splice(self, part: RolloutVideo, start: int) -> RolloutVideo:
        """Return the video with the frames from `start` on replaced by those of `part`."""
        end = start + len(part.t_s)
        merged = {}
        for field in fields(RolloutVideo):
            value = getattr(self.video, field.name)
            if field.name not in _UNCHANGED:
                value = value.copy()
                value[start:end] = getattr(part, field.name)
            merged[field.name] = value
        return RolloutVideo(**merged)

    def plant(
        self, part: RolloutVideo, start: int, kind: AnomalyKind, size: float, form: FaultForm | None = None
    ) -> tuple[RolloutVideo, PlantedFault]:
        """Return the video with a faulty part from frame `start` on, and the description of the fault."""
        end = start + len(part.t_s) - 1
        fault = PlantedFault(kind=kind, frame_start=start, frame_end=end, size=size, form=form)
        return self.splice(part, start), fault

    def repeat(self, frame: int, count: int) -> RolloutVideo:
        """Return `count` repetitions of a frame, which follow it in time."""
        t_s = self.video.t_s[frame + 1 : frame + 1 + count]
        return replace(self.video.select([frame] * count), t_s=t_s)

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
