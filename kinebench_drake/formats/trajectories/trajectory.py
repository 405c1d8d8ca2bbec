"""Trajectories: as stored in a file, as validated for judging, and as samples before reading."""

from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.formats.samples import Sample
from kinebench_drake.geometry import Array

N_JOINTS = 7
"""Joints of the arm."""
JOINT_SIZES = range(N_JOINTS, N_JOINTS + 3)
"""Numbers of joint angles in a file: those of the arm, followed by up to two fingers."""
MAX_FRAMES = 100_000
"""Greatest number of frames; over an hour at 25 Hz."""
MAX_BYTES = 2**28
"""Most bytes of the arrays of a trajectory's file."""
SLOW_STEP_S = 5.0
"""Longer steps give a warning: robots are recorded faster [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RawTrajectory:
    """Unchecked content of a file, which `check` converts to a `Trajectory`."""

    t_s: NDArray[np.generic] | None
    """(T,) times [s]; None if the file has none."""
    X_BG: NDArray[np.generic] | None = None
    """(T, 4, 4) poses of the TCP in the robot base frame [m]; None if there is `q`."""
    q: NDArray[np.generic] | None = None
    """(T, 7) joint angles [rad], (T, 8) or (T, 9) with finger joints after them; None if there is `X_BG`."""
    tracked: NDArray[np.generic] | None = None
    """(T,) True for valid frames; None for all."""
    finger_width_m: NDArray[np.generic] | None = None
    """(T,) gap between the finger pads [m]; None if unknown."""
    columns: str
    """Names of the arrays or columns that were read."""
    warnings: tuple[str, ...] = ()
    """Warnings for the user."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trajectory:
    """Validated trajectory of a gripper or an arm: either `X_BG` or `q` is set."""

    t_s: Array
    """(T,) times [s], increasing."""
    X_BG: Array | None
    """(T, 4, 4) rigid poses of the TCP in the robot base frame [m]; NaN where not tracked."""
    q: Array | None
    """(T, 7) joint angles [rad], judged unchanged; NaN where not tracked."""
    tracked: NDArray[np.bool_]
    """(T,) True for valid frames."""
    finger_width_m: Array
    """(T,) gap between the finger pads, 0..0.08 [m]; NaN where unknown."""
    columns: str
    """Names of the arrays or columns that were read."""
    commands: tuple[Array, Array] | None = None
    """The numbers (T, n) as stored, and the actions (T, n) for them; None without actions alike."""
    dropped: tuple[int, ...] = ()
    """Frames before which the recording lacks a sample."""
    warnings: tuple[str, ...]
    """Repairs and omissions."""

    def __post_init__(self) -> None:
        """Check shapes against the number of frames.

        Raises:
            InputError: a shape is wrong, or not exactly one of `X_BG` and `q` is set.
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
    """File format of a trajectory."""

    NPZ = "npz"
    NPY = "npy"
    CSV = "csv"
    JSON = "json"
    PARQUET = "parquet"
    HDF5 = "hdf5"
    MANISKILL = "maniskill"
    KINEBENCH = "kinebench"
    LEROBOT = "lerobot"


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectorySample(Sample):
    """One trajectory and its metadata."""

    format: TrajectoryFormat
    part: str | None = None
    """Part of the file: group of a ManiSkill file, number of the episode of a dataset."""
    about: tuple[Path, ...] = ()
    """Further files on which its content depends."""
    rate_hz: float | None = None
    """Frames per second by the metadata of the file [Hz]; None if the file has times."""
    robot: str | None = None
    """Name of the robot by the metadata of the file."""
    alike: tuple["TrajectorySample", ...] = ()
    """Some trajectories of its file or dataset, which share one reading; empty if it is alone."""
    warnings: tuple[str, ...] = ()
    """Warnings for the user."""


def require_numbers(name: str, array: NDArray[np.generic]) -> Array:
    """Return the array in double precision.

    Raises:
        InputError: it does not hold real numbers.
    """
    if array.dtype.kind not in "iuf":
        raise InputError(f"{name} holds {array.dtype}, expected real numbers")
    return np.asarray(array, dtype=np.float64)


def parse_number(text: str) -> float:
    """Return the number that a table states; unlike Python's own, neither underscores nor other digits than 0 to 9.

    Raises:
        ValueError: the text is no number.
    """
    if not text.isascii() or "_" in text:
        raise ValueError(f"{text!r} is no number")
    return float(text)


def first_index(bad: ArrayLike) -> int | None:
    """Return the first place of a fault in a mask; None if there is none."""
    return int(np.argmax(bad)) if np.any(bad) else None


def others_text(bad: NDArray[np.bool_]) -> str:
    """Return " (and at N more places)" for a mask of faults of which one is reported."""
    count = int(bad.sum()) - 1
    return f" (and at {count} more places)" if count else ""
