"""Choice of the column of a LeRobot dataset with joint angles or gripper poses, by the names of its elements."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from kinebench_drake.errors import InputError
from kinebench_drake.formats.trajectories.reading import Layout, Reading
from kinebench_drake.formats.trajectories.trajectory import JOINT_SIZES, N_JOINTS, TrajectoryOptions
from kinebench_drake.io.jsonl import as_object

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
    *("error", "errors"),
}
_JOINT_WORDS, _POSITION_WORDS = {"joint", "joints"}, {"pos", "position", "positions", "state", "angle", "angles"}
_NO_NUMBERS = ("video", "image", "string", "bool")
_ROTATIONS = (
    (Layout.QUATERNION, ("qw", "qx", "qy", "qz")),
    (Layout.QUATERNION, ("rw", "rx", "ry", "rz")),  # without rw it may be a rotation vector, or angles
    (Layout.ROLL_PITCH_YAW, ("roll", "pitch", "yaw")),
    (Layout.ROTATION_VECTOR, ("v0", "v1", "v2")),
    (Layout.ROTATION_VECTOR, ("v1", "v2", "v3")),
)
"""Roles of the numbers of a rotation, by what they are; the first that are all there."""
_INDEX_COLUMNS = ("timestamp", "frame_index", "episode_index", "index", "task_index")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Column:
    """Column of number lists."""

    name: str
    size: int
    names: Sequence[str] = ()
    """Names of the numbers; empty if they are missing."""

    @classmethod
    def of_feature(cls, name: str, feature: object) -> "_Column | None":
        """Return the column of an entry of meta/info.json; None if its rows are no flat lists of numbers."""
        about = as_object(feature)
        shape = about.get("shape")
        if about.get("dtype") in _NO_NUMBERS or not isinstance(shape, list) or len(shape) != 1:
            return None
        if not isinstance(shape[0], int):
            return None
        names = list(_flat(about.get("names")))
        whole = len(names) == shape[0] and all(isinstance(n, str) for n in names)
        return cls(name=name, size=shape[0], names=names if whole else ())

    def reading(self, layout: Layout, indices: Sequence[int], warnings: tuple[str, ...] = ()) -> Reading:
        """Return the reading of some of the numbers, and of the gripper where names determine the unit."""
        lower = [name.lower() for name in self.names]
        fingers = tuple(k for k, name in enumerate(lower) if _FINGER.fullmatch(name))
        widths = [k for k, name in enumerate(lower) if _WIDTH.fullmatch(name)]
        chosen = [self.names[k] for k in indices] if self.names else [f"0:{len(indices)}"]
        several = self.names and layout is Layout.JOINTS
        elements = f"{chosen[0]} .. {chosen[-1]}" if several else ", ".join(chosen)
        return Reading(
            column=self.name,
            layout=layout,
            indices=tuple(indices),
            fingers=fingers if len(fingers) <= 2 else (),
            width=widths[0] if len(widths) == 1 else None,
            description=f"{self.name}[{elements}]: {layout.value}",
            warnings=warnings,
        )

    def describe(self) -> str:
        """Return name and numbers for a message."""
        first = ", ".join(self.names[:9]) + (", ..." if self.size > 9 else "")
        return f"{self.name} ({first if self.names else self.size})"


def find_columns(features: Mapping[str, object], choice: TrajectoryOptions) -> Reading:
    """Return the reading of the column that `choice` names, else of joint angles, else of poses; of no commands.

    `features` is that of meta/info.json.

    Raises:
        InputError: no column fits, or the named one does not; the message lists the columns.
    """
    columns = [c for name, feature in features.items() if (c := _Column.of_feature(name, feature)) is not None]
    texts = [column.describe() for column in columns if column.name not in _INDEX_COLUMNS]
    content = "; ".join(texts[:8]) or "no column of numbers"
    name = choice.joints or choice.poses
    if name is not None:
        named = next((column for column in columns if column.name == name), None)
        if named is None:
            raise InputError(f"has no column {name!r} of numbers; found {content}")
        return _match_named(named, joints=choice.joints is not None)
    observed = [c for c in columns if not (_OTHER_WORDS | {"action", "actions"}) & set(_words(c.name))]
    observed.sort(key=lambda column: column.name != "observation.state")
    for find in (_match_joints, _match_pose):
        for column in observed:
            reading = find(column)
            if reading is not None:
                return reading
    raise InputError(
        f"no column is known to hold seven joint angles or a pose; found {content}; name one "
        "by $joints COLUMN (7 to 9 numbers, radians) or $poses COLUMN (x y z qw qx qy qz, or a 4x4 matrix by rows)"
    )


def _match_named(column: _Column, *, joints: bool) -> Reading:
    """Match the column that the user names, which may have any names of its elements."""
    reading = _match_joints(column) if joints else _match_pose(column)
    if reading is not None:
        return reading
    if joints and column.size in JOINT_SIZES:
        return column.reading(Layout.JOINTS, range(N_JOINTS))
    unnamed = replace(column, names=())
    if not joints and column.size == 7:
        assumption = f"{column.name} does not name its elements: x y z qw qx qy qz is assumed"
        return unnamed.reading(Layout.QUATERNION, range(7), (assumption,))
    if not joints and column.size == 16:
        return unnamed.reading(Layout.MATRIX, range(16))
    content = ", ".join(column.names) or f"{column.size} unnamed numbers"
    wanted = "7 to 9 joint angles" if joints else "x y z with a quaternion, roll pitch yaw or a rotation vector"
    raise InputError(f"column {column.name!r} holds {content}, expected {wanted}")


def _match_joints(column: _Column) -> Reading | None:
    """Match seven joint angles: consecutively numbered elements of one arm, or a column with such a name."""
    if not column.names:
        words = set(_words(column.name.rsplit(".", 1)[-1]))
        certain = "qpos" in words or (words & _JOINT_WORDS and words & _POSITION_WORDS)
        return column.reading(Layout.JOINTS, range(N_JOINTS)) if certain and column.size in JOINT_SIZES else None
    arms: dict[str, dict[int, int]] = {}
    for k, element in enumerate(column.names):
        match = _NUMBERED.fullmatch(element.lower())
        if match and not _FINGER.fullmatch(element.lower()) and not _OTHER_WORDS & set(_words(match["arm"])):
            arms.setdefault(match["arm"], {})[int(match["number"])] = k
    whole = [arm for arm in arms.values() if len(arm) == N_JOINTS and max(arm) - min(arm) == N_JOINTS - 1]
    return column.reading(Layout.JOINTS, [k for _, k in sorted(whole[0].items())]) if len(whole) == 1 else None


def _match_pose(column: _Column) -> Reading | None:
    """Match a pose whose names determine the kind of rotation."""
    if not column.names:
        certain = column.size == 16 and "pose" in _words(column.name)
        return column.reading(Layout.MATRIX, range(16)) if certain else None
    roles: dict[str, list[int]] = {}
    for k, element in enumerate(column.names):
        roles.setdefault(_role(element.lower()), []).append(k)
    for layout, rotation in _ROTATIONS:
        if layout is Layout.ROTATION_VECTOR and {"v0", "v3"} <= roles.keys():
            continue  # a rotation vector has three numbers
        wanted = ("x", "y", "z", *rotation)
        if all(len(roles.get(role, ())) == 1 for role in wanted):
            return column.reading(layout, [roles[role][0] for role in wanted])
    return None


def _role(element: str) -> str:
    """Return the role of an element of a pose by its name; "" if it is unclear."""
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


def _words(name: str) -> list[str]:
    return [word for word in re.split(r"[^a-z0-9]+", name.lower()) if word]


def _flat(names: object) -> Iterator[str]:
    if isinstance(names, Mapping):
        for value in names.values():
            yield from _flat(value)
    elif isinstance(names, list):
        yield from names
