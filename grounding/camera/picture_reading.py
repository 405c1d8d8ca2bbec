"""Readings of a picture and its camera: mirrored, upside down, sideways, cropped, or a matrix in another convention.

A camera with which the arm agrees poorly is often the right one, read wrongly. All readings are compared by the same
evidence: the share of the arm's contours on image edges.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.jsonl import Json


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
