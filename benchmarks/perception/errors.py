"""Frame-by-frame errors of the grounding of one clip against its ground truth."""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from benchmarks.perception.clip import TruthClip
from benchmarks.perception.store import Confidences, Flags, Micro, Milli, Stored
from kinebench_drake.anomaly import Anomaly
from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.grounding.pipeline import PipelineResult
from kinebench_drake.segments import segments
from kinebench_drake.track import GripperTrack

FLIP_RAD = np.pi / 2
"""Rotation error beyond which the pose is flipped: the gripper looks alike after a half turn."""
LASTING_FRAMES = 3
"""Consecutive flipped frames, among the tracked ones, that make a lasting flip."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClipErrors:
    """Errors of the grounding of one clip, frame by frame."""

    id: str
    task: str
    """Plain task id; empty if unknown."""
    position_m: Annotated[Array, Stored(".7f")]
    """(T,) position error of panda_hand [m]; NaN where not tracked or absent."""
    rotation_rad: Micro
    """(T,) rotation error [rad]; NaN likewise."""
    width_m: Micro
    """(T,) estimated gap between the finger pads [m]; NaN where unknown."""
    true_width_m: Micro
    """(T,) true gap [m]; NaN where the gripper is absent."""
    tracked: Flags
    """(T,)."""
    confidence: Confidences
    """(T,) 0..1."""
    visible: Flags
    """(T,) frames in which the gripper is present."""
    share: Annotated[Array, Stored(".3f")]
    """(T,) share of the gripper's silhouette that the image shows, 0..1; NaN where not measured."""
    detected: tuple[Anomaly, ...]
    """Anomalies that the grounding reports."""
    planted: tuple[Anomaly, ...]
    """Anomalies of the ground truth."""
    cpu_s: Milli
    """Processor time of all threads [s]."""

    @property
    def finger_m(self) -> Array:
        """(T,) error of the gap between the finger pads [m]; NaN where the estimate or the truth is unknown."""
        return np.asarray(np.abs(self.width_m - self.true_width_m))

    @property
    def tracked_fraction(self) -> float:
        """Tracked frames / frames with a gripper; NaN without any."""
        return float(self.tracked[self.visible].mean()) if self.visible.any() else float("nan")

    @property
    def flips(self) -> list[int]:
        """Lengths of the runs of flipped frames; frames that are not tracked neither end nor lengthen a run."""
        flipped = self.rotation_rad[np.isfinite(self.rotation_rad)] > FLIP_RAD
        return [run.stop - run.start for run in segments(flipped)]

    @property
    def longest_flip(self) -> int:
        """Length of the longest run of flipped frames."""
        return max(self.flips, default=0)


def compare(clip: TruthClip, grounding: PipelineResult, cpu_s: float, share: Array | None = None) -> ClipErrors:
    """Return the errors of a grounding; `share` (T,) is the share of the gripper that each frame shows.

    Frames whose pose was an input are not an achievement of the grounding: they count as frames without a gripper.
    """
    errors = compare_track(clip, grounding.track, cpu_s, share)
    own = ~grounding.from_prior
    return replace(
        errors,
        position_m=np.where(own, errors.position_m, np.nan),
        rotation_rad=np.where(own, errors.rotation_rad, np.nan),
        tracked=errors.tracked & own,
        visible=errors.visible & own,
        share=np.where(own, errors.share, np.nan),
        detected=grounding.anomalies,
    )


def compare_track(clip: TruthClip, track: GripperTrack, cpu_s: float, share: Array | None = None) -> ClipErrors:
    """Return the errors of a track of any method; the other arguments are those of `compare`."""
    position, rotation = pose_difference(clip.X_CH, track.X_CH)
    return ClipErrors(
        id=clip.id,
        task=clip.task,
        position_m=position,
        rotation_rad=rotation,
        width_m=track.finger_width_m,
        true_width_m=clip.finger_width_m,
        tracked=track.tracked,
        confidence=track.confidence,
        visible=np.asarray(np.isfinite(clip.X_CH).all(axis=(1, 2))),
        share=np.full(len(clip.t_s), np.nan) if share is None else share,
        detected=(),
        planted=clip.faults,
        cpu_s=cpu_s,
    )
