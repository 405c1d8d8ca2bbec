"""What is known of a video beforehand: its first frame, or stages done elsewhere."""

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, invert
from kinebench_drake.models.panda.robot import hand_from_tcp


@dataclass(frozen=True, slots=True, kw_only=True)
class FirstFrame:
    """The robot in the frame that a world model was given: exact, where estimates are not."""

    X_BG: Array
    """(4, 4) pose of panda_hand_tcp in the robot base frame [m]."""
    finger_width_m: float = float("nan")
    """Gap between the finger pads [m]; NaN where unknown."""

    def X_CH(self, camera: Camera) -> Array:
        """(4, 4) pose of panda_hand in the frame of `camera` [m]."""
        return np.asarray(invert(camera.X_BC) @ self.X_BG @ invert(hand_from_tcp()))


class FirstFrameUse(Enum):
    """What became of the pose that the first frame is said to have."""

    UNKNOWN = "unknown"
    USED = "used"
    CONTRADICTED = "contradicted"

    @classmethod
    def of(cls, said: FirstFrame | None, used: FirstFrame | None) -> "FirstFrameUse":
        """What was `said` and what of that is `used`."""
        if said is None:
            return cls.UNKNOWN
        return cls.CONTRADICTED if used is None else cls.USED


@dataclass(frozen=True, slots=True, kw_only=True)
class GivenDepth:
    """Metric depth from a sensor, a simulator or another estimator."""

    depth_m: Array
    """(T, H, W) along the camera's axis [m]; 0 or not finite where unknown."""
    exact: bool = False
    """Whether it can be trusted to a few millimetres; an estimate's common factor is fitted along."""
    calibrated: bool = False
    """Whether that factor has been set right in a frame where the gripper's place is known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """What takes the place of estimates; None where nothing is known."""

    first: FirstFrame | None = None
    """The robot in the first frame."""
    mask: NDArray[np.bool_] | None = None
    """(T, H, W) pixels that show the gripper: hand and fingers."""
    depth: GivenDepth | None = None
    """Depth of every frame."""
    X_CH: Array | None = None
    """(T, 4, 4) poses of panda_hand in the camera frame [m], taken as they are; NaN where there is none."""
    finger_width_m: Array | None = None
    """(T,) gap between the finger pads [m]; NaN where unknown."""

    @property
    def replaces(self) -> bool:
        """Whether it takes the place of a whole stage, in the frames as they are."""
        posed = self.X_CH is not None and bool(np.isfinite(self.X_CH[1:]).any())
        return self.mask is not None or self.depth is not None or posed

    @property
    def exact(self) -> bool:
        """Whether depth is given that can be trusted to a few millimetres."""
        return self.depth is not None and self.depth.exact

    def cut(self, rows: slice, columns: slice) -> "Known":
        """The same of frames of which only these rows and columns are kept."""
        depth = self.depth and replace(self.depth, depth_m=self.depth.depth_m[:, rows, columns])
        return replace(self, mask=None if self.mask is None else self.mask[:, rows, columns], depth=depth)

    def through(self, camera: Camera, frames: int) -> "Known":
        """The same with the first frame's pose and opening among those of all `frames`, as `camera` sees them."""
        if self.first is None:
            return self
        X_CH = np.full((frames, 4, 4), np.nan) if self.X_CH is None else self.X_CH.copy()
        width = np.full(frames, np.nan) if self.finger_width_m is None else self.finger_width_m.copy()
        X_CH[0] = self.first.X_CH(camera)
        if np.isfinite(self.first.finger_width_m):
            width[0] = self.first.finger_width_m
        return replace(self, X_CH=X_CH, finger_width_m=width)

    def pose(self, number: int) -> Array | None:
        """(4, 4) pose of panda_hand in the camera frame in frame `number` [m], if it is given."""
        given = None if self.X_CH is None else self.X_CH[number]
        return given if given is not None and np.isfinite(given).all() else None

    def finger_m(self, number: int) -> float | None:
        """Opening of each finger in frame `number` [m], if it is known."""
        width = np.nan if self.finger_width_m is None else self.finger_width_m[number]
        return float(width) / 2 if np.isfinite(width) else None

    def require(self, frames: int, height: int, width: int) -> None:
        """Hold the shapes against those of the video.

        Raises:
            InputError: one of them is another.
        """
        picture = (frames, height, width)
        depth = None if self.depth is None else self.depth.depth_m
        _hold("mask", self.mask, picture)
        _hold("depth", depth, picture)
        _hold("poses", self.X_CH, (frames, 4, 4))
        _hold("finger_width_m", self.finger_width_m, (frames,))


def _hold(name: str, given: NDArray[np.generic] | None, shape: tuple[int, ...]) -> None:
    if given is not None and given.shape != shape:
        raise InputError(f"{name} given for the video: shape {given.shape}, expected {shape}")


NOTHING = Known()
"""Pixels only."""
