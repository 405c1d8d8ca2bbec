"""Trajectories: as stored in a file, as validated for judging, and as samples before reading."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.formats.samples import Sample
from kinebench_drake.geometry import Array

N_JOINTS = 7
"""Joints of the Panda."""
PANDA_JOINTS = tuple(f"joint_{k}" for k in range(1, N_JOINTS + 1))
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
    """(T, J) joint angles [rad], (T, J + 1) or (T, J + 2) with finger joints after them; None if there is `X_BG`."""
    joints: int = N_JOINTS
    """Number J of joints of the arm."""
    tracked: NDArray[np.generic] | None = None
    """(T,) True for valid frames; None for all."""
    finger_width_m: NDArray[np.generic] | None = None
    """(T,) gap between the finger pads [m]; None if unknown."""
    repeats: NDArray[np.bool_] | None = None
    """(T,) True for rows that repeat a state which the recorder held; None for none."""
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
    """(T, J) joint angles [rad], judged unchanged; NaN where not tracked."""
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
        shapes = {
            "t_s": (n,),
            "X_BG": (n, 4, 4),
            "q": (n,) if self.q is None else (n, *self.q.shape[1:2]),
            "tracked": (n,),
            "finger_width_m": (n,),
        }
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
    rows: tuple[int, int] | None = None
    """First row of its episode, and the row after its last, in a file of several; None for all."""
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


_REFERENCE = re.compile(r"(?P<column>.+?)\[(?P<first>\d*)(?P<slice>:?)(?P<end>\d*)\]")


@dataclass(frozen=True, slots=True, kw_only=True)
class NumberColumn:
    """Numbers of each frame under one name."""

    name: str
    size: int
    """Numbers per frame; a 4x4 matrix counts 16."""
    names: tuple[str, ...] = ()
    """Names of the numbers; empty if they are missing."""

    def describe(self) -> str:
        """Return name and numbers for a message."""
        if self.size == 1 and not self.names:
            return self.name
        first = ", ".join(self.names[:9]) + (", ..." if self.size > 9 else "")
        return f"{self.name} ({first if self.names else self.size})"


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnTable:
    """Columns of one trajectory; valid while its file is open."""

    columns: tuple[NumberColumn, ...]
    load: Callable[[str], NDArray[np.generic]]
    """Returns the values (T, ...) of a column."""
    t_s: NDArray[np.generic] | None = None
    """(T,) times that the format defines [s]; None if they are in a column, or follow from `rate_hz`."""
    rate_hz: float | None = None
    """Frames per second by the metadata [Hz]."""
    optional: frozenset[str] = frozenset()
    """Columns that are read only if the user names them: commands, velocities, computed values."""
    joints: tuple[str, ...] = PANDA_JOINTS
    """Names of the joints of the arm, base first."""

    def numbers(self, references: Sequence[str]) -> Array:
        """Return the numbers (T, n) that `references` name, in their order.

        Raises:
            InputError: a reference fits nothing or several columns, or a column holds no real numbers.
        """
        parts = [self._part(reference) for reference in references]
        lengths = {len(part) for part in parts}
        if len(lengths) > 1:
            raise InputError(f"{', '.join(references)} have {' and '.join(map(str, sorted(lengths)))} rows")
        return np.concatenate(parts, axis=1)

    def size(self, references: Sequence[str]) -> int:
        """Return how many numbers per frame `references` name."""
        return sum(len(self._indices(reference)[1]) for reference in references)

    def actions(self, references: Sequence[str]) -> Array | None:
        """Return the actions (T, n) for the numbers that `references` name; None without one column of actions alike.

        Raises:
            InputError: as for `numbers`.
        """
        places = [self._indices(reference) for reference in references]
        columns = [c for c in self.columns if re.split(r"[./]", c.name)[-1] in ("action", "actions")]
        if len(columns) != 1 or any(c.size != columns[0].size or c is columns[0] for c, _ in places):
            return None
        return self._part(columns[0].name)[:, [index for _, indices in places for index in indices]]

    def array(self, name: str) -> NDArray[np.generic] | None:
        """Return the values of a column as stored; None if there is no such column."""
        return self.load(name) if any(column.name == name for column in self.columns) else None

    def describe(self) -> str:
        """Return the columns for a message."""
        texts = [column.describe() for column in self.columns]
        return "; ".join(texts[:12]) + ("; ..." if len(texts) > 12 else "") if texts else "no column of numbers"

    def _part(self, reference: str) -> Array:
        column, indices = self._indices(reference)
        values = require_numbers(column.name, self.load(column.name))
        if len(values) > MAX_FRAMES:
            raise InputError(f"has {len(values)} frames, at most {MAX_FRAMES} are accepted: cut it into parts")
        rows = values.reshape(len(values), int(np.prod(values.shape[1:])))
        if max(indices, default=-1) >= rows.shape[1]:
            raise InputError(f"{column.name} holds {rows.shape[1]} numbers per frame, {column.size} are described")
        return rows[:, indices]

    def _indices(self, reference: str) -> tuple[NumberColumn, list[int]]:
        """Return column and numbers of a reference: `NAME`, `NAME[3]`, `NAME[0:7]`, or the name of one number."""
        for column in self.columns:
            if column.name == reference:
                return column, list(range(column.size))
        match = _REFERENCE.fullmatch(reference)
        for column in self.columns:
            if match and column.name == match["column"]:
                first = int(match["first"] or 0)
                end = int(match["end"] or column.size) if match["slice"] else first + 1
                if not first < end <= column.size:
                    raise InputError(f"{reference}: {column.name} holds {column.size} numbers per frame")
                return column, list(range(first, end))
        own = [(c, [c.names.index(reference)]) for c in self.columns if reference in c.names]
        own = [place for place in own if place[0].name not in self.optional] or own
        if len(own) != 1:
            where = f"is in {', '.join(c.name for c, _ in own)}" if own else "is no column and no number"
            raise InputError(f"{reference!r} {where}; found {self.describe()}")
        return own[0]


def reference(column: NumberColumn, indices: Sequence[int]) -> list[str]:
    """Return references to some numbers of a column, in their order, runs of consecutive ones as one."""
    if list(indices) == list(range(column.size)):
        return [column.name]
    runs: list[list[int]] = []
    for index in indices:
        if runs and index == runs[-1][-1] + 1:
            runs[-1].append(index)
        else:
            runs.append([index])
    return [f"{column.name}[{run[0]}:{run[-1] + 1}]" if len(run) > 1 else f"{column.name}[{run[0]}]" for run in runs]
