"""Readings of a picture and its camera: mirrored, upside down, sideways, cropped, or a matrix in another convention.

A camera with which the arm agrees poorly is often the right one, read wrongly. All readings are compared by the same
evidence: the share of the arm's contours on image edges.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert
from kinebench_drake.grounding.tracking.view import Frames
from kinebench_drake.io.jsonl import Json

_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
_TURN = "turn the frames before they are scored"
_Turn = Callable[[Frames], Frames]
_Matrix = Callable[[Array], Array]


class Reading(Enum):
    """How a picture or a camera matrix may have to be read."""

    MIRRORED = (
        "mirrored",
        "the picture mirrored left-right",
        'if it is mirrored, set "mirrored": true in camera.json, or take $mirrored=True',
        lambda frames: frames[:, :, ::-1],
    )
    UPSIDE_DOWN = ("upside_down", "the picture turned upside down", _TURN, lambda frames: frames[:, ::-1, ::-1])
    ROWS_REVERSED = ("rows_reversed", "the picture with its rows reversed", _TURN, lambda frames: frames[:, ::-1])
    TURNED_LEFT = (
        "turned_left",
        "the picture turned by 90 degrees to the left",
        _TURN,
        lambda frames: np.rot90(frames, 1, (1, 2)),
    )
    TURNED_RIGHT = (
        "turned_right",
        "the picture turned by 90 degrees to the right",
        _TURN,
        lambda frames: np.rot90(frames, -1, (1, 2)),
    )
    OPENGL_AXES = (
        "opengl_axes",
        "base_from_camera read in OpenGL axes (y up, z backwards)",
        "negate its second and third column",
        None,
        lambda X_BC: X_BC @ _OPENGL_FROM_OPENCV,
    )
    INVERTED = ("inverted", "the inverse of base_from_camera (camera_from_base)", "invert it", None, invert)
    CROPPED = (
        "cropped",
        "a cropped picture",
        "state the cropped picture's own fx, fy, cx and cy in a camera.json",
    )

    _value_: str
    phrase: str
    """Subject of a sentence."""
    remedy: str
    """How to have the video read so."""
    _turn: _Turn | None
    _matrix: _Matrix | None

    def __new__(
        cls, value: str, phrase: str, remedy: str, turn: _Turn | None = None, matrix: _Matrix | None = None
    ) -> "Reading":
        """Return the member of a row of the table."""
        member = object.__new__(cls)
        member._value_, member.phrase, member.remedy, member._turn, member._matrix = value, phrase, remedy, turn, matrix
        return member

    def frames(self, frames: Frames) -> Frames:
        """Return the frames (T, H, W, 3) as read; the very same where the picture is not turned."""
        return frames if self._turn is None else np.ascontiguousarray(self._turn(frames))

    def camera(self, camera: Camera) -> Camera:
        """Return the camera as read; that of a cropped picture is found by a search."""
        return camera if self._matrix is None else replace(camera, X_BC=self._matrix(camera.X_BC))


@dataclass(frozen=True, slots=True, kw_only=True)
class BetterReading:
    """Reading with which the arm agrees clearly better than with the picture and the camera as they are."""

    reading: Reading
    agreement: float
    """Share of the contours of hand and arm on image edges as they are."""
    better: float
    """The same as read."""
    camera: Camera
    """Camera as read, of the frames as read."""

    def describe(self) -> str:
        """Describe the reading, both agreements and the remedy."""
        return (
            f"{self.reading.phrase} agrees better with the arm ({self.better:.0%} of its contours on image edges "
            f"against {self.agreement:.0%}): {self.reading.remedy}"
        )

    def to_json(self) -> dict[str, Json]:
        """Serialize into `camera_reading` of samples.jsonl."""
        return {
            "reading": self.reading.value,
            "agreement": round(self.agreement, 4),
            "better": round(self.better, 4),
        }
