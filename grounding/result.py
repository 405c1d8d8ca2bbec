"""Result of the grounding of a video: its track with the evidence for it, and the camera behind it."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.anomaly import Anomaly
from kinebench_drake.camera import Camera
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.anomaly.detection import AnomalyDetections
from kinebench_drake.grounding.camera.framing import Framing
from kinebench_drake.grounding.priors import InitialStateUse
from kinebench_drake.grounding.tracking.camera_path import CameraPath
from kinebench_drake.grounding.tracking.view import Frames
from kinebench_drake.models.panda.robot import GripperKind
from kinebench_drake.models.robot import N_JOINTS
from kinebench_drake.track import Domain, GripperTrack

if TYPE_CHECKING:
    from kinebench_drake.grounding.camera.choice import CameraChoice

MIN_TRACKED = 2
"""Fewest frames with a pose: a path needs two."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PipelineResult:
    """Result of `GroundingPipeline.ground`."""

    track: GripperTrack
    domain: Domain
    gripper: GripperKind = GripperKind.FRANKA
    """Gripper that was looked for."""
    from_prior: NDArray[np.bool_]
    """(T,) frames whose pose was taken from priors."""
    first_frame: InitialStateUse
    """Whether the initial state was used."""
    detections: AnomalyDetections
    """Scores and anomalies by kind."""
    camera_path: CameraPath | None = None
    """Camera of each frame, if it moves and was followed."""
    camera_motion_px: float | None
    """Largest displacement of the background [px]; None if it has too few features."""
    arm_consistency_px: float | None
    """Median over tracked frames of the distance between the links as estimated and as posed by the fitted arm [px of
    the video]; None if too little of the arm is visible."""
    robot: NDArray[np.bool_]
    """(T, H, W) pixels that show the robot."""
    arm_q: Array = field(default_factory=lambda: np.zeros((0, N_JOINTS)))
    """(T, 7) fitted joint angles with the assumed camera [rad]; NaN where hand and arm do not agree; empty without a
    fit."""
    X_CH_raw: Array = field(default_factory=lambda: np.zeros((0, 4, 4)))
    """(T, 4, 4) poses of panda_hand before confidence and smoothing, in the camera of each frame [m]; NaN where no
    gripper is seen."""
    curves: Mapping[str, Array] = field(default_factory=dict)
    """Curves (T,) of the track file: share of matched points, their distance [m] and weight of ICP; NaN without it."""

    @property
    def has_pose(self) -> NDArray[np.bool_]:
        """(T,) frames in which a gripper is seen, trusted or not."""
        return np.asarray(np.isfinite(self.X_CH_raw).all(axis=(1, 2)))

    @property
    def anomalies(self) -> tuple[Anomaly, ...]:
        """Anomalies in the order of their frames."""
        return self.detections.anomalies


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundingResult(PipelineResult):
    """Track of a video with the camera behind it; poses in the base frame are NaN where that is unknown."""

    frames: Frames
    """(T, h, w, 3) as grounded: without letter-box bars."""
    camera: Camera
    """Camera of these frames."""
    framing: Framing
    """How the camera's image lies in the video."""
    choice: "CameraChoice"

    @property
    def unmeasurable(self) -> str | None:
        """Why the track cannot be measured although a gripper is seen; None if it can."""
        track, tracked = self.track, int(self.track.tracked.sum())
        if tracked >= MIN_TRACKED:
            return None
        subject = "the flange" if self.domain is Domain.ARM else "a gripper"
        return (
            f"{subject} is seen in {int(self.has_pose.sum())} of {len(track.t_s)} frames, but trusted in {tracked}, a "
            f"path needs {MIN_TRACKED}: its confidence is {track.confidence.max():.2f} at most{self._doubt}"
        )

    @property
    def _doubt(self) -> str:
        return "" if self.choice.reason is None else f"; {self.choice.reason}"

    @property
    def visible_track(self) -> GripperTrack:
        """The track; of an unmeasurable video with the poses that are seen, but not trusted."""
        track = self.track
        if self.unmeasurable is None:
            return track
        return replace(track, X_CH=np.where(track.tracked[:, None, None], track.X_CH, self.X_CH_raw))

    def require_pose(self) -> None:
        """Check that a gripper is seen.

        Raises:
            UnmeasurableError: it is found in no frame.
        """
        if self.has_pose.any():
            return
        frames = len(self.track.t_s)
        if self.domain is Domain.ARM:
            raise UnmeasurableError(
                f"the flange is found in none of {frames} frames: are wrist and forearm in view, and is this the "
                f"video's camera?{self._doubt}"
            )
        raise UnmeasurableError(
            f"no Franka hand is found in any of {frames} frames: is the robot in view, and is this the video's camera? "
            f"With another gripper take $gripper none{self._doubt}"
        )
