"""Choice of a table's columns by their names: joint angles, else poses; units, times and the gripper."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from kinebench_drake.errors import InputError
from kinebench_drake.formats.trajectories.reading import (
    JOINTS,
    LAYOUTS,
    SIDES,
    Reading,
    layout_sizes,
    nanoseconds_beside,
)
from kinebench_drake.formats.trajectories.trajectory import N_JOINTS, ColumnTable, NumberColumn, reference

_NUMBERED = re.compile(
    r"(?P<arm>|.*[^a-z0-9])(?:joint|j|q|(?:joint[_. ]?)?(?:positions?|pos|angles?))[_. ]?(?:pos|position|angle)?"
    r"[_. \[]?(?P<number>\d{1,6})\]?(?:[_. /](?:pos|position|angle|rad|deg))*"
)
_MATRIX = re.compile(r".*(?:pose|matrix|transform|o_t_ee)[_. \[]?(?P<number>\d{1,2})\]?")
_BY_COLUMNS = re.compile(r".*\bo_t_ee(_c|_d)?\b.*|o_t_ee.*|.*[./]o_t_ee.*")
"""Poses of libfranka, stored column by column."""
_FINGER = re.compile(r".*finger.*joint.*|.*joint.*finger.*")
_WIDTH = re.compile(r"(?:.*[^a-z])?(?:gripper|finger)s?[_. ]?width(?:_m)?")
_ROTATION_VECTOR = re.compile(r".*(?:axis_?angle|rot_?vec)[_. ]?(?P<axis>[xyz]|\d)")
_QUATERNION_WORDS = {"quat", "quaternion", "q", "orientation", "ori", "orn", "rot", "rotation"}
_OTHER_WORDS = {
    *("vel", "velocity", "velocities", "acc", "acceleration", "accelerations", "force", "forces", "torque", "torques"),
    *("effort", "efforts", "delta", "deltas", "target", "targets", "goal", "desired", "commanded", "command", "cmd"),
    *("error", "errors", "action", "actions", "tau", "dtau", "dq", "ddq", "current", "currents", "rel", "relative"),
    *("cos", "cosine", "cosines", "sin", "sine", "sines"),
}
"""Words in names of numbers that are neither angles nor poses, or not absolute ones."""
_TOOLS = {"tcp": "tcp", "flange": "flange"}
"""Words in names of poses that say whose they are."""
_CONTRACT = re.compile(r"(?:left_|right_)?(?:base_from_tcp|q|q[1-9]_rad|[xyz]_m|q[wxyz])")
"""Names with a documented unit and frame."""
_UNTELLING = {"joint", "pos", "position", "angle", "main", "follower", "k", "state", "observation", "qpos"}
_JOINT_WORDS = {"joint", "joints"}
_ANGLE_WORDS = {"pos", "position", "positions", "state", "states", "angle", "angles"}
_TOOL_WORDS = {"ee", "eef", "tcp", "pose", "poses", "hand", "gripper", "cartesian", "base"}
_TIME = re.compile(
    r"(?:.*[^a-z])?(?:t|times?|timestamps?|time_stamps?|stamps?|clock)(?:[_. ](?P<unit>s|secs?|seconds|ms|us|ns))?"
)
_UNITS = {"m": "m", "cm": "cm", "mm": "mm", "rad": "rad", "deg": "deg", "degrees": "deg"}
_ROTATIONS = (
    ("quaternion_wxyz", ("qw", "qx", "qy", "qz")),
    ("quaternion_wxyz", ("rw", "rx", "ry", "rz")),
    ("euler_xyz", ("roll", "pitch", "yaw")),
    ("rotation_vector", ("v0", "v1", "v2")),
    ("rotation_vector", ("v1", "v2", "v3")),
    ("rotation_vector", ("wx", "wy", "wz")),
    (None, ("rx", "ry", "rz")),  # a rotation vector, or angles
)
"""Roles of the numbers of a rotation, by layout; the first that are all there."""
_ROTATION_ARRAYS = (
    (re.compile(r".*(quat|orn|orientation).*"), 4, "quaternion_wxyz"),
    (re.compile(r".*(axis_?angle|rot_?vec|_ori).*"), 3, "rotation_vector"),
    (re.compile(r".*(rpy|euler).*"), 3, "euler_xyz"),
    (re.compile(r".*(mat|rot|ori).*"), 9, "matrix_rows"),
)
"""Arrays of rotations: names, numbers and layout."""
PROPOSAL = "; `kinebench-drake reading PATH` proposes them"
"""End of the message on columns whose names say nothing."""
_MOST_ROWS = 16
"""Readings of seven consecutive numbers that are tried."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Group:
    """Numbers of one column with names, or all single columns of a table."""

    places: tuple[tuple[NumberColumn, int], ...]
    names: tuple[str, ...]

    def references(self, indices: Sequence[int]) -> tuple[str, ...]:
        """Return references to some numbers."""
        columns = {self.places[k][0].name for k in indices}
        if len(columns) == 1:
            column = self.places[indices[0]][0]
            return tuple(reference(column, [self.places[k][1] for k in indices]))
        return tuple(self.places[k][0].name for k in indices)


