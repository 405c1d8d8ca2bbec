"""The heavy steps of measuring: the grounding pipeline and Drake, behind the `Stages` protocol."""

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.overlay import draw_overlay
from kinebench_drake.grounding.pipeline import Grounding, GroundingPipeline
from kinebench_drake.kinematics.ik import solve_track
from kinebench_drake.kinematics.manipulability import manipulability
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.metrics.kinematic import Violation, evaluate_track, limit_margin
from kinebench_drake.products import GripperTrack
from kinebench_drake.row import Json
from kinebench_drake.stages import Judgement


class DrakeStages:
    """Grounding with the shipped networks, kinematics in Drake."""

    def __init__(self) -> None:
        """Load weights, meshes and the plant.

        Raises:
            SetupError: one of them is missing.
        """
        self._pipeline = GroundingPipeline.create()
        self._plant = ArmPlant()

    def ground(self, frames: NDArray[np.uint8], camera: Camera, t_s: Array) -> Grounding:
        """Find the gripper in frames (T, H, W, 3)."""
        return self._pipeline.ground(frames, camera, t_s)

    def judge(self, track: GripperTrack) -> Judgement:
        """Solve inverse kinematics along a track and hold it against the robot's limits."""
        joints = solve_track(self._plant, track)
        result = evaluate_track(self._plant, track, joints)
        return Judgement(
            joints=joints,
            feasible=None if result.feasible is None else bool(result.feasible),
            metrics={name: _plain(value) for name, value in result.metrics.items()},
            violations=tuple(_violation_json(v) for v in result.violations),
            per_frame=self._per_frame(joints.q),
        )

    def overlay(self, frames: NDArray[np.uint8], camera: Camera, track: GripperTrack) -> Iterator[NDArray[np.uint8]]:
        """Draw the posed gripper on the frames."""
        return draw_overlay(frames, camera, track)

    def _per_frame(self, q: Array) -> Mapping[str, Array]:
        """Manipulability and least joint-limit margin of each frame of joint angles (T, 7) [rad]; NaN where q is."""
        return {
            "manipulability": manipulability(self._plant, q).full,
            "joint_margin": limit_margin(self._plant, q).min(axis=-1),
        }


def _violation_json(violation: Violation) -> dict[str, Json]:
    return {
        "kind": violation.kind.value,
        "frame_start": int(violation.frame_start),
        "frame_end": int(violation.frame_end),
        "joint": violation.joint,
        "value": float(violation.value),
        "limit": float(violation.limit),
    }


def _plain(value: float | bool | None) -> float | bool | None:
    """The value in Python's own types, as JSON wants them."""
    return value if value is None else bool(value) if isinstance(value, bool | np.bool_) else float(value)
