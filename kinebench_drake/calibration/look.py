"""Looking at the robot with a lens that is still a guess."""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.calibration.sightings import Sightings, sightings_of
from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.fit import UNSEEN_FINGER_M
from kinebench_drake.grounding.tracker import PoseTracker
from kinebench_drake.grounding.view import Frames
from kinebench_drake.models.robot import N_JOINTS


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """What T frames show of the robot."""

    cells: Sightings
    """Cells of all frames."""
    finger_m: Array
    """(T,) opening of each finger as seen [m]; a usual one where it is not."""
    q: Array
    """(T, 7) the arm that goes with the hand if the camera stands where it was taken to stand [rad]; NaN where none."""
    robot: NDArray[np.bool_]
    """(H, W) pixels of the first of the frames that show the robot."""

    def of_frames(self, rows: NDArray[np.intp]) -> "Look":
        """What some of the frames show."""
        return replace(self, cells=self.cells.of_frames(rows), finger_m=self.finger_m[rows], q=self.q[rows])


class Eye(Protocol):
    """What looks: the tracker's networks, or in tests the truth."""

    def look(self, frames: Frames, camera: Camera) -> Look:
        """Look at `frames` (T, H, W, 3), taken with about this camera."""
        ...


class NetworkEye:
    """The networks of the tracker."""

    def __init__(self, tracker: PoseTracker) -> None:
        """Look with a tracker; its poses matter little, its views are what is used."""
        self._tracker = tracker

    @classmethod
    def create(cls) -> "NetworkEye":
        """With the shipped weights.

        Raises:
            SetupError: weights, meshes or native libraries are missing.
        """
        from kinebench_drake.grounding.estimator import NetworkEstimator
        from kinebench_drake.grounding.tracker import CadTracker
        from kinebench_drake.models.perception.weights import load_network

        return cls(CadTracker(NetworkEstimator(load_network())))

    def look(self, frames: Frames, camera: Camera) -> Look:
        """See `Eye`."""
        seen = self._tracker.track(frames, camera)
        close = [(row, pose.view) for row, pose in enumerate(seen.poses) if pose is not None]
        finger_m = [np.nan if pose is None else pose.finger_m for pose in seen.poses]
        arms = [None if pose is None else pose.arm for pose in seen.poses]
        return Look(
            cells=sightings_of([*close, *enumerate(seen.wide)], camera),
            finger_m=np.nan_to_num(np.array(finger_m), nan=UNSEEN_FINGER_M),
            q=np.stack([np.full(N_JOINTS, np.nan) if arm is None else arm.q for arm in arms]),
            robot=seen.robot,
        )
