"""The grounding and the kinematic judge of a worker process, and the robot that they are loaded for."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import MAX_TABLE_HEIGHT_M, Camera
from kinebench_drake.errors import InputError, SetupError, UsageError
from kinebench_drake.formats.trajectories.trajectory import Trajectory
from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.arm import PANDA, ROBOTS, load_robot
from kinebench_drake.models.named_arm import UNNAMED, named_arms
from kinebench_drake.models.robot import Robot
from kinebench_drake.track import GripperTrack, IkStatus, JointTrack

if TYPE_CHECKING:  # Drake, torch and Open3D take seconds to load
    from kinebench_drake.grounding.camera.calibrate import Calibrator
    from kinebench_drake.grounding.video import Grounder
    from kinebench_drake.metrics.judge import TrackJudge
    from kinebench_drake.metrics.kinematic_result import KinematicResult
    from kinebench_drake.models.gripper import GripperModel


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotOptions:
    """The robot and its table."""

    table_height_m: float = 0.0
    """Height of the table top in the robot base frame B [m]."""
    robot: str = PANDA
    """Name of the robot, or path of its URDF."""
    tool: str | None = None
    """Link, or pose in a link, whose frame is G; None for panda_hand_tcp."""
    limits: Path | None = None
    """JSON file of limits that replace those of the robot."""
    payload_kg: float = 0.0
    """Mass at the origin of G [kg]."""
    obstacles: Path | None = None
    """JSON file of bodies that the arm must not touch."""
    package_path: Path | None = None
    """Folder of the packages of package:// URIs."""

    def __post_init__(self) -> None:
        """Check the height of the table, by default the floor's; an arm that is not named is the Panda.

        Raises:
            UsageError: it is out of range.
        """
        if self.robot == UNNAMED:
            object.__setattr__(self, "robot", PANDA)
        if self.table_height_m == 0.0 and self.robot in named_arms():
            object.__setattr__(self, "table_height_m", named_arms()[self.robot].floor_m)
        if not abs(self.table_height_m) <= MAX_TABLE_HEIGHT_M:
            raise UsageError(
                f"$table_height_m is {self.table_height_m}, expected metres from {-MAX_TABLE_HEIGHT_M} to "
                f"{MAX_TABLE_HEIGHT_M} in the robot's base frame"
            )

    @property
    def is_named(self) -> bool:
        """True if the robot is known by name."""
        return self.robot in ROBOTS

    def load(self) -> Robot:
        """Load the robot.

        Raises:
            UsageError: it cannot be used.
            SetupError: the Panda's files are missing.
        """
        try:
            return load_robot(
                self.robot,
                self.tool,
                limits=self.limits,
                payload_kg=self.payload_kg,
                obstacles=self.obstacles,
                package_path=self.package_path,
            )
        except InputError as error:
            raise UsageError(f"$robot: {error}") from None


