"""Reading of a trajectory: which numbers of its file mean what, in which units and frames."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, field_validator
from scipy.spatial.transform import Rotation

from kinebench_drake.errors import InputError, UsageError, count_noun, suggestion
from kinebench_drake.formats.samples import MAX_PERIOD_S, MIN_PERIOD_S
from kinebench_drake.formats.trajectories.check import REPAIRABLE, ROUNDING, repairable_deviation
from kinebench_drake.formats.trajectories.recorder import find_empty, find_held
from kinebench_drake.formats.trajectories.trajectory import (
    N_JOINTS,
    PANDA_JOINTS,
    ColumnTable,
    RawTrajectory,
    first_index,
)
from kinebench_drake.geometry import Array, from_quaternion, make_pose, rotation_z
from kinebench_drake.io.jsonl import Json, as_number, as_object, read_object
from kinebench_drake.track import MAX_WIDTH_M

JOINTS = "joints"
EULER = tuple(f"euler_{''.join(order)}" for axes in ("xyz", "XYZ") for order in permutations(axes))
"""Angles about fixed axes (small letters) or moving ones (capitals), in the order of the numbers."""
LAYOUTS: Mapping[str, tuple[int, ...]] = {
    JOINTS: (0, 1, 2),
    **dict.fromkeys(("quaternion_wxyz", "quaternion_xyzw"), (7,)),
    **dict.fromkeys(("rotation_vector", *EULER), (6,)),
    **dict.fromkeys(("matrix_rows", "matrix_columns"), (16, 12)),
    **dict.fromkeys(("rotation_6d_rows", "rotation_6d_columns"), (9,)),
}
"""Possible counts of numbers per frame by layout: x y z and a rotation, or a 4x4 matrix; beside those of the joints."""


def layout_sizes(layout: str, joints: int) -> tuple[int, ...]:
    """Return the possible counts of numbers per frame of a layout, for an arm with so many joints."""
    sizes = LAYOUTS[layout]
    return tuple(joints + size for size in sizes) if layout == JOINTS else sizes


LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
ANGLES = {"rad": 1.0, "deg": float(np.pi / 180.0)}
PERCENT = "percent"
"""Unit of angles from -100 to 100 at the ends of a joint's range, as LeRobot records small arms."""
_COUNTS = 4095.0  # of a turn, in LeRobot's calibration of servos
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}

_HAND_FROM_TCP = make_pose(np.eye(3), [0.0, 0.0, 0.1034])
TOOLS = {
    "tcp": np.eye(4),
    "hand": _HAND_FROM_TCP,
    "flange": make_pose(rotation_z(-np.pi / 4), np.zeros(3)) @ _HAND_FROM_TCP,
}
"""Pose (4, 4) of the TCP in the frames of the Panda whose poses are recorded [m].

Source: F_T_EE of the Franka Hand, in Franka's documentation of the robot's end effector.
"""
DEFAULTS: Mapping[str, Json] = {
    **{"length": "m", "angle": "rad", "time_unit": "s", "tool": "tcp", "deltas": False},
    "base_from_world": [0.0, 0.0, 0.0],
    "offset": None,
}
"""Values of keys that are not set and do not follow from names."""
START_Q = np.pi * np.array([0.0, 1 / 8, 0.0, -5 / 8, 0.0, 3 / 4, 1 / 4])
_EPOCH_S = 1e11  # absolute times are larger in any unit smaller than seconds, and smaller in seconds


SIDES = ("left", "right")
"""Arms of a pair."""


def _as_tuple(value: object) -> object:
    return (value,) if isinstance(value, str) else tuple(value) if isinstance(value, list) else value


_Number = Annotated[float, Field(allow_inf_nan=False)]
_Numbers = Annotated[tuple[_Number, ...], BeforeValidator(_as_tuple)]


