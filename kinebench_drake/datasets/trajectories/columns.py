"""Which column of a LeRobot dataset holds the arm's joint angles or the gripper's pose, by the names it gives."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from kinebench_drake.datasets.trajectories.trajectory import N_JOINTS, TrajectoryOptions
from kinebench_drake.errors import InputError


class ColumnLayout(Enum):
    """What the numbers taken from a column are."""

    JOINTS = "joint angles"
    QUATERNION = "x y z, quaternion w x y z"
    ROLL_PITCH_YAW = "x y z, roll pitch yaw"
    ROTATION_VECTOR = "x y z, rotation vector"
    MATRIX = "4x4 matrix by rows"


@dataclass(frozen=True, slots=True, kw_only=True)
class Columns:
    """What to take from a dataset's files."""

    column: str
    """Name of the column."""
    layout: ColumnLayout
    indices: tuple[int, ...]
    """Elements of the column, in the layout's order."""
    fingers: tuple[int, ...] = ()
    """Elements of the column that are finger joints [m], each half of the gap."""
    width: int | None = None
    """Element of the column that is the gap between the pads [m]."""
    told: str
    """All of it in words."""
    warnings: tuple[str, ...] = ()


_NUMBERED = re.compile(
    r"(?P<arm>|.*[^a-z0-9])(?:joint|j|q)[_. ]?(?:pos|position|angle)?[_. ]?(?P<number>\d{1,6})"
    r"(?:[_. ](?:pos|position|angle|rad))*"
)
_FINGER = re.compile(r".*finger.*joint.*|.*joint.*finger.*")
_WIDTH = re.compile(r"(?:.*[^a-z])?(?:gripper|finger)s?[_. ]?width(?:_m)?")
_ROTATION_VECTOR = re.compile(r".*(?:axis_?angle|rot_?vec)[_. ]?(?P<axis>[xyz]|\d)")
_QUATERNION_WORDS = {"quat", "quaternion", "q", "orientation", "ori", "orn", "rot", "rotation"}
_OTHER_WORDS = {
    *("vel", "velocity", "velocities", "acc", "acceleration", "accelerations", "force", "forces", "torque", "torques"),
    *("effort", "efforts", "delta", "deltas", "target", "targets", "goal", "desired", "commanded", "command"),
}
_JOINT_WORDS, _POSITION_WORDS = {"joint", "joints"}, {"pos", "position", "positions", "state", "angle", "angles"}
_NO_NUMBERS = ("video", "image", "string", "bool")
_INDEX_COLUMNS = ("timestamp", "frame_index", "episode_index", "index", "task_index")


def find_columns(features: Mapping[str, object], choice: TrajectoryOptions) -> Columns:
    """The column to take: what `choice` names, else joint angles, else poses, of what was observed (not commanded).

    Args:
        features: `features` of the dataset's meta/info.json.
        choice: what the user says.

    Raises:
        InputError: no column fits, or the named one does not; the message names the columns found.
    """
    columns = {name: size for name, feature in features.items() if (size := _size(feature)) is not None}
    named = choice.joints or choice.poses
    if named is not None:
        if named not in columns:
            raise InputError(f"has no column {named!r} of numbers; found {_listed(features, columns)}")
        return _by_hand(named, columns[named], _names(features[named]), joints=choice.joints is not None)
    observed = [n for n in columns if not {"action", "actions"} & set(_words(n)) and not _OTHER_WORDS & set(_words(n))]
    observed.sort(key=lambda name: name != "observation.state")
    for find in (_joints, _pose):
        for name in observed:
            found = find(name, columns[name], _names(features[name]))
            if found is not None:
                return found
    raise InputError(
        f"no column is known to hold seven joint angles or a pose; found {_listed(features, columns)}; name one by "
        "--joints COLUMN (7 to 9 numbers, radians) or --poses COLUMN (x y z qw qx qy qz, or a 4x4 matrix by rows)"
    )


def _by_hand(name: str, size: int, names: Sequence[str] | None, *, joints: bool) -> Columns:
    if joints:
        found = _joints(name, size, names)
        if found is None and size in range(N_JOINTS, N_JOINTS + 3):
            return _numbered(name, range(N_JOINTS), names)
    else:
        found = _pose(name, size, names)
        if found is None and size == 7:
            told = f"{name}[0:7]: {ColumnLayout.QUATERNION.value}"
            note = f"{name} names no elements that tell a pose: x y z qw qx qy qz was assumed"
            return Columns(
                column=name, layout=ColumnLayout.QUATERNION, indices=tuple(range(7)), told=told, warnings=(note,)
            )
        if found is None and size == 16:
            told = f"{name}[0:16]: {ColumnLayout.MATRIX.value}"
            return Columns(column=name, layout=ColumnLayout.MATRIX, indices=tuple(range(16)), told=told)
    if found is None:
        held = ", ".join(names) if names else f"{size} unnamed numbers"
        wanted = "7 to 9 joint angles" if joints else "x y z with a quaternion, roll pitch yaw or a rotation vector"
        raise InputError(f"column {name!r} holds {held}, expected {wanted}")
    return found


