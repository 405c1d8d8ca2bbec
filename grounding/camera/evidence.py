"""Evidence for a video's camera: how well the arm of the reported track agrees with it, and what agrees better.

What the evidence decides about a named camera stands in `check.py`.
"""

from dataclasses import dataclass

import numpy as np

from kinebench_drake.camera import Camera, CameraSource, CameraState
from kinebench_drake.errors import name_options
from kinebench_drake.grounding.camera.camera_estimate import CameraEstimate
from kinebench_drake.grounding.camera.picture_reading import BetterReading, PictureReading
from kinebench_drake.io.jsonl import Json
from kinebench_drake.named_cameras import NamedCamera


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraContradiction:
    """Camera that explains the arm clearly better than the assumed one."""

    agreement: float
    """Share of the contours of hand and arm on image edges with the assumed camera."""
    better: float
    """The same with the other one."""
    focal_ratio: float
    """Focal length of the assumed camera over that of the other one."""
    gripper_m: float
    """Distance between the TCPs that the two give in the base frame, median over the frames [m]."""
    gripper_rad: float
    """Angle between them [rad]."""

    def describe(self) -> str:
        """Describe both agreements, the focal length and the displacement."""
        return (
            f"the arm contradicts the camera of the input: {self.agreement:.0%} of its contours lie on image edges, "
            f"{self.better:.0%} with a focal length {1 / self.focal_ratio:.2f} times as long, which moves the gripper "
            f"by {1e3 * self.gripper_m:.0f} mm and {np.rad2deg(self.gripper_rad):.0f} degrees in the base frame"
        )

    def to_json(self) -> dict[str, Json]:
        """Serialize into `camera_contradiction` of samples.jsonl."""
        return {name: round(getattr(self, name), 4) for name in self.__slots__}


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraChoice:
    """Camera of a video, and the evidence for it."""

    camera: Camera
    """Camera before it is fitted to the shape of the video; without a base frame only its lens counts."""
    source: CameraSource
    agreement: float | None = None
    """Share of the contours of hand and arm on image edges in the postures of the track; None if none was fitted."""
    table_height_m: float | None = None
    """Height of the table top in the robot base frame that is stated with the camera [m]; None if none is."""
    named: NamedCamera | None = None
    """Camera by name, where the arm is to confirm it."""
    shown: PictureReading | None = None
    """How its picture is turned before it is measured; None: not at all."""
    estimate: CameraEstimate | None = None
    """Estimated camera; None if none was estimated."""
    contradiction: CameraContradiction | None = None
    """Camera that explains the arm better than the named one; None if none was found."""
    reading: BetterReading | None = None
    """PictureReading of picture or matrix that explains the arm better; None if none was found."""
    reason: str | None = None
    """Why there is no base frame; None if there is one."""

    @property
    def state(self) -> CameraState:
        """How the camera is known."""
        if self.reason is not None:
            return CameraState.NONE
        if self.source.is_named:
            return CameraState.NAMED
        return CameraState.ESTIMATED if self.source is CameraSource.ESTIMATED else CameraState.CONFIRMED

    def to_json(self) -> dict[str, Json]:
        """Serialize into keys of the row."""
        source = self.source if self.source.is_named or self.reason is None else CameraSource.NONE
        data: dict[str, Json] = {"camera_source": source.value, "camera_state": self.state.value}
        if self.named is not None:
            data["camera_name"] = self.named.name
        if self.shown is not None:
            data["camera_shown"] = self.shown.value
        if self.agreement is not None:
            data["camera_agreement"] = round(self.agreement, 4)
        for key, part in (
            ("camera_estimate", self.estimate),
            ("camera_contradiction", self.contradiction),
            ("camera_reading", self.reading),
        ):
            if part is not None:
                data[key] = part.to_json()
        if self.reason is not None:
            data["base_frame_reason"] = name_options(self.reason)
        return data