class Reading(BaseModel):
    """Keys of a reading file, all optional: what is absent follows from the names in the trajectory's file."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    columns: Annotated[tuple[str, ...], BeforeValidator(_as_tuple)] | None = None
    """Numbers of a frame: columns, parts of them (`observation.state[0:7]`) or names of numbers, in order."""
    layout: str | None = None
    """Meaning of these numbers, one of LAYOUTS."""
    arm: str | None = None
    """Text in the names of one arm's numbers, where there are several arms."""
    arms: Mapping[str, _Numbers | str] | None = None
    """Two arms in a row: for each the pose of its base in a common frame, x y z [m] and a quaternion wxyz if it is
    turned, or the link of its TCP in a description of both."""
    length: Literal["m", "cm", "mm"] | None = None
    angle: Literal["rad", "deg", "percent"] | None = None
    signs: _Numbers | None = None
    """1 or -1 for each joint: the direction in which it is counted."""
    calibration: _Numbers | None = None
    """Half of each joint's range [rad], to which 100 percent are; or the calibration file of LeRobot."""
    time: str | None = None
    """Column of the times."""
    time_unit: Literal["s", "ms", "us", "ns"] | None = None
    width: str | None = None
    """Number with the gap between the finger pads, in the unit of `length`."""
    width_range: Annotated[_Numbers, Field(min_length=2, max_length=2)] | None = None
    """Values of that number where the gripper is closed and where it is open, such as 0 and 100."""
    fingers: Annotated[tuple[str, ...], BeforeValidator(_as_tuple)] | None = None
    """Finger joints, each half of that gap."""
    base_from_world: _Numbers | None = None
    """Pose of the frame of the numbers in the robot's base: x y z [m], and a quaternion wxyz if it is turned."""
    tool: Literal["tcp", "hand", "flange"] | _Numbers | None = None
    """Frame whose poses are recorded, or the pose of the TCP in it: x y z [m] and a quaternion wxyz."""
    deltas: bool | None = None
    """True for changes from frame to frame, added up from `start`."""
    start: tuple[_Number, ...] | str | None = None
    """Start of deltas: joint angles [rad], or x y z [m] with a quaternion wxyz; or the column with the first state."""
    offset: _Numbers | None = None
    """Posture from which joint angles are stored as offsets: joint angles [rad]."""
    robot: str | None = None
    """Robot that the numbers are of, where the file names another one."""

    @field_validator("layout")
    @classmethod
    def _check_layout(cls, layout: str | None) -> str | None:
        if layout is not None and layout not in LAYOUTS:
            raise ValueError(f"is {layout!r}{suggestion(layout, LAYOUTS)}, expected {', '.join(LAYOUTS)}")
        return layout

    @field_validator("base_from_world", "tool")
    @classmethod
    def _check_pose(cls, value: object) -> object:
        if isinstance(value, tuple) and len(value) not in (3, 7):
            raise ValueError(f"has {len(value)} numbers, expected 7 (or x y z)")
        return value

    @field_validator("arms")
    @classmethod
    def _check_arms(cls, arms: Mapping[str, tuple[float, ...] | str] | None) -> object:
        if arms is not None and {*arms} != {*SIDES}:
            raise ValueError(f"has {', '.join(arms) or 'no arm'}, expected left and right")
        for place in () if arms is None else arms.values():
            cls._check_pose(place)
        return arms

    @classmethod
    def parse(cls, source: Path | Mapping[str, object]) -> "Reading":
        """Read the keys of a reading file, or of the output of the command `reading`.

        Raises:
            UsageError: there is no such file, or a key is invalid.
        """
        name = f"$reading {source}" if isinstance(source, Path) else "$reading"
        try:
            data = read_object(source) if isinstance(source, Path) else source
            keys = data.get("reading", data)
            if isinstance(keys, Mapping) and isinstance(keys.get("calibration"), str):
                folder = source.parent if isinstance(source, Path) else Path()
                keys = {**keys, "calibration": _read_calibration(folder / str(keys["calibration"]))}
            return cls.model_validate(keys)
        except FileNotFoundError:
            raise UsageError(f"{name}: there is no such file") from None
        except InputError as error:
            raise UsageError(f"$reading {error}") from None
        except ValidationError as error:
            first = error.errors(include_url=False, include_context=False)[0]
            key = str(first["loc"][0])
            text = first["msg"].removeprefix("Value error, ")
            if first["type"] == "extra_forbidden":
                text = f"is no key{suggestion(key, cls.model_fields)}; there are {', '.join(cls.model_fields)}"
            raise UsageError(f"{name}: {key} {text}") from None

    def to_json(self) -> dict[str, Json]:
        """Return the keys that are set."""
        return self.model_dump(mode="json", exclude_none=True)

    def keys(self, names: Iterable[str]) -> dict[str, Json]:
        """Return some keys with their values, or the defaults of those that are not set."""
        values = self.to_json()
        return {name: values.get(name, DEFAULTS.get(name)) for name in names}

    def change(self, **values: object) -> "Reading":
        """Return a reading with other values."""
        return self.model_copy(update=values)

    def describe(self) -> str:
        """Return columns and layout for results."""
        return f"{', '.join(self.columns or ())}: {self.layout}"

    def apply(self, table: ColumnTable) -> RawTrajectory:
        """Return the trajectory that a table holds; `columns` and `layout` are set.

        Raises:
            InputError: the columns do not fit the layout, or hold no rotations, or a key has not as many numbers as
                the arm has joints.
        """
        names = self.columns or ()
        layout = self.layout or JOINTS
        joints = len(table.joints)
        values = table.numbers(names)
        if values.shape[1] not in layout_sizes(layout, joints):
            expected = " or ".join(map(str, layout_sizes(layout, joints)))
            raise InputError(f"{', '.join(names)}: {values.shape[1]} numbers per frame, {layout} has {expected}")
        tracked = table.array("tracked")
        repairs: tuple[str, ...] = ()
        repeats = None
        if not self.deltas:
            numbers = np.nan_to_num(values)
            repeats = find_held(numbers)
            empty = find_empty(numbers)
            if empty.any():
                repairs += (f"{count_noun(int(empty.sum()), 'row')} of zeros: taken as not measured",)
                tracked = ~empty if tracked is None else np.where(empty, False, tracked)
                values = np.where(empty[:, None], np.nan, values)
        length = LENGTHS[self.length or "m"]
        gap = None
        if self.width is not None:
            gap = length * table.numbers([self.width])[:, 0]
            if self.width_range is not None:
                closed, opened = self.width_range
                gap = MAX_WIDTH_M * (table.numbers([self.width])[:, 0] - closed) / (opened - closed)
        elif self.fingers:
            gap = np.asarray(2.0 * length * table.numbers(self.fingers).mean(axis=1))
        q = X_BG = None
        if layout == JOINTS:
            if gap is None and values.shape[1] == joints + 2:
                gap = values[:, joints:].sum(axis=1)
            scale = self._scale(joints)
            q = values[:, :joints] * scale + np.array(self.offset or 0.0)
            if self.deltas:
                start = self.start or (tuple(START_Q) if joints == N_JOINTS else ())
                if isinstance(start, str):
                    start = tuple(table.numbers([start])[0, :joints] * scale + np.array(self.offset or 0.0))
                self._check_length("start", start, joints)
                q = np.cumsum(np.vstack([start, q[:-1]]), axis=0)[: len(q)]
        else:
            X_WT, repaired = self._poses(values, layout)
            repairs += repaired
            tool = TOOLS[self.tool] if isinstance(self.tool, str) else pose_of(self.tool)
            X_BG = np.asarray(pose_of(self.base_from_world) @ X_WT @ tool)
        return RawTrajectory(
            t_s=self._times(table),
            X_BG=X_BG,
            q=q,
            joints=joints,
            tracked=tracked,
            finger_width_m=gap,
            repeats=repeats,
            columns=self.describe(),
            warnings=repairs,
        )

    def _scale(self, joints: int) -> Array:
        """Return the factors (joints,) from recorded numbers to angles [rad]."""
        for key in ("offset", "signs", "calibration"):
            self._check_length(key, getattr(self, key), joints)
        if self.angle == PERCENT and self.calibration is None:
            raise InputError(
                "angles in percent of a joint's range need its calibration: $reading FILE with "
                '{"angle": "percent", "calibration": FILE}, the file of LeRobot\'s calibrate'
            )
        unit = np.array(self.calibration) / 100.0 if self.angle == PERCENT else ANGLES[self.angle or "rad"]
        return np.asarray(unit * np.array(self.signs or (1.0,) * joints))

    @staticmethod
    def _check_length(key: str, numbers: tuple[float, ...] | None, joints: int) -> None:
        if numbers is not None and len(numbers) != joints:
            raise InputError(f"$reading: {key} has {len(numbers)} numbers, expected one for each of {joints} joints")

    def _poses(self, values: Array, layout: str) -> tuple[Array, tuple[str, ...]]:
        """Return the recorded poses (T, 4, 4) [m], and messages about repairs."""
        length = LENGTHS[self.length or "m"]
        repairs = tuple[str, ...]()
        if values.shape[1] == 16:
            X = values.reshape(-1, 4, 4)
            X = np.array(np.swapaxes(X, -1, -2) if layout == "matrix_columns" else X)
            X[:, :3, 3] *= length
        else:
            repairable = repairable_deviation(values)
            R, repairs = rotations_of(layout, values[:, 3:], ANGLES[self.angle or "rad"], repairable)
            X = make_pose(R, length * values[:, :3])
        if not self.deltas:
            return X, repairs
        # Assumed start of deltas: joint angles [rad], and x y z [m] with a quaternion wxyz.
        total = [pose_of(self.start if isinstance(self.start, tuple) else (0.5, 0.0, 0.3, 0.0, 1.0, 0.0, 0.0))]
        for step in X[:-1]:  # rotations about the axes of the base, as positions
            total.append(make_pose(step[:3, :3] @ total[-1][:3, :3], step[:3, 3] + total[-1][:3, 3]))
        return np.stack(total[: len(X)]), repairs

    def _times(self, table: ColumnTable) -> NDArray[np.generic] | None:
        if self.time is None:
            rows = len(table.numbers(self.columns or ()))
            return table.t_s if table.t_s is not None or not table.rate_hz else np.arange(rows) / table.rate_hz
        stamps = table.numbers([self.time])[:, 0]
        if (beside := nanoseconds_beside(table, self.time)) is not None:
            nanos = table.numbers([beside])[:, 0]
            if (stamps == stamps.round()).all() and ((nanos >= 0.0) & (nanos < 1e9)).all():
                return np.asarray(stamps - stamps[:1] + TIMES["ns"] * nanos)
        unit = self.time_unit
        if unit is None:  # times since 1970 show their unit
            first = abs(float(stamps[0])) if len(stamps) else 0.0
            unit = (
                "ns"
                if first > 1e6 * _EPOCH_S
                else "us"
                if first > 1e3 * _EPOCH_S
                else "ms"
                if first > _EPOCH_S
                else "s"
            )
        since = stamps - stamps[0] if unit != "s" and len(stamps) else stamps
        return since * TIMES[unit]