def _joints(name: str, size: int, names: Sequence[str] | None) -> Columns | None:
    """Seven joint angles: seven consecutively numbered elements of one arm, or all of a column that is named so."""
    if names is None:
        words = set(_words(name.rsplit(".", 1)[-1]))
        sure = "qpos" in words or (words & _JOINT_WORDS and words & _POSITION_WORDS)
        return _numbered(name, range(N_JOINTS), None) if sure and size in range(N_JOINTS, N_JOINTS + 3) else None
    arms: dict[str, dict[int, int]] = {}
    for k, element in enumerate(names):
        match = _NUMBERED.fullmatch(element.lower())
        if match and not _FINGER.fullmatch(element.lower()):
            arms.setdefault(match["arm"], {})[int(match["number"])] = k
    whole = [arm for arm in arms.values() if len(arm) == N_JOINTS and max(arm) - min(arm) == N_JOINTS - 1]
    if len(whole) != 1:
        return None
    return _numbered(name, [whole[0][number] for number in sorted(whole[0])], names)


def _numbered(name: str, indices: Sequence[int], names: Sequence[str] | None) -> Columns:
    told = f"{name}[{names[indices[0]]} .. {names[indices[-1]]}]" if names else f"{name}[0:{N_JOINTS}]"
    fingers, width = _gripper(names)
    return Columns(
        column=name,
        layout=ColumnLayout.JOINTS,
        indices=tuple(indices),
        fingers=fingers,
        width=width,
        told=f"{told}: {ColumnLayout.JOINTS.value}",
    )


def _pose(name: str, size: int, names: Sequence[str] | None) -> Columns | None:
    """A pose, whose elements' names leave no doubt about the kind of rotation."""
    if names is None:
        words = set(_words(name))
        told = f"{name}[0:16]: {ColumnLayout.MATRIX.value}"
        sure = size == 16 and "pose" in words
        return Columns(column=name, layout=ColumnLayout.MATRIX, indices=tuple(range(16)), told=told) if sure else None
    roles: dict[str, list[int]] = {}
    for k, element in enumerate(names):
        roles.setdefault(_role(element.lower()), []).append(k)
    for layout, rotation in (
        (ColumnLayout.QUATERNION, ("qw", "qx", "qy", "qz")),
        (ColumnLayout.QUATERNION, ("rw", "rx", "ry", "rz")),  # without rw they may be a rotation vector, or angles
        (ColumnLayout.ROLL_PITCH_YAW, ("roll", "pitch", "yaw")),
        (ColumnLayout.ROTATION_VECTOR, ("v0", "v1", "v2")),
        (ColumnLayout.ROTATION_VECTOR, ("v1", "v2", "v3")),
    ):
        if layout is ColumnLayout.ROTATION_VECTOR and {"v0", "v3"} <= roles.keys():
            continue  # four numbers are no rotation vector
        wanted = ("x", "y", "z", *rotation)
        if all(len(roles.get(role, ())) == 1 for role in wanted):
            indices = tuple(roles[role][0] for role in wanted)
            fingers, width = _gripper(names)
            told = f"{name}[{', '.join(names[k] for k in indices)}]: {layout.value}"
            return Columns(column=name, layout=layout, indices=indices, fingers=fingers, width=width, told=told)
    return None


def _role(element: str) -> str:
    """What an element of a pose is, by its name; "" where it tells nothing."""
    words = [w for w in _words(element) if w not in ("m", "rad")]
    if not words or _OTHER_WORDS & set(words):
        return ""
    vector = _ROTATION_VECTOR.fullmatch("_".join(words))
    if vector:
        axis = vector["axis"]
        return f"v{'xyz'.index(axis)}" if axis in "xyz" else f"v{axis}"
    last, before = words[-1], set(words[:-1])
    if last in ("roll", "pitch", "yaw") or re.fullmatch(r"[qr][wxyz]", last):
        return last
    if last in ("w", "x", "y", "z"):
        return f"q{last}" if last == "w" or before & _QUATERNION_WORDS else last
    return ""


def _gripper(names: Sequence[str] | None) -> tuple[tuple[int, ...], int | None]:
    """Elements that are finger joints, and the one that is the gap, where their names leave no doubt of the unit."""
    lower = [name.lower() for name in names or ()]
    fingers = tuple(k for k, name in enumerate(lower) if _FINGER.fullmatch(name))
    widths = [k for k, name in enumerate(lower) if _WIDTH.fullmatch(name)]
    return (fingers if len(fingers) <= 2 else ()), (widths[0] if len(widths) == 1 else None)


def _words(name: str) -> list[str]:
    return [word for word in re.split(r"[^a-z0-9]+", name.lower()) if word]


def _size(feature: object) -> int | None:
    """Numbers that a row of a column holds; None of what is no flat row of numbers."""
    if not isinstance(feature, Mapping) or feature.get("dtype") in _NO_NUMBERS:
        return None
    shape = feature.get("shape")
    flat = isinstance(shape, list) and len(shape) == 1 and isinstance(shape[0], int)
    return int(shape[0]) if flat and isinstance(shape, list) else None


def _names(feature: object) -> Sequence[str] | None:
    """Names of a column's elements, one each; None where there are none."""
    given = feature.get("names") if isinstance(feature, Mapping) else None
    names = list(_flat(given))
    return names if names and len(names) == _size(feature) and all(isinstance(n, str) for n in names) else None


def _flat(names: object) -> Iterator[str]:
    if isinstance(names, Mapping):
        for value in names.values():
            yield from _flat(value)
    elif isinstance(names, list):
        yield from names


def _listed(features: Mapping[str, object], columns: Mapping[str, int]) -> str:
    told = []
    for name, size in columns.items():
        if name not in _INDEX_COLUMNS:
            names = _names(features[name])
            told.append(f"{name} ({', '.join(names[:9]) + (', ...' if size > 9 else '') if names else size})")
    return "; ".join(told[:8]) or "no column of numbers"