def complete(table: ColumnTable, wanted: Reading) -> Reading:
    """Return a reading with columns, layout, units, times and gripper: those of `wanted`, else by their names."""
    reading = _named(table, wanted) if wanted.columns is not None else _by_names(table, wanted)
    groups = [*_groups(table, reading)]
    names = [name.lower() for group in groups for name in group.names]
    places = [group.references([k])[0] for group in groups for k in range(len(group.names))]
    if reading.width is None and reading.fingers is None:
        fingers = tuple(place for place, name in zip(places, names, strict=True) if _FINGER.fullmatch(name))
        widths = [place for place, name in zip(places, names, strict=True) if _WIDTH.fullmatch(name)]
        reading = reading.change(fingers=fingers if 0 < len(fingers) <= 2 else None)
        reading = reading.change(width=widths[0]) if len(widths) == 1 else reading
    if reading.time is None and table.t_s is None:
        reading = _with_times(table, reading)
    return _with_units(table, reading if reading.layout == JOINTS else _with_frames(reading))


def is_documented(table: ColumnTable, reading: Reading) -> bool:
    """Return True if all names of a complete reading are those that docs/formats.md defines, with units and frames."""
    columns = reading.columns or ()
    return (
        (reading.time in (None, "t_s") or nanoseconds_beside(table, str(reading.time)) is not None)
        and all(_CONTRACT.fullmatch(name) for name in columns)
        and table.size(columns) in (len(table.joints), 7, 16)
    )


def is_numbered(table: ColumnTable, reading: Reading) -> bool:
    """Return True if the names state the order of the joints."""
    whole = {column.name for column in table.columns if not column.names and column.size > 1}
    return not whole & {re.sub(r"\[[\d:]*\]$", "", name) for name in reading.columns or ()}


def find_poses(table: ColumnTable) -> Reading | None:
    """Return the reading of the poses of a table by their names; None if it has none."""
    return _find_pose(table, Reading())


def _named(table: ColumnTable, wanted: Reading) -> Reading:
    """Return the reading of named columns, with their layout where names or count determine it."""
    size = table.size(wanted.columns or ())
    if wanted.layout is not None:
        return wanted
    rest = [column for column in table.columns if column.name in (wanted.columns or ())]
    for find in (_find_joints, _find_pose):
        reading = find(replace(table, columns=tuple(rest)), wanted.change(columns=None))
        if reading is not None and table.size(reading.columns or ()) <= size <= len(table.joints) + 2:
            return reading.change(columns=wanted.columns if len(rest) == 1 and size == 16 else reading.columns)
    fitting = [name for name in LAYOUTS if size in layout_sizes(name, len(table.joints)) and "euler" not in name]
    certain = {16: "matrix_rows", 8: JOINTS}.get(size) if len(table.joints) == N_JOINTS or size == 16 else None
    if certain is None:
        expected = (
            f'"layout": one of {", ".join(fitting)}'
            if fitting
            else f"{len(table.joints)} joint angles, or x y z, rotation"
        )
        raise InputError(f"{', '.join(wanted.columns or ())}: {size} numbers per frame, expected {expected}")
    return wanted.change(layout=certain)


