"""A trajectory as a file holds it, and as it is handed on once it is checked."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.geometry import Array

N_JOINTS = 7
"""Joints of the arm."""
MIN_STEP_S, MAX_STEP_S = 1e-4, 1e3
"""Shortest and longest time between two frames [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
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
class Recording:
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
