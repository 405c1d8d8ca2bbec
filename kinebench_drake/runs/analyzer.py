"""The grounding pipeline and the kinematic judge, loaded once per worker process."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import MAX_TABLE_HEIGHT_M, Camera
from kinebench_drake.errors import InputError, SetupError, UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.io.files import absence
from kinebench_drake.models.arm import choose_robot
from kinebench_drake.models.robot import Robot
from kinebench_drake.types import GripperKind, GripperTrack, Priors

if TYPE_CHECKING:  # Drake, torch and Open3D take seconds to load
    from kinebench_drake.grounding.camera.camera_estimate import CameraEstimate
    from kinebench_drake.grounding.camera.contradiction import CameraChecker, CameraContradiction
    from kinebench_drake.grounding.camera.estimate import CameraEstimator
    from kinebench_drake.grounding.camera.reading import BetterReading
    from kinebench_drake.grounding.pipeline import GroundingPipeline, GroundingResult
    from kinebench_drake.grounding.tracking.estimator import NetworkEstimator
    from kinebench_drake.metrics.judge import TrackJudge
    from kinebench_drake.metrics.result import KinematicResult


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotOptions:
    """The robot and its table."""

    table_height_m: float = 0.0
    """Height of the table top in the robot base frame B [m]."""
    urdf: Path | None = None
    """URDF of the robot; None for mani_skill's Panda."""
    tcp_frame: str | None = None
    """TCP frame of the URDF; None for the Panda's."""

    def __post_init__(self) -> None:
        """Check the options against each other.

        Raises:
            UsageError: the table height is out of range, or only one of URDF and TCP frame is set.
        """
        if not abs(self.table_height_m) <= MAX_TABLE_HEIGHT_M:
            raise UsageError(
                f"--table-height is {self.table_height_m}, expected metres from {-MAX_TABLE_HEIGHT_M} to "
                f"{MAX_TABLE_HEIGHT_M} in the robot's base frame"
            )
        if (self.urdf is None) is not (self.tcp_frame is None):
            raise UsageError("--robot and --tcp-frame go together: the URDF and the name of its TCP frame")
        if self.urdf is not None and not self.urdf.is_file():
            raise UsageError(f"--robot {self.urdf}: {absence(self.urdf)}, expected a URDF")

    def load(self) -> Robot:
        """Load the robot.

        Raises:
            UsageError: it cannot be used.
            SetupError: the Panda's files are missing.
        """
        try:
            return choose_robot(self.urdf, self.tcp_frame)
        except InputError as error:
            raise UsageError(f"--robot and --tcp-frame: {error}") from None


