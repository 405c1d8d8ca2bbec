"""A filmed performance into which faults are planted, and how parts of it are filmed again."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields

import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError
from kinebench_drake.suites.clip import RolloutVideo, film
from kinebench_drake.suites.faults.fault_simulator import FaultSimulator
from kinebench_drake.suites.rollout import Rollout

LEAST_VISIBLE = 0.01
"""Part of the image that the gripper must cover for a fault to be seen."""
_APART = ("camera", "t_s")  # what a fault leaves as it is


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """A performance and its film."""

    stage: FaultSimulator
    """The scene of the performance, after its `reset`."""
    performance: Rollout
    """What was done."""
    clip: RolloutVideo
    """The film without a fault."""

    def __len__(self) -> int:
        """Frames."""
        return len(self.clip.t_s)

    def film_again(self, frames: Iterable[int], prepare: Callable[[int], None]) -> RolloutVideo:
        """Film some frames in a row, each after `prepare` has tricked the stage; then the stage is honest again."""
        parts = []
        try:
            for i in frames:
                self.stage.show(self.performance.snapshots[i])
                prepare(i)
                parts.append(film(self.stage, [self.performance.snapshots[i]], first_frame=i))
        finally:
            self.stage.be_honest(self.clip.camera)
        return _join(parts, self.clip.camera)

    def spliced(self, part: RolloutVideo, start: int) -> RolloutVideo:
        """The clip with the frames from `start` on replaced by those of `part`."""
        end = start + len(part.t_s)
        merged = {}
        for field in fields(RolloutVideo):
            value = getattr(self.clip, field.name)
            if field.name not in _APART:
                value = value.copy()
                value[start:end] = getattr(part, field.name)
            merged[field.name] = value
        return RolloutVideo(**merged)

    def held(self, frame: int, count: int) -> RolloutVideo:
        """The film of one frame `count` times, to follow it."""
        repeated = {
            field.name: np.repeat(getattr(self.clip, field.name)[frame : frame + 1], count, axis=0)
            for field in fields(RolloutVideo)
            if field.name not in _APART
        }
        return RolloutVideo(camera=self.clip.camera, t_s=self.clip.t_s[frame + 1 : frame + 1 + count], **repeated)

    def stretches(self, frames: int) -> list[int]:
        """Frames that begin a stretch of `frames` frames with the gripper in view, fastest stretch first.

        Stretches end two frames before the clip does, so that the clip recovers, and begin three in.

        Raises:
            InputError: there is none.
        """
        visible = self.clip.mask.mean(axis=(1, 2)) >= LEAST_VISIBLE
        p = self.clip.X_BG[:, :3, 3]
        starts = [i for i in range(3, len(p) - frames - 1) if visible[i - 1 : i + frames + 1].all()]
        if not starts:
            raise InputError(
                f"in no {frames} frames in a row the gripper covers {LEAST_VISIBLE:.0%} of the image; take another seed"
            )
        way = {i: float(np.linalg.norm(np.diff(p[i - 1 : i + frames + 1], axis=0), axis=1).sum()) for i in starts}
        return sorted(starts, key=lambda i: (-way[i], i))


def _join(parts: Sequence[RolloutVideo], camera: Camera) -> RolloutVideo:
    joined = {
        field.name: np.concatenate([getattr(part, field.name) for part in parts])
        for field in fields(RolloutVideo)
        if field.name != "camera"
    }
    return RolloutVideo(camera=camera, **joined)
