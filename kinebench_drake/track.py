"""Track of a gripper over the frames of a video, the joint angles that follow it, and the state that it starts from."""

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array

MAX_WIDTH_M = 0.08
"""Greatest gap between the finger pads [m]."""


def _check(name: str, value: NDArray[np.generic], shape: tuple[int, ...]) -> None:
    if value.shape != shape:
        raise InputError(f"{name} has shape {value.shape}, expected {shape}")


@dataclass(frozen=True, slots=True, kw_only=True)
class GripperTrack:
    """Poses of the gripper over the frames of a video."""

    t_s: Array
    """(T,) task time of each frame [s], increasing."""
    X_CH: Array
    """(T, 4, 4) pose of panda_hand in the camera frame [m]; NaN where not tracked."""
    X_BG: Array
    """(T, 4, 4) pose of panda_hand_tcp in the robot base frame [m]; NaN where not tracked."""
    tracked: NDArray[np.bool_]
    """(T,) frames whose pose is reliable."""
    confidence: Array
    """(T,) probability 0..1 that the pose is within 10 mm and 5 degrees of the truth."""
    finger_width_m: Array
    """(T,) gap between the finger pads, 0..0.08 [m]; NaN where unknown."""
    offset_m: float = 0.0
    """Position error that neighbouring tracked poses may share, beyond their noise: that of an estimate [m]."""
    offset_rad: float = 0.0
    """Rotation error that they may share [rad]."""
    turn_is_sure: bool = True
    """Whether the rotation about the gripper's own axis (z of panda_hand_tcp) is measured as well as the rest."""

    def __post_init__(self) -> None:
        """Check shapes against the number of frames."""
        n = len(self.t_s)
        for name in ("t_s", "tracked", "confidence", "finger_width_m"):
            _check(name, getattr(self, name), (n,))
        for name in ("X_CH", "X_BG"):
            _check(name, getattr(self, name), (n, 4, 4))

    @classmethod
    def untracked(cls, t_s: Array) -> "GripperTrack":
        """Return the track of frames at times (T,) [s] in which no pose is measured."""
        n = len(t_s)
        X = np.full((n, 4, 4), np.nan)
        nothing = np.zeros(n)
        return cls(t_s=t_s, X_CH=X, X_BG=X, tracked=nothing > 0, confidence=nothing, finger_width_m=X[:, 0, 0])

    def at(self, frames: NDArray[np.intp]) -> "GripperTrack":
        """Return the track at a selection of its frames."""
        arrays = ("t_s", "X_CH", "X_BG", "tracked", "confidence", "finger_width_m")
        return replace(self, **{name: getattr(self, name)[frames] for name in arrays})


class IkStatus(Enum):
    """Outcome of inverse kinematics for one frame."""

    OK = "ok"
    NOT_TRACKED = "not_tracked"
    UNREACHABLE = "unreachable"
    JOINT_LIMIT = "joint_limit"
    SELF_COLLISION = "self_collision"
    TABLE_COLLISION = "table_collision"
    OBSTACLE_COLLISION = "obstacle_collision"


@dataclass(frozen=True, slots=True, kw_only=True)
class JointTrack:
    """Joint angles that follow a track of the gripper."""

    t_s: Array
    """(T,) task time [s]."""
    q: Array
    """(T, J) joint angles [rad]; the best within limits where the status is not ok; NaN where not tracked."""
    status: tuple[IkStatus, ...]
    """(T,) outcome of each frame."""
    position_error_m: Array
    """(T,) distance between the tracked and the reached TCP [m]; NaN where not tracked."""
    rotation_error_rad: Array
    """(T,) angle between the tracked and the reached TCP [rad]; NaN where not tracked."""

    def __post_init__(self) -> None:
        """Check shapes against the number of frames."""
        n = len(self.t_s)
        _check("q", self.q, (n, *self.q.shape[1:2]))
        for name in ("position_error_m", "rotation_error_rad"):
            _check(name, getattr(self, name), (n,))
        if len(self.status) != n:
            raise InputError(f"status has {len(self.status)} entries, expected {n}")

    @property
    def ok(self) -> NDArray[np.bool_]:
        """(T,) frames whose pose is reached within limits and without collision."""
        return np.array([s is IkStatus.OK for s in self.status], dtype=bool)


@dataclass(frozen=True, slots=True, kw_only=True)
class InitialState:
    """State of the robot in the conditioning image of a generated video: exact, unlike an estimate."""

    X_BG: Array
    """(4, 4) pose of panda_hand_tcp in the robot base frame [m]."""
    finger_width_m: float = float("nan")
    """Gap between the finger pads [m]; NaN where unknown."""


class Domain(Enum):
    """Whether a video looks like those that the networks can measure without help."""

    FAMILIAR = "familiar"
    """The edges of its images confirm the poses of the networks."""
    UNFAMILIAR = "unfamiliar"
    """They do not: poses are fitted to the edges, and what these do not confirm is doubtful."""
    ARM = "arm_alone"
    """The links give the flange, alone or with another gripper than Franka's."""
