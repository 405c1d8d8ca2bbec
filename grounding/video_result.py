"""Result of the grounding of a video: its track, and the camera behind it."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.anomaly import Anomaly
from kinebench_drake.camera import Camera
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.camera.evidence import CameraChoice
from kinebench_drake.grounding.camera.framing import Framing
from kinebench_drake.grounding.panels.panel import PanelChoice
from kinebench_drake.grounding.pipeline import PipelineResult
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.panda.description import RobotPart
from kinebench_drake.track import Domain, GripperTrack


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundingResult:
    """Track of a video with the camera behind it."""

    measured: PipelineResult
    """Measurements with this camera; their poses in the base frame count only where that is known."""
    frames: Frames
    """(T, h, w, 3) as grounded: without letter-box bars."""
    camera: Camera
    """Camera of these frames."""
    framing: Framing
    """How the camera's image lies in the video."""
    choice: CameraChoice
    table_height_m: float
    """Height of the table top in the robot base frame [m]: that stated with the camera, else that of the options."""
    possible: tuple[GripperTrack, ...] = ()
    """Tracks with each camera that may be right, where it cannot be seen which one is; else none."""
    panels: PanelChoice | None = None
    """Panels of the frames of the video, and the one that was grounded; None for a single view."""

    @property
    def track(self) -> GripperTrack:
        """The track; poses in the base frame are NaN where that is unknown."""
        track = self.measured.track
        return track if self.choice.reason is None else replace(track, X_BG=np.full_like(track.X_BG, np.nan))

    @property
    def anomalies(self) -> tuple[Anomaly, ...]:
        """Anomalies in the order of their frames."""
        return self.measured.detections.anomalies

    @property
    def camera_motion_px(self) -> float | None:
        """Largest displacement of the background [px]; None if it has too few features."""
        return self.measured.camera_motion_px

    @property
    def robot(self) -> NDArray[np.bool_]:
        """(T, h, w) pixels that show the robot."""
        camera = self.camera.resized(self.frames.shape[2], self.frames.shape[1])
        return np.stack([view.to_frame(view.part > RobotPart.BACKGROUND, camera) for view in self.measured.wide])

    @property
    def unmeasurable(self) -> str | None:
        """Why the track cannot be measured although a gripper is seen; None if it can."""
        track = self.measured.track
        tracked = int(track.tracked.sum())
        detected = int(self.measured.has_pose.sum())
        if tracked >= bounds.MIN_TRACKED:
            return None
        subject = "the flange" if self.measured.domain is Domain.ARM else "a gripper"
        return (
            f"{subject} is seen in {detected} of {len(track.t_s)} frames, but trusted in {tracked}, a "
            f"path needs {bounds.MIN_TRACKED}: its confidence is {track.confidence.max():.2f} at most{self._doubt}"
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
        return replace(track, X_CH=np.where(track.tracked[:, None, None], track.X_CH, self.measured.X_CH_raw))

    def require_pose(self) -> None:
        """Check that a gripper is seen.

        Raises:
            UnmeasurableError: it is found in no frame.
        """
        if self.measured.has_pose.any():
            return
        frames = len(self.frames)
        if self.measured.domain is Domain.ARM:
            raise UnmeasurableError(
                f"the flange is found in none of {frames} frames: are wrist and forearm in view, and is this the "
                f"video's camera?{self._doubt}"
            )
        raise UnmeasurableError(
            f"no Franka hand is found in any of {frames} frames: is the robot in view, and is this the video's camera? "
            f"With another gripper take $gripper none{self._doubt}"
        )
