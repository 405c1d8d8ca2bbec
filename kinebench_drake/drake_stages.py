"""The heavy steps of measuring: the grounding pipeline and Drake, behind the `Stages` protocol."""

from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.ik import solve_track
from kinebench_drake.kinematics.manipulability import manipulability
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.metrics.kinematic import Violation, evaluate_track, limit_margin
from kinebench_drake.products import GripperTrack, IkStatus, JointTrack
from kinebench_drake.row import Json
from kinebench_drake.stages import Judgement, StageOptions

if TYPE_CHECKING:  # torch and Open3D, seconds to load, which trajectories never need
    from kinebench_drake.grounding.pipeline import Grounding, GroundingPipeline


class DrakeStages:
    """Grounding with the shipped networks, kinematics in Drake."""

    def __init__(self, options: StageOptions) -> None:
        """Load the robot; weights and meshes of the gripper follow with the first video.

        Raises:
            SetupError: the robot's files are missing.
        """
        self._options = options
        self._plant = ArmPlant()

    @cached_property
    def _pipeline(self) -> "GroundingPipeline":
        from kinebench_drake.grounding.pipeline import GroundingPipeline

        return GroundingPipeline.create()

    def ground(self, frames: NDArray[np.uint8], camera: Camera, t_s: Array) -> "Grounding":
        """Find the gripper in frames (T, H, W, 3).

        Raises:
            SetupError: weights or libraries are missing.
        """
        return self._pipeline.ground(frames, camera, t_s)

    def judge(self, track: GripperTrack) -> Judgement:
        """Solve inverse kinematics along a track and hold it against the robot's limits."""
        return self._judged(track, solve_track(self._plant, track))

    def judge_joints(self, t_s: Array, q: Array, finger_width_m: Array) -> Judgement:
        """Hold joint angles (T, 7) [rad] against the robot's limits as they are given; NaN where unknown."""
        known: NDArray[np.bool_] = np.asarray(np.isfinite(q).all(axis=-1), dtype=bool)
        X_BG = np.full((len(q), 4, 4), np.nan)
        X_BG[known] = [self._plant.forward(row) for row in q[known]]
        track = GripperTrack(
            t_s=t_s,
            X_CH=np.full_like(X_BG, np.nan),
            X_BG=X_BG,
            tracked=known,
            confidence=np.asarray(known, dtype=np.float64),
            finger_width_m=finger_width_m,
        )
        inside = np.asarray(known & ((q >= self._plant.lower) & (q <= self._plant.upper)).all(axis=-1))
        failed = {True: IkStatus.JOINT_LIMIT, False: IkStatus.NOT_TRACKED}
        error = np.where(known, 0.0, np.nan)
        joints = JointTrack(
            t_s=t_s,
            q=q,
            status=tuple(IkStatus.OK if i else failed[bool(k)] for i, k in zip(inside, known, strict=True)),
            position_error_m=error,
            rotation_error_rad=error,
        )
        return self._judged(track, joints)

    def _judged(self, track: GripperTrack, joints: JointTrack) -> Judgement:
        result = evaluate_track(self._plant, track, joints)
        return Judgement(
            track=track,
            joints=joints,
            feasible=None if result.feasible is None else bool(result.feasible),
            metrics={name: _plain(value) for name, value in result.metrics.items()},
            violations=tuple(_violation_json(v) for v in result.violations),
            curves=self._curves(joints.q),
        )

    def overlay(self, frames: NDArray[np.uint8], camera: Camera, track: GripperTrack) -> Iterator[NDArray[np.uint8]]:
        """Draw the posed gripper on the frames."""
        from kinebench_drake.grounding.overlay import draw_overlay

        return draw_overlay(frames, camera, track)

    def _curves(self, q: Array) -> Mapping[str, Array]:
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