def _by_names(table: ColumnTable, wanted: Reading) -> Reading:
    for find in (_find_joints, _find_pose):
        reading = find(table, wanted)
        if reading is not None:
            return reading
    count = {5: "five", 6: "six", 7: "seven"}[len(table.joints)]
    numbered = {arm.strip("_./ ") for group in _groups(table, wanted) for arm in _arms(group, len(table.joints))}
    arms = sorted(numbered | _sides_of(_joint_arrays(table, wanted)))
    telling = [arm for arm in arms if _find_joints(table, wanted.change(arm=arm))]
    if len(arms) > 1 and telling:
        several = (
            f'{len(arms)} arms ({", ".join(arms)}): $reading FILE with {{"arm": "{telling[0]}"}} chooses one, one with '
            '"arms" (docs/robots.md) places both'
        )
        raise InputError(f"no column is certain to hold the {count} joint angles of one arm; there are {several}")
    raise InputError(
        f"no column is known to hold {count} joint angles or a pose; found {table.describe()}; name some in "
        f"$reading FILE{PROPOSAL}"
    )


def list_joint_rows(table: ColumnTable) -> list[Reading]:
    """Return the readings of consecutive numbers, one a joint, as angles, of those whose names say nothing else."""
    arrays = [
        _Group(places=tuple((column, k) for k in range(column.size)), names=("",) * column.size)
        for column in _arrays(table, Reading())
    ]
    readings = []
    joints = len(table.joints)
    for group in (*_groups(table, Reading()), *arrays):
        is_free = [not (_TIME.fullmatch(n.lower()) or _OTHER_WORDS & {*_words(n)} or _role(n)) for n in group.names]
        for first in range(len(is_free) - joints + 1):
            if all(is_free[first : first + joints]):
                columns = group.references(range(first, first + joints))
                readings.append(Reading(columns=columns, layout=JOINTS))
    return readings[:_MOST_ROWS]


def _groups(table: ColumnTable, wanted: Reading) -> Iterator[_Group]:
    """Yield the numbers with names that may be read, of the arm that `wanted` names."""
    arm = (wanted.arm or "").lower()
    single: list[tuple[NumberColumn, str]] = []
    for column in _allowed(table):
        if column.names:
            kept = [k for k, name in enumerate(column.names) if arm in name.lower() or arm in column.name.lower()]
            yield _Group(places=tuple((column, k) for k in kept), names=tuple(column.names[k] for k in kept))
        elif column.size == 1 and arm in column.name.lower():
            single.append((column, column.name))
    yield _Group(places=tuple((column, 0) for column, _ in single), names=tuple(name for _, name in single))


def _allowed(table: ColumnTable) -> list[NumberColumn]:
    """Return the columns that may be read without being named: no commands and no velocities."""
    return [c for c in table.columns if c.name not in table.optional and not _OTHER_WORDS & set(_words(c.name))]


def _arms(group: _Group, joints: int) -> dict[str, dict[int, int]]:
    """Return the numbered joints of each arm of a group that has as many as joints: index by number."""
    arms: dict[str, dict[int, int]] = {}
    for k, name in enumerate(group.names):
        match = _NUMBERED.fullmatch(name.lower())
        if match and not _FINGER.fullmatch(name.lower()) and not _OTHER_WORDS & set(_words(match["arm"])):
            arms.setdefault(match["arm"], {})[int(match["number"])] = k
    return {arm: n for arm, n in arms.items() if len(n) == joints and max(n) - min(n) == joints - 1}


