"""Input of the grounding: frames, and priors, quantities that replace their estimates."""

from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array
from kinebench_drake.io.frames import Frames
from kinebench_drake.track import InitialState


@dataclass(frozen=True, slots=True, kw_only=True)
class Clip:
    """Frames to ground."""

    frames: Frames
    """(T, H, W, 3) RGB, as decoded."""
    t_s: Array
    """(T,) task time of each frame [s]."""
    conditioning: NDArray[np.uint8] | None = None
    """(h, w, 3) image from which the video was generated, which shows how its frames lie in the camera's image."""
    is_view: bool = False
    """True if the camera takes that image, from which the view of the first frame may differ."""

    def flipped(self, *, rows: bool = False, columns: bool = False) -> Self:
        """Return the clip with its rows or columns reversed; columns reversed is mirrored."""
        order = slice(None, None, -1 if rows else 1), slice(None, None, -1 if columns else 1)
        image = None if self.conditioning is None else np.ascontiguousarray(self.conditioning[order])
        return replace(self, frames=self.frames[:, *order], conditioning=image)


class InitialStateUse(Enum):
    """Whether the initial state of a sample was used."""

    UNKNOWN = "unknown"
    USED = "used"
    CONTRADICTED = "contradicted"

    @classmethod
    def of(cls, provided: InitialState | None, used: InitialState | None) -> "InitialStateUse":
        """Compare the state that was provided with the one that was used."""
        return cls.UNKNOWN if provided is None else cls.CONTRADICTED if used is None else cls.USED


@dataclass(frozen=True, slots=True, kw_only=True)
class ExternalDepth:
    """Metric depth from a sensor, a simulator or another estimator."""

    depth_m: Array
    """(T, H, W) depth along the optical axis [m]; 0 or not finite where unknown."""
    exact: bool = False
    """True if the depth is accurate to a few millimetres; the scale of an estimate is fitted."""
    calibrated: bool = False
    """True once the scale was corrected in a frame whose gripper pose is known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Priors:
    """Quantities of a video that replace their estimates; None where there is none."""

    initial_state: InitialState | None = None
    """State of the robot in the first frame."""
    image: NDArray[np.uint8] | None = None
    """(H, W, 3) RGB image of the video's camera before the first frame, from which its view may differ."""
    mask: NDArray[np.bool_] | None = None
    """(T, H, W) pixels of hand and fingers."""
    depth: ExternalDepth | None = None
    """Depth of every frame."""
    X_CH: Array | None = None
    """(T, 4, 4) poses of panda_hand in the camera frame [m], used unchanged; NaN where there is none."""
    finger_width_m: Array | None = None
    """(T,) gap between the finger pads [m]; NaN where unknown."""
    camera_is_fitted: bool = False
    """True if the camera was fitted to the edges of the video itself, which then say little about the networks."""
    camera_is_assumed: bool = False
    """True if the camera is an assumption: where the edges contradict it, poses are not refined."""

    table_height_m: float | None = None
    """Height of the table top in the robot base frame [m]."""

    @property
    def replaces_stage(self) -> bool:
        """True if a whole stage of the grounding is replaced, in the frames as they are."""
        has_poses = self.X_CH is not None and bool(np.isfinite(self.X_CH[1:]).any())
        return self.mask is not None or self.depth is not None or has_poses

    @property
    def has_exact_depth(self) -> bool:
        """True if there is depth accurate to a few millimetres."""
        return self.depth is not None and self.depth.exact

    def crop(self, rows: slice, columns: slice) -> "Priors":
        """Return the priors of frames reduced to these rows and columns."""
        depth = self.depth and replace(self.depth, depth_m=self.depth.depth_m[:, rows, columns])
        image = None if self.image is None else self.image[rows, columns]
        return replace(self, image=image, mask=None if self.mask is None else self.mask[:, rows, columns], depth=depth)

    def at(self, frames: NDArray[np.intp]) -> "Priors":
        """Return the priors at a selection of the frames."""
        arrays = {name: getattr(self, name) for name in ("mask", "X_CH", "finger_width_m")}
        chosen: dict[str, Any] = {name: None if array is None else array[frames] for name, array in arrays.items()}
        return replace(self, **chosen, depth=self.depth and replace(self.depth, depth_m=self.depth.depth_m[frames]))

    def with_first_pose(self, X_CH: Array, frames: int) -> "Priors":
        """Return the priors with pose (4, 4) [m] and gripper width of the initial state as those of frame 0."""
        poses = np.full((frames, 4, 4), np.nan) if self.X_CH is None else self.X_CH.copy()
        width = np.full(frames, np.nan) if self.finger_width_m is None else self.finger_width_m.copy()
        poses[0] = X_CH
        if self.initial_state is not None and np.isfinite(self.initial_state.finger_width_m):
            width[0] = self.initial_state.finger_width_m
        return replace(self, X_CH=poses, finger_width_m=width)

    def pose(self, frame: int) -> Array | None:
        """Return the pose X_CH (4, 4) of a frame [m], or None."""
        pose = None if self.X_CH is None else self.X_CH[frame]
        return pose if pose is not None and np.isfinite(pose).all() else None

    def finger_m(self, frame: int) -> float | None:
        """Return the travel of each finger in a frame [m], or None."""
        width = np.nan if self.finger_width_m is None else self.finger_width_m[frame]
        return float(width) / 2 if np.isfinite(width) else None

    def check_shapes(self, frames: int, height: int, width: int) -> None:
        """Check the shapes against those of the video.

        Raises:
            InputError: a shape differs.
        """
        image = (frames, height, width)
        arrays = {
            "mask": (self.mask, image),
            "depth": (None if self.depth is None else self.depth.depth_m, image),
            "poses": (self.X_CH, (frames, 4, 4)),
            "finger_width_m": (self.finger_width_m, (frames,)),
        }
        for name, (array, shape) in arrays.items():
            if array is not None and array.shape != shape:
                raise InputError(f"{name} given for the video: shape {array.shape}, expected {shape}")


NO_PRIORS = Priors()
"""Pixels only."""
