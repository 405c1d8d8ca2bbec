"""The heavy steps of measuring: the grounding pipeline and Drake, behind the `Stages` protocol."""

from collections.abc import Iterator
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.details import details_json, violation_json
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.known import Known
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.metrics.judge import TrackJudge
from kinebench_drake.metrics.kinematic import KinematicResult
from kinebench_drake.models.arm import choose_robot
from kinebench_drake.products import GripperTrack
from kinebench_drake.stages import Judgement, StageOptions

if TYPE_CHECKING:  # torch and Open3D, seconds to load, which trajectories never need
    from kinebench_drake.grounding.pipeline import Grounding, GroundingPipeline


class DrakeStages:
    """Grounding with the shipped networks, kinematics in Drake."""

    def __init__(self, options: StageOptions) -> None:
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

    def ground(self, frames: NDArray[np.uint8], camera: Camera, t_s: Array, known: Known) -> "Grounding":
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