def _by_joint_names(group: _Group, joints: Sequence[str]) -> list[int] | None:
    """Return the indices of the numbers that are called as the joints; None if one is missing or ambiguous.

    Joints that have numbers alone are found by their order.
    """
    if all(re.search(r"\d", joint) for joint in joints):
        return None
    wanted = [_telling(joint) for joint in joints]
    names = [_telling(name) for name in group.names]
    sides = {*SIDES} & {word for joint in wanted for word in joint}
    if not sides:  # of one arm, or of the one that the user names
        names = [tuple(word for word in name if word not in SIDES) for name in names]
    # joined, as some write WristYaw and Wristyaw
    places = [[k for k, name in enumerate(names) if "".join(name) == "".join(joint)] for joint in wanted]
    return [own[0] for own in places] if all(len(own) == 1 for own in places) else None


def _telling(name: str) -> tuple[str, ...]:
    """Return the words of a joint's name that tell it from others."""
    words = _words(re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name))
    return tuple(word for word in words if word not in _UNTELLING and word not in _UNITS)


def _find_joints(table: ColumnTable, wanted: Reading) -> Reading | None:
    """Find joint angles: the names of the joints, consecutively numbered ones, or an array with such a name."""
    if wanted.layout not in (None, JOINTS):
        return None
    joints = len(table.joints)
    for group in _groups(table, wanted):
        named = _by_joint_names(group, table.joints)
        if named is not None:
            return wanted.change(columns=group.references(named), layout=JOINTS)
        arms = list(_arms(group, joints).values())
        if len(arms) == 1:
            chosen = group.references([k for _, k in sorted(arms[0].items())])
            return wanted.change(columns=chosen, layout=JOINTS)
    fitting = _joint_arrays(table, wanted)
    if fitting and (wanted.arm is not None or len(_sides_of(fitting)) < len(SIDES)):
        return wanted.change(columns=(fitting[0].name,), layout=JOINTS)
    return None


def _joint_arrays(table: ColumnTable, wanted: Reading) -> list[NumberColumn]:
    """Return the arrays whose names and sizes are those of joint angles."""
    joints = len(table.joints)
    fitting = []
    for column in _arrays(table, wanted):
        words = set(_words(re.split(r"[./]", column.name)[-1]))
        is_joints = words & {"qpos", "q"} or (words & _JOINT_WORDS and words & _ANGLE_WORDS)
        if column.size - joints in LAYOUTS[JOINTS] and (is_joints or (wanted.layout and column.size == joints)):
            fitting.append(column)
    return fitting


def _sides_of(columns: Sequence[NumberColumn]) -> set[str]:
    return {*SIDES} & {word for column in columns for word in _words(column.name)}


def _find_pose(table: ColumnTable, wanted: Reading) -> Reading | None:
    """Find a pose whose names determine the kind of rotation, unless the layout is stated."""
    if wanted.layout == JOINTS:
        return None

    def found_as(columns: tuple[str, ...], layout: str | None) -> Reading | None:
        layout = wanted.layout or layout
        fits = layout is not None and table.size(columns) in layout_sizes(layout, len(table.joints))
        return wanted.change(columns=columns, layout=layout) if fits else None

    for group in _groups(table, wanted):
        roles: dict[str, list[int]] = {}
        for k, name in enumerate(group.names):
            roles.setdefault(_role(name.lower()), []).append(k)
        for layout, rotation in _ROTATIONS:
            if layout == "rotation_vector" and {"v0", "v3"} <= roles.keys():
                continue  # a rotation vector has three numbers
            names = ("x", "y", "z", *rotation)
            if all(len(roles.get(role, ())) == 1 for role in names):
                reading = found_as(group.references([roles[role][0] for role in names]), layout)
                if reading is not None:
                    return reading
        matches = [(int(match["number"]), k, name.lower()) for k, name in enumerate(group.names)
                   if (match := _MATRIX.fullmatch(name.lower()))]  # fmt: skip
        if len(matches) == 16:
            columns = group.references([k for _, k, _ in sorted(matches)])
            return found_as(columns, "matrix_columns" if _BY_COLUMNS.fullmatch(matches[0][2]) else "matrix_rows")
    arrays = _arrays(table, wanted)
    for column in arrays:
        words = set(_words(column.name))
        if column.size == 16 and (words & _TOOL_WORDS or _BY_COLUMNS.fullmatch(column.name.lower())):
            by_columns = _BY_COLUMNS.fullmatch(column.name.lower())
            return found_as((column.name,), "matrix_columns" if by_columns else "matrix_rows")
        if column.size == 7 and words & _TOOL_WORDS:
            return found_as((column.name,), "quaternion_xyzw" if "xyzw" in words else "quaternion_wxyz")
    for column in arrays:
        if column.size == 3 and set(_words(column.name)) & {"pos", "position", "positions", "xyz"}:
            stem = re.sub(r"(pos|positions?|xyz)$", "", column.name.lower())
            for other in arrays:
                for pattern, size, layout in _ROTATION_ARRAYS:
                    name = other.name.lower()
                    if other.size == size and name.startswith(stem) and pattern.fullmatch(name):
                        swapped = layout == "quaternion_wxyz" and re.search(r"xyzw|eef", name)
                        reading = found_as((column.name, other.name), "quaternion_xyzw" if swapped else layout)
                        if reading is not None:
                            return reading
    return None


