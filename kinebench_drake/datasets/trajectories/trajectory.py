"""Trajectories: as stored in a file, as validated for judging, and as samples before reading."""

from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.geometry import Array

N_JOINTS = 7
"""Joints of the arm."""
MIN_STEP_S, MAX_STEP_S = 1e-4, 1e3
"""Shortest and longest time between two frames [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryOptions:
    """What the user says about the data of a file, over what is found there."""

    rate_hz: float | None = None
    """Frames per second, over the file's times [Hz]."""
    joints: str | None = None
    """Name of the array, data set or column that holds the joint angles."""
    poses: str | None = None
    """Name of the array or column that holds the poses of the TCP."""

    def __post_init__(self) -> None:
        """Check the choice.

        Raises:
            UsageError: the rate is no rate, or joints and poses are both named.
        """
        if self.rate_hz is not None and not 1.0 / MAX_STEP_S <= self.rate_hz <= 1.0 / MIN_STEP_S:
            raise UsageError(
                f"--rate is {self.rate_hz}, expected frames per second from {1.0 / MAX_STEP_S:g} to "
                f"{1.0 / MIN_STEP_S:g}, such as 20"
            )
        if self.joints is not None and self.poses is not None:
            raise UsageError("--joints and --poses exclude each other: a trajectory is judged by one of them")


@dataclass(frozen=True, slots=True, kw_only=True)
class RawTrajectory:
    """What a file holds, of any shape and value; `check` makes a `Trajectory` of it or says why not."""

    t_s: NDArray[np.generic] | None
    """(T,) times [s]; None where the file has none."""
    X_BG: NDArray[np.generic] | None = None
    """(T, 4, 4) poses of the TCP in the robot base frame [m]; None where `q` is given."""
    q: NDArray[np.generic] | None = None
    """(T, 7) joint angles [rad], (T, 8) or (T, 9) with the fingers behind them; None where `X_BG` is given."""
    tracked: NDArray[np.generic] | None = None
    """(T,) whether the frame is known; None for all."""
    finger_width_m: NDArray[np.generic] | None = None
    """(T,) gap between the finger pads [m]; None where unknown."""
    columns: str
    """What was taken from the file, in its own names."""
    warnings: tuple[str, ...] = ()
    """What the user should know about it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trajectory:
    """A gripper's or an arm's way through time, sound enough to be judged. Either `X_BG` or `q` is given."""

    t_s: Array
    """(T,) times [s], increasing."""
    X_BG: Array | None
    """(T, 4, 4) rigid poses of the TCP in the robot base frame [m]; NaN where not tracked."""
    q: Array | None
    """(T, 7) joint angles [rad], to be judged as they are; NaN where not tracked."""
    tracked: NDArray[np.bool_]
    """(T,) frames that are known."""
    finger_width_m: Array
    """(T,) gap between the finger pads, 0..0.08 [m]; NaN where unknown."""
    columns: str
    """What was taken from the file, in its own names."""
    warnings: tuple[str, ...]
    """What was found amiss and mended, or left out."""

    def __post_init__(self) -> None:
        """Check shapes against the number of frames.

        Raises:
            InputError: a shape is wrong, or not exactly one of `X_BG` and `q` is given.
        """
        n = len(self.t_s)
        shapes = {"t_s": (n,), "X_BG": (n, 4, 4), "q": (n, N_JOINTS), "tracked": (n,), "finger_width_m": (n,)}
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is not None and value.shape != shape:
                raise InputError(f"{name} has shape {value.shape}, expected {shape}")
        if (self.X_BG is None) is (self.q is None):
            raise InputError("a trajectory holds either poses or joint angles")


class TrajectoryFormat(Enum):
    """What a trajectory is stored as."""

    NPZ = "npz"
    CSV = "csv"
    MANISKILL = "maniskill"
    LEROBOT = "lerobot"


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectorySample:
    """One trajectory and what its file says about it."""

    id: str
    """Unique, safe as a file name, contains the file's stem or the dataset's name."""
    path: Path
    """The file that holds it; other trajectories may be in it too."""
    video: str
    """The trajectory as results name it: its file relative to what was named, and its part behind a #."""
    format: TrajectoryFormat
    part: str | None = None
    """Which one of the file's trajectories: the group of a ManiSkill file, the episode's number of a dataset."""
    about: tuple[Path, ...] = ()
    """Further files that its reading depends on."""
    rate_hz: float | None = None
    """Frames per second that the file's description tells [Hz]; None where the file has times."""
    task: str | None = None
    model: str | None = None
    seed: int | None = None
    prompt: str | None = None
    success: bool | None = None
    """Whether the task's goal was reached, by the file's own account."""
    warnings: tuple[str, ...] = ()
    """What the user should know about it."""
    problem: str | None = None
    """Why it cannot be read at all; None when it can be tried."""
