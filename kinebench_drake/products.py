"""What the stages hand to each other: immutable, checked on construction."""

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array


def _check(name: str, value: NDArray[np.generic], shape: tuple[int, ...]) -> None:
    if value.shape != shape:
        raise InputError(f"{name} has shape {value.shape}, expected {shape}")


@dataclass(frozen=True, slots=True, kw_only=True)
class GripperTrack:
    """The gripper's path through a video, as seen."""

    t_s: Array
    """(T,) task time of each frame [s], increasing."""
    X_CH: Array
    """(T, 4, 4) pose of panda_hand in the camera frame [m]; NaN where not tracked."""
    X_BG: Array
    """(T, 4, 4) pose of panda_hand_tcp in the robot base frame [m]; NaN where not tracked."""
    tracked: NDArray[np.bool_]
    """(T,) whether the pose of the frame can be relied upon."""
    confidence: Array
    """(T,) probability 0..1 that the pose is within 10 mm and 5 degrees."""
    finger_width_m: Array
    """(T,) gap between the finger pads, 0..0.08 [m]; NaN where unknown."""
    offset_m: float = 0.0
    """How far tracked poses may be off, neighbours alike, beyond what they jitter [m]: the error of an estimate."""
    offset_rad: float = 0.0
    """The same of their rotation [rad]."""

    def __post_init__(self) -> None:
        """Check shapes against the number of frames."""
        n = len(self.t_s)
        for name in ("t_s", "tracked", "confidence", "finger_width_m"):
            _check(name, getattr(self, name), (n,))
        for name in ("X_CH", "X_BG"):
            _check(name, getattr(self, name), (n, 4, 4))

    def at(self, frames: NDArray[np.intp]) -> "GripperTrack":
        """The track at some of its frames."""
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


@dataclass(frozen=True, slots=True, kw_only=True)
class JointTrack:
    """Joint angles that put the gripper on its track."""

    t_s: Array
    """(T,) task time [s]."""
    q: Array
    """(T, 7) joint angles [rad]; the best found within limits where the status is not ok; NaN where not tracked."""
    status: tuple[IkStatus, ...]
    """(T,) outcome of each frame."""
    position_error_m: Array
    """(T,) distance left between the wanted and the reached TCP [m]; NaN where not tracked."""
    rotation_error_rad: Array
    """(T,) angle left between the wanted and the reached TCP [rad]; NaN where not tracked."""

    def __post_init__(self) -> None:
        """Check shapes against the number of frames."""
        n = len(self.t_s)
        _check("q", self.q, (n, 7))
        for name in ("position_error_m", "rotation_error_rad"):
            _check(name, getattr(self, name), (n,))
        if len(self.status) != n:
            raise InputError(f"status has {len(self.status)} entries, expected {n}")

    @property
    def ok(self) -> NDArray[np.bool_]:
        """(T,) frames whose pose is reached within limits and without collision."""
        return np.array([s is IkStatus.OK for s in self.status], dtype=bool)


class AnomalyKind(Enum):
    """What a video can do that a real gripper cannot."""

    VANISH = "vanish"
    DUPLICATE = "duplicate_gripper"
    TELEPORT = "teleport"
    FREEZE = "freeze"
    DEFORMATION = "deformation"
    SCALE = "scale_drift"
    CAMERA = "camera_motion"
    FINGERS = "finger_opening"


@dataclass(frozen=True, slots=True, kw_only=True)
class Anomaly:
    """One anomaly over a range of frames."""

    kind: AnomalyKind
    frame_start: int
    """First affected frame (0-based)."""
    frame_end: int
    """Last affected frame, inclusive."""
    severity: float
    """The kind's own measure: frames without a gripper (vanish) or frozen (freeze), share of a gripper seen twice
    (duplicate_gripper), metres jumped (teleport) or beyond what fingers can do (finger_opening), relative misfit of the
    shape (deformation) or of the size (scale_drift), pixels moved (camera_motion)."""
