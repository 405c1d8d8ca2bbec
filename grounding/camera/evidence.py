"""Evidence for a video's camera: how well the arm of the reported track agrees with it, and what agrees better.

A camera with which the arm agrees poorly is often the right one, read wrongly: the picture may be mirrored, upside
down, sideways or cropped, the matrix in another convention. All readings are compared by the same evidence: the share
of the arm's contours on image edges. What the evidence decides about a named camera stands in `check.py`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera, CameraSource, CameraState
from kinebench_drake.errors import name_options
from kinebench_drake.geometry import Array, invert
from kinebench_drake.grounding.camera.camera_estimate import CameraEstimate
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.jsonl import Json
from kinebench_drake.named_cameras import NamedCamera

BASE_UNKNOWN = "the base frame is unknown (where the robot stands in the picture)"
"""Beginning of the reasons for which a track has no verdict."""


class PictureReading(Enum):
    """How a picture or a camera matrix may have to be read."""

    MIRRORED = "mirrored"
    UPSIDE_DOWN = "upside_down"
    ROWS_REVERSED = "rows_reversed"
    TURNED_LEFT = "turned_left"
    TURNED_RIGHT = "turned_right"
    OPENGL_AXES = "opengl_axes"
    INVERTED = "inverted"
    CROPPED = "cropped"

    def frames(self, frames: Frames) -> Frames:
        """Return the frames (T, H, W, 3) as read; the very same where the picture is not turned."""
        return np.ascontiguousarray(_TURNS[self](np.asarray(frames))) if self in _TURNS else frames

    def camera(self, camera: Camera) -> Camera:
        """Return the camera as read; that of a cropped picture is found by a search."""
        return replace(camera, X_BC=_MATRICES[self](camera.X_BC)) if self in _MATRICES else camera


_TURNS: dict[PictureReading, Callable[[NDArray[np.uint8]], NDArray[np.uint8]]] = {
    PictureReading.MIRRORED: lambda frames: frames[:, :, ::-1],
    PictureReading.UPSIDE_DOWN: lambda frames: frames[:, ::-1, ::-1],
    PictureReading.ROWS_REVERSED: lambda frames: frames[:, ::-1],
    PictureReading.TURNED_LEFT: lambda frames: np.rot90(frames, 1, (1, 2)),
    PictureReading.TURNED_RIGHT: lambda frames: np.rot90(frames, -1, (1, 2)),
}
_MATRICES: dict[PictureReading, Callable[[Array], Array]] = {
    PictureReading.OPENGL_AXES: lambda X_BC: X_BC @ np.diag([1.0, -1.0, -1.0, 1.0]),
    PictureReading.INVERTED: invert,
}
_SUBJECTS = {
    PictureReading.MIRRORED: "the picture mirrored left-right",
    PictureReading.UPSIDE_DOWN: "the picture turned upside down",
    PictureReading.ROWS_REVERSED: "the picture with its rows reversed",
    PictureReading.TURNED_LEFT: "the picture turned by 90 degrees to the left",
    PictureReading.TURNED_RIGHT: "the picture turned by 90 degrees to the right",
    PictureReading.OPENGL_AXES: "base_from_camera read in OpenGL axes (y up, z backwards)",
    PictureReading.INVERTED: "the inverse of base_from_camera (camera_from_base)",
    PictureReading.CROPPED: "a cropped picture",
}
_REMEDIES = {
    **dict.fromkeys(PictureReading, "turn the frames before they are scored"),
    PictureReading.MIRRORED: 'if it is mirrored, set "mirrored": true in camera.json, or take $mirrored=True',
    PictureReading.OPENGL_AXES: "negate its second and third column",
    PictureReading.INVERTED: "invert it",
    PictureReading.CROPPED: "state the cropped picture's own fx, fy, cx and cy in a camera.json",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class BetterReading:
    """PictureReading with which the arm agrees clearly better than with the picture and the camera as they are."""

    reading: PictureReading
    agreement: float
    """Share of the contours of hand and arm on image edges as they are."""
    better: float
    """The same as read."""
    camera: Camera
    """Camera as read, of the frames as read."""

    def describe(self) -> str:
        """Describe the reading, both agreements and the remedy."""
        return (
            f"{_SUBJECTS[self.reading]} agrees better with the arm ({self.better:.0%} of its contours on image edges "
            f"against {self.agreement:.0%}): {_REMEDIES[self.reading]}"
        )

    def to_json(self) -> dict[str, Json]:
        """Serialize into `camera_reading` of samples.jsonl."""
        return {
            "reading": self.reading.value,
            "agreement": round(self.agreement, 4),
            "better": round(self.better, 4),
        }


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
    applied_reading: PictureReading | None = None
    """How the picture of a recognized camera is turned before it is measured; None: not at all."""
    estimate: CameraEstimate | None = None
    """Estimated camera; None if none was estimated."""
    contradiction: CameraContradiction | None = None
    """Camera that explains the arm better than the named one; None if none was found."""
    better_reading: BetterReading | None = None
    """Reading of picture or matrix that explains the arm better than what was measured; None if none was found."""
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
        optional: dict[str, Json] = {
            "camera_name": None if self.named is None else self.named.name,
            "camera_shown": self.applied_reading and self.applied_reading.value,
            "camera_agreement": None if self.agreement is None else round(self.agreement, 4),
            "camera_estimate": None if self.estimate is None else self.estimate.to_json(),
            "camera_contradiction": None if self.contradiction is None else self.contradiction.to_json(),
            "camera_reading": None if self.better_reading is None else self.better_reading.to_json(),
            "base_frame_reason": None if self.reason is None else name_options(self.reason),
        }
        stated = {key: value for key, value in optional.items() if value is not None}
        return {"camera_source": source.value, "camera_state": self.state.value, **stated}