@np.errstate(over="ignore", invalid="ignore")
def rotations_of(
    layout: str, numbers: Array, angle_rad: float, repairable: float = REPAIRABLE
) -> tuple[Array, tuple[str, ...]]:
    """Return rotation matrices (T, 3, 3), NaN where a number is not finite, and messages about repairs.

    Args:
        layout: one of `LAYOUTS` with a rotation.
        numbers: (T, n) numbers of the rotations.
        angle_rad: unit of angles [rad].
        repairable: greatest deviation of a quaternion's norm from 1 that is repaired.
    """
    R = np.full((len(numbers), 3, 3), np.nan)
    finite = np.isfinite(numbers).all(axis=-1)
    frames = np.flatnonzero(finite)
    own = numbers[finite]
    repairs = tuple[str, ...]()
    if layout.startswith("quaternion"):
        repairs = _check_norms(own, frames, repairable)
        R[finite] = Rotation.from_quat(own, scalar_first=layout == "quaternion_wxyz").as_matrix()
    elif layout.startswith("matrix"):
        rows = own.reshape(-1, 3, 3)
        R[finite] = rows if layout == "matrix_rows" else np.swapaxes(rows, -1, -2)
    elif layout.startswith("rotation_6d"):
        # Two axes, made orthonormal; Y. Zhou et al., CVPR 2019.
        x = own[:, :3] / np.linalg.norm(own[:, :3], axis=-1, keepdims=True)
        y = own[:, 3:] - np.sum(x * own[:, 3:], axis=-1, keepdims=True) * x
        y /= np.linalg.norm(y, axis=-1, keepdims=True)
        axes = np.stack([x, y, np.cross(x, y)], axis=-2)
        R[finite] = axes if layout == "rotation_6d_rows" else np.swapaxes(axes, -1, -2)
    else:
        own = own * angle_rad
        largest = np.abs(own).max(axis=-1, initial=0.0)
        if (largest > 2.0 * np.pi + 1e-3).any():
            k = int(np.argmax(largest))
            raise InputError(
                f"rotations go up to {largest[k]:.4g} (frame {frames[k]}), more than a full turn in radians: they look "
                "like degrees, convert them to radians"
            )
        is_vector = layout == "rotation_vector"
        turns = Rotation.from_rotvec(own) if is_vector else Rotation.from_euler(layout.removeprefix("euler_"), own)
        R[finite] = turns.as_matrix()
    return R, repairs


