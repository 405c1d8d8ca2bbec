"""The heavy steps of measuring as the rest of the program sees them; loaded by import path, once a process."""

import importlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import SetupError
from kinebench_drake.geometry import Array
from kinebench_drake.products import Anomaly, GripperTrack, JointTrack
from kinebench_drake.row import Json


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """What kinematics says about a track."""

    joints: JointTrack
    feasible: bool | None
    metrics: Mapping[str, Json]
    violations: tuple[Mapping[str, Json], ...]
    per_frame: Mapping[str, Array]
    """`manipulability` and `joint_margin`, each (T,)."""


class Stages(Protocol):
    """The heavy steps, loaded once a process."""

    def ground(self, frames: NDArray[np.uint8], camera: Camera, t_s: Array) -> Grounded:
        """Find the gripper in frames (T, H, W, 3)."""
        ...

    def judge(self, track: GripperTrack) -> Judgement:
        """Hold a track against the robot."""
        ...

    def overlay(self, frames: NDArray[np.uint8], camera: Camera, track: GripperTrack) -> Iterator[NDArray[np.uint8]]:
        """Draw the posed gripper on the frames."""
        ...


def load_stages(path: str) -> Stages:
    """The stages of an import path "module:Class", made ready.

    Raises:
        SetupError: a library, a driver or the weights are missing.
    """
    module, _, name = path.partition(":")
    try:
        return cast(Stages, getattr(importlib.import_module(module), name)())
    except (ImportError, AttributeError) as error:
        raise SetupError(f"cannot load {path} ({error}); `kinebench-drake doctor` tells what is missing") from None