def _arrays(table: ColumnTable, wanted: Reading) -> list[NumberColumn]:
    """Return the columns without names of their numbers that may be read."""
    arm = (wanted.arm or "").lower()
    return [c for c in _allowed(table) if c.size > 1 and not c.names and arm in c.name.lower()]


def _with_times(table: ColumnTable, reading: Reading) -> Reading:
    """Return the reading with the column of the times, and their unit if its name ends with it."""
    stamps = [(c.name, match) for c in table.columns if c.size == 1 and (match := _TIME.fullmatch(c.name.lower()))]
    if not stamps:
        pairs = (c.name for c in table.columns if c.size == 1 and nanoseconds_beside(table, c.name))
        return reading.change(time=next(pairs, None))
    name, match = stamps[0]
    unit = match["unit"] and match["unit"].removesuffix("econds").removesuffix("ecs").removesuffix("ec")
    return reading.change(time=name, time_unit=reading.time_unit or unit)


def _with_frames(reading: Reading) -> Reading:
    """Return the reading of poses with the frames that all names state, where they are not stated."""
    names = [name.lower() for name in reading.columns or ()]
    if all("o_t_ee" in name for name in names):  # libfranka: the end effector in the base
        reading = reading.change(tool=reading.tool or "tcp", base_from_world=reading.base_from_world or (0.0,) * 3)
    for word, tool in _TOOLS.items():
        if reading.tool is None and all(word in _words(name) for name in names):
            reading = reading.change(tool=tool)
    return reading


def _with_units(table: ColumnTable, reading: Reading) -> Reading:
    """Return the reading with the units in which all names end, where they are not stated."""
    words = {_words(name)[-1] for name in reading.columns or () if _words(name)}
    units = {_UNITS[word] for word in words if word in _UNITS}
    lengths = units & {"m", "cm", "mm"}
    angles = units & {"rad", "deg"}
    length = reading.length or (min(lengths) if len(lengths) == 1 else None)
    return reading.change(length=length, angle=reading.angle or (min(angles) if len(angles) == 1 else None))


def _role(element: str) -> str:
    """Return the role of an element of a pose by its name; "" if it is unclear."""
    words = [word for word in _words(element) if word not in _UNITS]
    if not words or _OTHER_WORDS & set(words):
        return ""
    vector = _ROTATION_VECTOR.fullmatch("_".join(words))
    if vector:
        axis = vector["axis"]
        return f"v{'xyz'.index(axis)}" if axis in "xyz" else f"v{axis}"
    last = words[-1]
    before = set(words[:-1])
    if last in ("roll", "pitch", "yaw") or re.fullmatch(r"[qrw][wxyz]", last):
        return last
    if match := re.fullmatch(r"(?P<kind>[pt])?(?P<axis>[wxyz])", last):
        is_rotation = match["axis"] == "w" or before & _QUATERNION_WORDS
        return f"q{match['axis']}" if is_rotation and not match["kind"] else match["axis"]
    return ""


def _words(name: str) -> list[str]:
    return [word for word in re.split(r"[^a-z0-9]+", name.lower()) if word]