def _check_norms(quaternions: Array, frames: NDArray[np.intp], repairable: float) -> tuple[str, ...]:
    deviation = np.abs(np.linalg.norm(quaternions, axis=-1) - 1.0)
    if (k := first_index(~(deviation <= repairable))) is not None:
        raise InputError(
            f"the quaternion of frame {frames[k]} has norm {np.linalg.norm(quaternions[k]):.4g}, expected 1; at most "
            f"{repairable:g} is repaired"
        )
    repaired = int((deviation > ROUNDING).sum())
    message = f"{repaired} quaternions, off by up to {deviation.max(initial=0.0):.1e}, were normalized"
    return (message,) if repaired else ()


def _read_calibration(path: Path) -> list[float]:
    """Return half of each joint's range [rad] from a calibration file of LeRobot, the gripper left out.

    Raises:
        InputError: the file is no such calibration.
    """
    halves = []
    for name, about in read_object(path).items():
        ends = [as_number(as_object(about).get(key)) for key in ("range_min", "range_max")]
        if None in ends:
            raise InputError(f"calibration {path.name}: {name} has no range_min and range_max, as LeRobot writes them")
        if "gripper" not in name:
            halves.append(np.pi * (float(ends[1] or 0.0) - float(ends[0] or 0.0)) / _COUNTS)
    return halves


