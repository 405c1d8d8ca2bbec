"""Choice of the column of a LeRobot dataset with joint angles or gripper poses, by the names of its elements."""

import re
from collections.abc import Iterator, Mapping, Sequence

from kinebench_drake.errors import InputError
from kinebench_drake.formats.trajectories.reading import Layout, Reading
from kinebench_drake.formats.trajectories.trajectory import N_JOINTS, TrajectoryOptions

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
_INDEX_COLUMNS = ("timestamp", "frame_index", "episode_index", "index", "task_index")


def find_columns(features: Mapping[str, object], choice: TrajectoryOptions) -> Reading:
    """Return the column that `choice` names, else joint angles, else poses; observations, not commands.

    Args:
        features: `features` of meta/info.json.
        choice: options of the user.

    Raises:
        InputError: no column fits, or the named one does not; the message lists the columns.
    """
    columns = {name: size for name, feature in features.items() if (size := _size(feature)) is not None}
    name = choice.joints or choice.poses
    if name is not None:
        if name not in columns:
            raise InputError(f"has no column {name!r} of numbers; found {_list_columns(features, columns)}")
        return _match_named(name, columns[name], _names(features[name]), joints=choice.joints is not None)
    observed = [n for n in columns if not {"action", "actions"} & set(_words(n)) and not _OTHER_WORDS & set(_words(n))]
    observed.sort(key=lambda name: name != "observation.state")
    for find in (_match_joints, _match_pose):
        for name in observed:
            match = find(name, columns[name], _names(features[name]))
            if match is not None:
                return match
    raise InputError(
        f"no column is known to hold seven joint angles or a pose; found {_list_columns(features, columns)}; name one "
        "by $joints COLUMN (7 to 9 numbers, radians) or $poses COLUMN (x y z qw qx qy qz, or a 4x4 matrix by rows)"
    )


def _match_named(name: str, size: int, names: Sequence[str] | None, *, joints: bool) -> Reading:
    """Match the column that the user names, which may have any names of its elements."""
    match = _match_joints(name, size, names) if joints else _match_pose(name, size, names)
    if match is not None:
        return match
    if joints and size in range(N_JOINTS, N_JOINTS + 3):
        return _joint_columns(name, range(N_JOINTS), names)
    if not joints and size == 7:
        assumption = f"{name} does not name its elements: x y z qw qx qy qz is assumed"
        return _columns(name, Layout.QUATERNION, range(7), "0:7", warnings=(assumption,))
    if not joints and size == 16:
        return _columns(name, Layout.MATRIX, range(16), "0:16")
    content = ", ".join(names) if names else f"{size} unnamed numbers"
    wanted = "7 to 9 joint angles" if joints else "x y z with a quaternion, roll pitch yaw or a rotation vector"
    raise InputError(f"column {name!r} holds {content}, expected {wanted}")


def _match_joints(name: str, size: int, names: Sequence[str] | None) -> Reading | None:
    """Match seven joint angles: consecutively numbered elements of one arm, or a column with such a name."""
    if names is None:
        words = set(_words(name.rsplit(".", 1)[-1]))
        certain = "qpos" in words or (words & _JOINT_WORDS and words & _POSITION_WORDS)
        return (
            _joint_columns(name, range(N_JOINTS), None) if certain and size in range(N_JOINTS, N_JOINTS + 3) else None
        )
    arms: dict[str, dict[int, int]] = {}
    for k, element in enumerate(names):
        match = _NUMBERED.fullmatch(element.lower())
        if match and not _FINGER.fullmatch(element.lower()) and not _OTHER_WORDS & set(_words(match["arm"])):
            arms.setdefault(match["arm"], {})[int(match["number"])] = k
    whole = [arm for arm in arms.values() if len(arm) == N_JOINTS and max(arm) - min(arm) == N_JOINTS - 1]
    if len(whole) != 1:
        return None
    return _joint_columns(name, [whole[0][number] for number in sorted(whole[0])], names)