class Analyzer:
    """Grounding with the shipped networks, kinematics in Drake."""

    def __init__(self, options: RobotOptions) -> None:
        """Load the robot; networks and gripper meshes are loaded with the first video.

        Raises:
            UsageError: the robot cannot be used.
            SetupError: the Panda's files are missing.
        """
        from kinebench_drake.kinematics.plant import ArmPlant
        from kinebench_drake.metrics.judge import TrackJudge

        self._table_height_m = options.table_height_m
        self._arm_pipelines: dict[GripperKind, GroundingPipeline] = {}
        self._plant = ArmPlant(options.load())
        self._judges = {options.table_height_m: TrackJudge(self._plant, table_height_m=options.table_height_m)}

    @cached_property
    def _estimator(self) -> "NetworkEstimator":
        from kinebench_drake.grounding.tracking.estimator import NetworkEstimator
        from kinebench_drake.models.perception.network import load_network

        return NetworkEstimator(load_network())

    @cached_property
    def _pipeline(self) -> "GroundingPipeline":
        from kinebench_drake.grounding.pipeline import GroundingPipeline

        return GroundingPipeline.of(self._estimator, self._table_height_m)

    def ground(self, frames: NDArray[np.uint8], camera: Camera, t_s: Array, priors: Priors) -> "GroundingResult":
        """Track the gripper through frames (T, H, W, 3) at times (T,) [s]; priors replace estimates.

        Raises:
            InputError: the priors do not fit the video.
            SetupError: weights or libraries are missing.
        """
        return self._pipeline.ground(frames, camera, t_s, priors)

    @cached_property
    def _arm_estimator(self) -> "NetworkEstimator":
        from kinebench_drake.grounding.tracking.estimator import NetworkEstimator
        from kinebench_drake.models.perception.network import ARM_WEIGHTS, load_network

        return NetworkEstimator(load_network(ARM_WEIGHTS))

    def ground_arm(
        self,
        frames: NDArray[np.uint8],
        camera: Camera,
        t_s: Array,
        priors: Priors,
        gripper: GripperKind = GripperKind.NONE,
    ) -> "GroundingResult":
        """Track the flange by the arm, and by another gripper than Franka's, as `ground` does the hand.

        Raises:
            SetupError: weights or libraries are missing.
        """
        from kinebench_drake.grounding.pipeline import GroundingPipeline

        if gripper not in self._arm_pipelines:
            self._arm_pipelines[gripper] = GroundingPipeline.of(self._arm_estimator, self._table_height_m, gripper)
        return self._arm_pipelines[gripper].ground(frames, camera, t_s, priors)

    @cached_property
    def _cameras(self) -> "CameraEstimator":
        from kinebench_drake.grounding.camera.estimate import CameraEstimator

        return CameraEstimator(self._estimator)

    @cached_property
    def _checker(self) -> "CameraChecker":
        from kinebench_drake.grounding.camera.contradiction import CameraChecker

        return CameraChecker(self._cameras.estimator, self._cameras.fitter)

    def camera_agreement(self, frames: NDArray[np.uint8], camera: Camera) -> float | None:
        """Return the share of the arm's contours on image edges with this camera; None if no arm is seen.

        Raises:
            SetupError: weights or libraries are missing.
        """
        return self._checker.measure_agreement(frames, camera)

    def estimate_camera(self, frames: NDArray[np.uint8]) -> "CameraEstimate":
        """Estimate the camera of frames (T, H, W, 3).

        Raises:
            UnmeasurableError: hand and arm are seen in too few frames.
            SetupError: weights or libraries are missing.
        """
        return self._cameras.estimate(frames)

    def posture_agreement(
        self, frames: NDArray[np.uint8], camera: Camera, q: Array, finger_m: Array, *, hand: bool = True
    ) -> float:
        """Return the share of the arm's contours on image edges at postures (T, 7) [rad], openings (T,) [m].

        Without `hand` its contours do not count.

        Raises:
            SetupError: weights or libraries are missing.
        """
        return self._checker.posture_agreement(frames, camera, q, finger_m, hand=hand)

    def camera_reading(
        self, frames: NDArray[np.uint8], camera: Camera, least: float, *, likely_only: bool = False
    ) -> "BetterReading | None":
        """Return a reading of picture or camera with which the arm agrees clearly better; None if there is none.

        With `likely_only` those are tried that a camera in the plane of symmetry, or a narrow margin, hides.

        Raises:
            SetupError: weights or libraries are missing.
        """
        from kinebench_drake.grounding.camera.reading import Reading

        readings = (Reading.MIRRORED, Reading.CROPPED) if likely_only else tuple(Reading)
        return self._checker.find_reading(frames, camera, least, readings)

    def count_hands(self, frames: NDArray[np.uint8]) -> tuple[int, int]:
        """Return in how many of some frames a hand is seen, whatever the camera, and how many were searched.

        Raises:
            SetupError: weights or libraries are missing.
        """
        from kinebench_drake.grounding.camera.estimate import usual_camera

        return self._checker.count_hands(frames, usual_camera(frames.shape[2], frames.shape[1]))

    def camera_contradiction(self, frames: NDArray[np.uint8], camera: Camera) -> "CameraContradiction | None":
        """Return another camera under which the arm agrees clearly better with the images; None if there is none.

        Raises:
            SetupError: weights or libraries are missing.
        """
        return self._checker.find_contradiction(frames, camera)

    def judge(self, track: GripperTrack, table_height_m: float | None = None) -> "KinematicResult":
        """Judge a track of poses: infeasible only if no joint path follows it.

        Args:
            track: the track.
            table_height_m: height of the table in the robot base frame [m]; None: that of the options.
        """
        return self._judge(self._table_height_m if table_height_m is None else table_height_m).judge_poses(track)

    def _judge(self, table_height_m: float) -> "TrackJudge":
        from kinebench_drake.metrics.judge import TrackJudge

        if table_height_m not in self._judges:
            self._judges[table_height_m] = TrackJudge(self._plant, table_height_m=table_height_m)
        return self._judges[table_height_m]

    def judge_joints(self, t_s: Array, q: Array, finger_width_m: Array) -> "KinematicResult":
        """Judge joint angles (T, 7) [rad] as recorded; NaN where unknown.

        Args:
            t_s: (T,) times [s], increasing.
            q: (T, 7) joint angles [rad].
            finger_width_m: (T,) gap between the finger pads [m].
        """
        return self._judge(self._table_height_m).judge_joints(t_s, q, finger_width_m)

    def overlay(
        self,
        frames: NDArray[np.uint8],
        camera: Camera,
        track: GripperTrack,
        zoom: Array | None = None,
        *,
        hand: bool = True,
    ) -> Iterator[NDArray[np.uint8]]:
        """Draw the posed gripper on the frames, or without `hand` its axes alone.

        `zoom` (T,) is the focal length of the frames over that of the camera.
        """
        from kinebench_drake.grounding.overlay import draw_overlay

        return draw_overlay(frames, camera, track, zoom, hand=hand)


AnalyzerFactory = Callable[[RobotOptions], Analyzer]
"""Creates the analyzer of a worker process; picklable."""


def load_analyzer(make: AnalyzerFactory, options: RobotOptions) -> Analyzer:
    """Create an analyzer.

    Raises:
        UsageError: the robot cannot be used.
        SetupError: a library, a driver or the Panda's files are missing.
    """
    try:
        return make(options)
    except (ImportError, OSError) as error:
        raise SetupError(
            f"cannot load the robot ({error}); `kinebench-drake doctor --fix` repairs what is missing, or says how"
        ) from error
    except InputError as error:
        raise UsageError(f"--robot and --tcp-frame: {error}") from None