def pose_of(numbers: tuple[float, ...] | None) -> Array:
    """Return the pose (4, 4) of x y z [m], and a quaternion wxyz if there is one."""
    if numbers is None:
        return np.eye(4)
    return from_quaternion(numbers[3:], numbers[:3]) if len(numbers) == 7 else make_pose(np.eye(3), numbers)


_SECONDS = re.compile(r"(?P<stem>|.*[^a-z])(?:secs?|seconds)")
_NANOSECONDS = ("nsec", "nsecs", "nanos", "nanosec", "nanosecs", "nanoseconds")


def nanoseconds_beside(table: ColumnTable, name: str) -> str | None:
    """Return the column of nanoseconds that belongs to a column of whole seconds, by their names; None without one."""
    match = _SECONDS.fullmatch(name.lower())
    names = {match["stem"] + word for word in _NANOSECONDS} if match else set()
    return next((c.name for c in table.columns if c.size == 1 and c.name.lower() in names), None)


def frame_of(X_BG: Array, position_m: tuple[float, float, float]) -> tuple[float, ...]:
    """Return `base_from_world` that brings the middle of the poses (T, 4, 4) to a position in the base [m]."""
    p = X_BG[:, :3, 3]
    return tuple(np.round(position_m - 0.5 * (np.nanmin(p, axis=0) + np.nanmax(p, axis=0)), 3).tolist())


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryOptions:
    """Options of the user that override the content of a file."""

    rate_hz: float | None = None
    """Frames per second, overriding the times of the file [Hz]."""
    reading: Reading | None = None
    """How to read the file; None: by its names, and no verdict where these are doubtful."""
    joints: tuple[str, ...] = PANDA_JOINTS
    """Names of the arm's joints, base first."""

    def __post_init__(self) -> None:
        """Check the rate.

        Raises:
            UsageError: it is out of range.
        """
        if self.rate_hz is not None and not 1.0 / MAX_PERIOD_S <= self.rate_hz <= 1.0 / MIN_PERIOD_S:
            raise UsageError(
                f"$rate_hz is {self.rate_hz}, expected frames per second from {1.0 / MAX_PERIOD_S:g} to "
                f"{1.0 / MIN_PERIOD_S:g}, such as 20"
            )