class Resources:
    """Grounding with the shipped networks and kinematics in Drake, loaded once per worker process."""

    def __init__(self, options: RobotOptions) -> None:
        """Load the robot; networks and gripper meshes are loaded with the first video.

        Raises:
            UsageError: the robot cannot be used.
            SetupError: the Panda's files are missing.
        """
        from kinebench_drake.kinematics.plant import ArmPlant

        self._table_height_m = options.table_height_m
        self.plant = ArmPlant(options.load())
        """Drake plant of the robot, which all methods share."""
        self._judges: dict[float, TrackJudge] = {}
        self._judge(self._table_height_m)

    @cached_property
    def grounder(self) -> "Grounder":
        """The grounding."""
        from kinebench_drake.grounding.video import Grounder

        return Grounder(table_height_m=self._table_height_m)

    @cached_property
    def calibrator(self) -> "Calibrator":
        """The calibration of cameras."""
        from kinebench_drake.grounding.camera.calibrate import Calibrator

        return Calibrator.load()

    def judge(self, track: GripperTrack, table_height_m: float | None = None) -> "KinematicResult":
        """Judge a track of poses: infeasible only if no joint path follows it.

        Args:
            table_height_m: height of the table in the robot base frame [m]; None: that of the options.
        """
        return self._judge(self._table_height_m if table_height_m is None else table_height_m).judge_poses(track)

    def _judge(self, table_height_m: float) -> "TrackJudge":
        from kinebench_drake.metrics.judge import TrackJudge

        if table_height_m not in self._judges:
            self._judges[table_height_m] = TrackJudge(self.plant, table_height_m=table_height_m)
        return self._judges[table_height_m]

    def joints(self, track: GripperTrack, table_height_m: float) -> JointTrack:
        """Return joint angles for a robot that executes a track: near its rest posture, each near those before.

        Where these come to a limit, they are those of `judge` with this height of the table [m], which may bend the arm
        in another way.
        """
        from kinebench_drake.kinematics.continuation import solve_stepwise

        tracked = track.tracked & np.isfinite(track.X_BG).all(axis=(1, 2))
        q = np.full((len(track.t_s), len(self.plant.lower)), np.nan)
        q[tracked], failure = solve_stepwise(self.plant, track.X_BG[tracked], self.plant.robot.rest_q)
        if failure is not None:
            return self.judge(track, table_height_m).joints
        position_m, rotation_rad = np.full((2, len(q)), np.nan)
        reached = self.plant.forward_path(q[tracked])
        position_m[tracked], rotation_rad[tracked] = pose_difference(reached, track.X_BG[tracked])
        status = tuple(IkStatus.OK if ok else IkStatus.NOT_TRACKED for ok in tracked)
        errors = {"position_error_m": position_m, "rotation_error_rad": rotation_rad}
        return JointTrack(t_s=track.t_s, q=q, status=status, **errors)

    def judge_joints(self, t_s: Array, q: Array, finger_width_m: Array) -> "KinematicResult":
        """Judge joint angles (T, 7) [rad] as recorded; NaN where unknown.

        Args:
            t_s: (T,) times [s], increasing.
            q: (T, 7) joint angles [rad].
            finger_width_m: (T,) gap between the finger pads [m].
        """
        return self._judge(self._table_height_m).judge_joints(t_s, q, finger_width_m)

    def undo_turns(self, trajectory: Trajectory) -> Trajectory:
        """Return joint angles that a full turn brings nearer to their limits in every frame with that turn.

        Recorders wrap angles at half a turn: the Panda's joint 6 goes up to 215 degrees, stored as -145.
        """
        if trajectory.q is None:
            return trajectory
        from kinebench_drake.kinematics.path import undo_turns

        q, turned = undo_turns(self.plant, trajectory.q)
        warnings = (
            f"{self.plant.robot.joints[j]} is out of its limits by a full turn in all frames, as an angle that a "
            "recorder wraps: the turn was undone"
            for j in np.flatnonzero(turned)
        )
        return replace(trajectory, q=q, warnings=(*trajectory.warnings, *warnings))

    def misfit(self, trajectory: Trajectory, enough: float) -> float:
        """Return how badly a trajectory fits the robot (`metrics.misfit`)."""
        from kinebench_drake.metrics.misfit import misfit

        t_s = trajectory.t_s
        X_BG = trajectory.X_BG
        q = self.undo_turns(trajectory).q
        return misfit(self.plant, t_s, X_BG, q, table_height_m=self._table_height_m, enough=enough)

    def overlay(
        self,
        frames: Frames,
        camera: Camera,
        track: GripperTrack,
        zoom: Array | None = None,
        *,
        gripper: "GripperModel | None",
    ) -> Iterator[NDArray[np.uint8]]:
        """Draw the posed gripper on the frames, or without one its axes alone.

        `zoom` (T,) is the focal length of the frames over that of the camera.
        """
        from kinebench_drake.grounding.overlay import draw_overlay

        return draw_overlay(frames, camera, track, zoom, gripper=gripper)


ResourcesFactory = Callable[[RobotOptions], Resources]
"""Creates the tools of a worker process; picklable."""


def load_resources(make: ResourcesFactory, options: RobotOptions) -> Resources:
    """Create the tools.

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
        raise UsageError(f"$robot: {error}") from None
