"""Products that stages hand to each other, and priors that replace estimates: immutable, checked on construction."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array

Json: TypeAlias = bool | int | float | str | Sequence["Json"] | Mapping[str, "Json"] | None
"""A JSON value."""


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

    def __post_init__(self) -> None:
        """Check shapes against the number of frames."""
        n = len(self.t_s)
        for name in ("t_s", "tracked", "confidence", "finger_width_m"):
            _check(name, getattr(self, name), (n,))
        for name in ("X_CH", "X_BG"):
            _check(name, getattr(self, name), (n, 4, 4))

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


@dataclass(frozen=True, slots=True, kw_only=True)
class JointTrack:
    """Joint angles that follow a track of the gripper."""

    t_s: Array
    """(T,) task time [s]."""
    q: Array
    """(T, 7) joint angles [rad]; the best within limits where the status is not ok; NaN where not tracked."""
    status: tuple[IkStatus, ...]
    """(T,) outcome of each frame."""
    position_error_m: Array
    """(T,) distance between the tracked and the reached TCP [m]; NaN where not tracked."""
    rotation_error_rad: Array
    """(T,) angle between the tracked and the reached TCP [rad]; NaN where not tracked."""

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


class ViolationKind(Enum):
    """Limit of the robot that a motion breaks."""

    UNREACHABLE = "unreachable"
    JOINT_LIMIT = "joint_limit"
    SELF_COLLISION = "self_collision"
    TABLE_COLLISION = "table_collision"
    VELOCITY = "velocity"
    ACCELERATION = "acceleration"
    JERK = "jerk"
    TORQUE = "torque"
    DISCONTINUITY = "discontinuity"


@dataclass(frozen=True, slots=True, kw_only=True)
class Violation:
    """One limit broken over a range of frames."""

    kind: ViolationKind
    frame_start: int
    """First affected frame (0-based)."""
    frame_end: int
    """Last affected frame, inclusive."""
    joint: str | None
    """Name of the joint, such as panda_joint4; None if it concerns no single joint."""
    value: float
    """Worst value in the unit of the kind: position error [m] (unreachable), angle [rad] (joint_limit), ..."""
    limit: float
    """Greatest allowed value, or the least for a lower joint limit or a distance; in the unit of the value."""

    @classmethod
    def of_run(cls, kind: ViolationKind, run: slice, joint: str | None, value: float, limit: float) -> "Violation":
        """Return the violation over a run of frames (`segments.segments`)."""
        return cls(kind=kind, frame_start=run.start, frame_end=run.stop - 1, joint=joint, value=value, limit=limit)

    def to_json(self) -> dict[str, Json]:
        """Serialize into an entry of `violations` of samples.jsonl."""
        return {
            "kind": self.kind.value,
            "frame_start": int(self.frame_start),
            "frame_end": int(self.frame_end),
            "joint": self.joint,
            "value": float(self.value),
            "limit": float(self.limit),
        }

    def __getitem__(self, key: str) -> Json:
        """Return a field by its key in samples.jsonl, so that results and rows are read alike."""
        return self.to_json()[key]


class AnomalyKind(Enum):
    """Kind of anomaly: something in a video that no real gripper shows."""

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
    """Measure of the kind: frames without a gripper (vanish) or frozen (freeze), share of a gripper seen twice
    (duplicate_gripper), metres jumped (teleport) or beyond what fingers can do (finger_opening), relative misfit of the
    shape (deformation) or of the size (scale_drift), pixels moved (camera_motion)."""

    def to_json(self, first_frame: int = 0) -> dict[str, Json]:
        """Serialize into an entry of `anomalies`, frames counted from `first_frame`."""
        return {
            "kind": self.kind.value,
            "frame_start": first_frame + int(self.frame_start),
            "frame_end": first_frame + int(self.frame_end),
            "severity": float(self.severity),
        }


class FailureVerdict(Enum):
    """Causes of failed episodes, in the order in which they are tested."""

    GROUNDING = "grounding"
    """The gripper, or the gap between its fingers, was not tracked with confidence in frames that show it."""
    GENERATION = "generation"
    """The video has an anomaly, or a motion that the robot cannot execute."""
    EXECUTION = "execution"
    """The executed gripper deviated from the generated one."""
    TASK = "task"
    """None of these, and the goal is not reached: the generated motion does not do the task."""


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


class GripperKind(Enum):
    """Gripper of a Panda."""

    FRANKA = "franka"
    """The Franka hand."""
    ROBOTIQ_2F85 = "robotiq-2f85"
    """The Robotiq 2F-85: links and contours of the gripper give the flange, the opening is unknown."""
    NONE = "none"
    """None, or an unknown one."""
    AUTO = "auto"
    """The Franka hand; where the arm is seen without it, none, else the Robotiq 2F-85."""


class InitialStateUse(Enum):
    """Whether the initial state of a sample was used."""

    UNKNOWN = "unknown"
    USED = "used"
    CONTRADICTED = "contradicted"

    @classmethod
    def of(cls, provided: InitialState | None, used: InitialState | None) -> "InitialStateUse":
        """Compare the state that was provided with the one that was used."""
        if provided is None:
            return cls.UNKNOWN
        return cls.CONTRADICTED if used is None else cls.USED


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
        depth = self.depth and replace(self.depth, depth_m=self.depth.depth_m[frames])
        return replace(self, **chosen, depth=depth)

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
