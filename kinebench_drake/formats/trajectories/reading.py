"""Reading of a table: which of its numbers are joint angles, a pose or the gripper, and the trajectory they give."""

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.formats.trajectories.pose import from_quaternions, from_vectors
from kinebench_drake.formats.trajectories.trajectory import RawTrajectory
from kinebench_drake.geometry import Array


class Layout(Enum):
    """Meaning of the numbers of a frame."""

    JOINTS = "joint angles"
    QUATERNION = "x y z, quaternion w x y z"
    ROLL_PITCH_YAW = "x y z, roll pitch yaw"
    ROTATION_VECTOR = "x y z, rotation vector"
    MATRIX = "4x4 matrix by rows"


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """Numbers to read of each row of a table."""

    column: str = ""
    """Column of number lists that is the table; empty if each number has its own column."""
    layout: Layout
    indices: tuple[int, ...]
    """Indices of the numbers in a row, in the order of the layout."""
    fingers: tuple[int, ...] = ()
    """Indices of finger joints [m], each half of the gap."""
    width: int | None = None
    """Index of the gap between the finger pads [m]."""
    description: str
    """Text for results."""
    warnings: tuple[str, ...] = ()

    def apply(self, rows: Array, t_s: NDArray[np.generic] | None) -> RawTrajectory:
        """Return the trajectory of a table: rows (T, n) of numbers and their times (T,) [s], if there are any.

        Raises:
            InputError: the numbers are no rotations.
        """
        values, repairs = rows[:, self.indices], tuple[str, ...]()
        X_BG: Array | None = None
        if self.layout is Layout.MATRIX:
            X_BG = values.reshape(-1, 4, 4)
        elif self.layout is Layout.QUATERNION:
            X_BG, repairs = from_quaternions(values[:, :3], values[:, 3:])
        elif self.layout is not Layout.JOINTS:
            X_BG = from_vectors(values[:, :3], values[:, 3:], angles=self.layout is Layout.ROLL_PITCH_YAW)
        return RawTrajectory(
            t_s=t_s,
            X_BG=X_BG,
            q=values if self.layout is Layout.JOINTS else None,
            finger_width_m=self._finger_width(rows),
            columns=self.description,
            warnings=(*self.warnings, *repairs),
        )

    def _finger_width(self, rows: Array) -> Array | None:
        if self.width is not None:
            return rows[:, self.width]
        return np.asarray(2.0 * rows[:, self.fingers].mean(axis=1)) if self.fingers else None