def _joint_columns(name: str, indices: Sequence[int], names: Sequence[str] | None) -> Reading:
    elements = f"{names[indices[0]]} .. {names[indices[-1]]}" if names else f"0:{N_JOINTS}"
    return _columns(name, Layout.JOINTS, indices, elements, names)


def _columns(
    name: str,
    layout: Layout,
    indices: Sequence[int],
    elements: str,
    names: Sequence[str] | None = None,
    warnings: tuple[str, ...] = (),
) -> Reading:
    fingers, width = _gripper(names)
    return Reading(
        column=name,
        layout=layout,
        indices=tuple(indices),
        fingers=fingers,
        width=width,
        description=f"{name}[{elements}]: {layout.value}",
        warnings=warnings,
    )


def _match_pose(name: str, size: int, names: Sequence[str] | None) -> Reading | None:
    """Match a pose whose names determine the kind of rotation."""
    if names is None:
        certain = size == 16 and "pose" in _words(name)
        return _columns(name, Layout.MATRIX, range(16), "0:16") if certain else None
    roles: dict[str, list[int]] = {}
    for k, element in enumerate(names):
        roles.setdefault(_role(element.lower()), []).append(k)
    for layout, rotation in (
        (Layout.QUATERNION, ("qw", "qx", "qy", "qz")),
        (Layout.QUATERNION, ("rw", "rx", "ry", "rz")),  # without rw it may be a rotation vector, or angles
        (Layout.ROLL_PITCH_YAW, ("roll", "pitch", "yaw")),
        (Layout.ROTATION_VECTOR, ("v0", "v1", "v2")),
        (Layout.ROTATION_VECTOR, ("v1", "v2", "v3")),
    ):
        if layout is Layout.ROTATION_VECTOR and {"v0", "v3"} <= roles.keys():
            continue  # a rotation vector has three numbers
        wanted = ("x", "y", "z", *rotation)
        if all(len(roles.get(role, ())) == 1 for role in wanted):
            indices = tuple(roles[role][0] for role in wanted)
            return _columns(name, layout, indices, ", ".join(names[k] for k in indices), names)
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


def _gripper(names: Sequence[str] | None) -> tuple[tuple[int, ...], int | None]:
    """Return the indices of finger joints and of the gap, if their names determine the unit."""
    lower = [name.lower() for name in names or ()]
    fingers = tuple(k for k, name in enumerate(lower) if _FINGER.fullmatch(name))
    widths = [k for k, name in enumerate(lower) if _WIDTH.fullmatch(name)]
    return (fingers if len(fingers) <= 2 else ()), (widths[0] if len(widths) == 1 else None)


def _words(name: str) -> list[str]:
    return [word for word in re.split(r"[^a-z0-9]+", name.lower()) if word]


def _size(feature: object) -> int | None:
    """Return the length of the rows of a column; None if they are no flat lists of numbers."""
    if not isinstance(feature, Mapping) or feature.get("dtype") in _NO_NUMBERS:
        return None
    shape = feature.get("shape")
    flat = isinstance(shape, list) and len(shape) == 1 and isinstance(shape[0], int)
    return int(shape[0]) if flat and isinstance(shape, list) else None


def _names(feature: object) -> Sequence[str] | None:
    """Return the names of the elements of a column; None if they are missing."""
    names = list(_flat(feature.get("names") if isinstance(feature, Mapping) else None))
    return names if names and len(names) == _size(feature) and all(isinstance(n, str) for n in names) else None


def _flat(names: object) -> Iterator[str]:
    if isinstance(names, Mapping):
        for value in names.values():
            yield from _flat(value)
    elif isinstance(names, list):
        yield from names


def _list_columns(features: Mapping[str, object], columns: Mapping[str, int]) -> str:
    texts = []
    for name, size in columns.items():
        if name not in _INDEX_COLUMNS:
            names = _names(features[name])
            texts.append(f"{name} ({', '.join(names[:9]) + (', ...' if size > 9 else '') if names else size})")
    return "; ".join(texts[:8]) or "no column of numbers"
