"""The heavy steps of measuring as the rest of the program sees them; loaded by import path, once a process."""

import importlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError, SetupError, UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.metrics.judge import TrackJudge
from kinebench_drake.metrics.result import KinematicResult, details_json, violation_json
from kinebench_drake.models.arm import choose_robot
from kinebench_drake.types import Anomaly, GripperTrack, InitialStateUse, JointTrack, Json, Priors

if TYPE_CHECKING:
    from kinebench_drake.grounding.pipeline import GroundingPipeline, GroundingResult


SHIPPED_STAGES = "kinebench_drake.evaluation.stages:DrakeStages"
"""Import path of the stages that come with the package."""
MAX_TABLE_HEIGHT_M = 2.0
"""Farthest that a table's top may be from the robot's base, up or down [m]."""


class Grounded(Protocol):
    """What grounding says about a video."""

    @property
    def track(self) -> GripperTrack:
        """The gripper's path."""
        ...

    @property
    def anomalies(self) -> tuple[Anomaly, ...]:
        """What no real gripper can do."""
        ...

    @property
    def camera_motion_px(self) -> float | None:
        """How far the picture's background moves [px]; None if it cannot be told."""
        ...

    @property
    def arm_consistency_px(self) -> float | None:
        """How far the links are from where the arm that goes with the hand has them [px]; None if none is seen."""
        ...

    @property
    def robot(self) -> NDArray[np.bool_]:
        """(T, H, W) pixels that show the robot."""
        ...

    @property
    def first_frame(self) -> InitialStateUse:
        """What became of the pose that the first frame is said to have."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """What kinematics says about a track."""

    track: GripperTrack
    """The track as judged; of given joint angles, where they put the TCP."""
    joints: JointTrack
    feasible: bool | None
    metrics: Mapping[str, Json]
    """Metric names to values; None where not measurable."""
    reasons: Mapping[str, str] = field(default_factory=dict)
    """Why a metric is None, by its name."""
    violations: tuple[Mapping[str, Json], ...]
    details: Mapping[str, Json] = field(default_factory=dict)
    """Further findings for the row, such as noise and limits joint by joint."""
    curves: Mapping[str, Array] = field(default_factory=dict)
    """Further arrays for the track's file, each (T,) or (T, 7), such as `manipulability` and `joint_margin`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotOptions:
    """What the command line tells the stages."""

    table_height_m: float = 0.0
    """Height of the table's top in the robot's base frame B [m]."""
    urdf: Path | None = None
    """The robot's URDF; None for mani_skill's Panda."""
    tcp_frame: str | None = None
    """Name of the URDF's TCP frame; None for the Panda's."""

    def __post_init__(self) -> None:
        """Check the options against each other.

        Raises:
            UsageError: the table's height is no height, or only one of robot and frame is given.
        """
        if not abs(self.table_height_m) <= MAX_TABLE_HEIGHT_M:
            raise UsageError(
                f"--table-height is {self.table_height_m}, expected metres from {-MAX_TABLE_HEIGHT_M} to "
                f"{MAX_TABLE_HEIGHT_M} in the robot's base frame"
            )
        if (self.urdf is None) is not (self.tcp_frame is None):
            raise UsageError("--robot and --tcp-frame go together: the URDF and the name of its TCP frame")
        if self.urdf is not None and not self.urdf.is_file():
            raise UsageError(f"--robot {self.urdf}: there is no such file, expected a URDF")


class Stages(Protocol):
    """The heavy steps, loaded once a process."""

    def ground(self, frames: NDArray[np.uint8], camera: Camera, t_s: Array, known: Priors) -> Grounded:
        """Find the gripper in frames (T, H, W, 3); what is known takes the place of estimates."""
        ...

    def judge(self, track: GripperTrack) -> Judgement:
        """Hold a track against the robot: it is infeasible only if no joint path does it."""
        ...

    def judge_joints(self, t_s: Array, q: Array, finger_width_m: Array) -> Judgement:
        """Hold joint angles (T, 7) [rad] at times (T,) [s] against the robot, as they are given.

        Args:
            t_s: (T,) times [s], increasing.
            q: (T, 7) joint angles [rad]; NaN where unknown.
            finger_width_m: (T,) gap between the finger pads [m]; NaN where unknown.
        """
        ...

    def overlay(self, frames: NDArray[np.uint8], camera: Camera, track: GripperTrack) -> Iterator[NDArray[np.uint8]]:
        """Draw the posed gripper on the frames."""
        ...


def load_stages(path: str, options: RobotOptions) -> Stages:
    """The stages of an import path "module:Class", made ready with what the command line told.

    Raises:
        SetupError: a library, a driver or the weights are missing.
        UsageError: the robot that the command line named cannot be used.
    """
    module, _, name = path.partition(":")
    try:
        return cast(Stages, getattr(importlib.import_module(module), name)(options))
    except (ImportError, OSError, AttributeError) as error:
        raise SetupError(
            f"cannot load {path} ({error}); `kinebench-drake doctor --fix` mends what is missing, or tells how"
        ) from None
    except InputError as error:
        raise UsageError(f"--robot and --tcp-frame: {error}") from None


class DrakeStages:
    """GroundingResult with the shipped networks, kinematics in Drake."""

    def __init__(self, options: RobotOptions) -> None:
        """Load the robot; weights and meshes of the gripper follow with the first video.

        Raises:
            InputError: the robot named cannot be used.
            SetupError: the Panda's files are missing.
        """
        self._plant = ArmPlant(choose_robot(options.urdf, options.tcp_frame))
        self._judge = TrackJudge(self._plant, table_height_m=options.table_height_m)

    @cached_property
    def _pipeline(self) -> "GroundingPipeline":
        from kinebench_drake.grounding.pipeline import GroundingPipeline

        return GroundingPipeline.create()

    def ground(self, frames: NDArray[np.uint8], camera: Camera, t_s: Array, known: Priors) -> "GroundingResult":
        """Find the gripper in frames (T, H, W, 3); what is known takes the place of estimates.

        Raises:
            InputError: what is known is of another video.
            SetupError: weights or libraries are missing.
        """
        return self._pipeline.ground(frames, camera, t_s, known)

    def judge(self, track: GripperTrack) -> Judgement:
        """Hold a track of poses against the robot: infeasible only if no joint path does it."""
        return self._judged(self._judge.judge_poses(track))

    def judge_joints(self, t_s: Array, q: Array, finger_width_m: Array) -> Judgement:
        """Hold joint angles (T, 7) [rad] against the robot's limits as they are given; NaN where unknown."""
        return self._judged(self._judge.judge_joints(t_s, q, finger_width_m))

    def _judged(self, result: KinematicResult) -> Judgement:
        return Judgement(
            track=result.track,
            joints=result.joints,
            feasible=result.feasible,
            metrics=dict(result.metrics),
            reasons=result.reasons,
            violations=tuple(violation_json(v) for v in result.violations),
            details=details_json(self._plant, result),
            curves=result.curves,
        )

    def overlay(self, frames: NDArray[np.uint8], camera: Camera, track: GripperTrack) -> Iterator[NDArray[np.uint8]]:
        """Draw the posed gripper on the frames."""
        from kinebench_drake.grounding.overlay import draw_overlay

        return draw_overlay(frames, camera, track)
