"""Doubt about how a trajectory's numbers are to be read.

There is none about the names that docs/formats.md defines, and about what a reading file states. Under other names a
verdict needs a reading that fits the robot, that no other reading fits far better, and that has the same verdict as
those readings of poses which the numbers cannot tell from it.
"""

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import permutations, product
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kinebench_drake.errors import InputError, UnmeasurableError, UsageError, name_options
from kinebench_drake.formats.trajectories.columns import (
    PROPOSAL,
    complete,
    find_poses,
    is_documented,
    is_numbered,
    list_joint_rows,
)
from kinebench_drake.formats.trajectories.reading import (
    ANGLES,
    JOINTS,
    LENGTHS,
    TIMES,
    Reading,
    TrajectoryOptions,
    frame_of,
    layout_sizes,
)
from kinebench_drake.formats.trajectories.source import apply_reading, find_trajectories, open_table
from kinebench_drake.formats.trajectories.trajectory import (
    ColumnTable,
    Trajectory,
    TrajectoryFormat,
    TrajectorySample,
)
from kinebench_drake.geometry import Array, invert, pose_difference
from kinebench_drake.io.jsonl import Json
from kinebench_drake.models.arm import FR3, PANDA
from kinebench_drake.models.named_arm import find_arm, named_arms
from kinebench_drake.runs.resources import Resources, ResourcesFactory, RobotOptions, load_resources
from kinebench_drake.segments import evenly
from kinebench_drake.track import MAX_WIDTH_M

if TYPE_CHECKING:  # loads Drake
    from kinebench_drake.metrics.kinematic_result import KinematicResult

_UNITS = {"length": LENGTHS, "angle": ANGLES, "time_unit": TIMES}
_NOUNS = {"mm": "millimetres", "cm": "centimetres", "m": "metres", "deg": "degrees", "rad": "radians"}
_NOUNS |= {"ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds", "s": "seconds"}
UNIT_COST = 0.05
"""Cost of one other unit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Alternative:
    """One other reading."""

    name: str
    """What the numbers would be."""
    cost: float
    """How much better it must fit than the reading by the names: the less usual, the more."""
    change: Mapping[str, object] = field(default_factory=dict)
    """Keys that differ."""
    fits_frame: bool = False
    """True if `base_from_world` is fitted to the poses."""

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys that it changes."""
        return ("base_from_world",) if self.fits_frame else tuple(self.change)


_OFFSET_COST = -0.8  # with a posture added, right angles fit worse by 0.7 and more, offsets by 0.6 at most
POSTURES: Mapping[str, tuple[float, ...]] = {
    "Franka's ready posture": (0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4),
    "Isaac Lab's": (0.0, -0.569, 0.0, -2.81, 0.0, 3.037, 0.741),  # FRANKA_PANDA_CFG
    "ManiSkill's": (0.0, np.pi / 8, 0.0, -5 * np.pi / 8, 0.0, 3 * np.pi / 4, np.pi / 4),  # keyframe "rest"
    "robosuite's": (0.0, -0.161, 0.0, -2.445, 0.0, 2.227, 0.785),  # mounted Panda, LIBERO
}
"""Default postures [rad] from which simulators store joint angles as offsets."""
ALTERNATIVES = (
    Alternative(name="rotation vectors", cost=0.05, change={"layout": "rotation_vector"}),
    *(
        Alternative(name=f"Euler angles {order}", cost=0.15, change={"layout": f"euler_{order}"})
        for order in ("xyz", "zyx", "XYZ", "ZYX")
    ),
    Alternative(name="quaternions x y z w", cost=0.15, change={"layout": "quaternion_xyzw"}),
    Alternative(name="quaternions w x y z", cost=0.15, change={"layout": "quaternion_wxyz"}),
    Alternative(name="matrices by columns", cost=0.05, change={"layout": "matrix_columns"}),
    Alternative(name="matrices by rows", cost=0.05, change={"layout": "matrix_rows"}),
    Alternative(name="poses of the flange", cost=0.05, change={"tool": "flange"}),
    Alternative(name="changes from frame to frame", cost=0.3, change={"deltas": True}),
    *(
        Alternative(name=f"poses in the world of {world}", cost=0.15, change={"base_from_world": offset})
        for world, offset in {
            "LIBERO (base at -0.66 0 0.912)": (0.66, 0.0, -0.912),  # mounted Panda, table arenas
            "robosuite (base at -0.56 0 0.912)": (0.56, 0.0, -0.912),  # table of 0.8 m
            "ManiSkill (base at -0.615 0 0)": (0.615, 0.0, 0.0),  # table scenes
            "RLBench (base at -0.268 -0.006 0.75)": (0.268, 0.006, -0.75),
        }.items()
    ),
    *(
        Alternative(
            name=f"offsets from {name}", cost=_OFFSET_COST, change={"offset": tuple(np.round(posture, 4).tolist())}
        )
        for name, posture in POSTURES.items()
    ),
    Alternative(name="poses in a frame other than the robot's base", cost=0.6, fits_frame=True),
)
"""All but those of other units, and of fingers before the arm."""
_OF_JOINTS = {"layout", "deltas", "offset"}  # keys of the alternatives of joint angles


def alternatives(reading: Reading, table: ColumnTable) -> Iterator[Alternative]:
    """Yield the alternatives that a complete reading has: layouts of as many numbers, other units and frames."""
    is_pose = reading.layout != JOINTS
    columns = reading.columns or ()
    is_whole = not is_pose and len(columns) == 1 and table.size(columns) == len(table.joints) + 2
    if is_whole and _has_fingers_first(table, columns):
        [name] = columns
        parts = {"columns": (f"{name}[2:9]",), "fingers": (f"{name}[0:2]",)}
        yield Alternative(name="two finger joints before those of the arm", cost=2.0 * _OFFSET_COST, change=parts)
    sizes = set(layout_sizes(reading.layout or JOINTS, len(table.joints)))
    for alternative in ALTERNATIVES:
        layout = alternative.change.get("layout")
        if "offset" in alternative.change if is_pose else not alternative.change.keys() & _OF_JOINTS:
            continue
        if isinstance(layout, str) and (
            layout == reading.layout or not sizes & set(layout_sizes(layout, len(table.joints)))
        ):
            continue
        if any(getattr(reading, key) == value for key, value in alternative.change.items()):
            continue
        if "offset" in alternative.change and reading.offset is not None:
            continue
        yield alternative
    for units in product(*_UNITS.values()):
        present = reading.keys(_UNITS)
        change = {key: unit for key, unit in zip(_UNITS, units, strict=True) if unit != present[key]}
        if change and (is_pose or "length" not in change) and (reading.time is not None or "time_unit" not in change):
            yield Alternative(
                name=", ".join(_NOUNS[unit] for unit in change.values()), cost=UNIT_COST * len(change), change=change
            )


def _has_fingers_first(table: ColumnTable, columns: tuple[str, ...]) -> bool:
    """Return True if of nine numbers the first two, and not the last two, can be finger joints [m]."""
    values = table.numbers(columns)
    fingers = (values > -_FINGER_SLACK_M) & (values < 0.5 * MAX_WIDTH_M + _FINGER_SLACK_M)
    return bool(fingers[:, :2].all() and not fingers[:, -2:].all(axis=0).any())


_FINGER_SLACK_M = 0.005  # overshoot of a finger joint
MARGIN = 0.3
"""Difference of costs (`metrics.misfit`) from which another reading fits far better."""
REFUSED = 3.0
"""Cost of a reading by which a file cannot be used: more than that of any motion."""
PROPOSED = 0.95
"""Cost below which a reading is proposed that no name states: wrong readings of recordings have 0.99 or more."""
PRINTED = 5
"""Further readings that are printed."""
_ANY_RATE_HZ = 20.0
"""Rate at which columns are compared where a file has no times [1/s]."""

UNFIT = 2.0
"""Cost above that of any right reading: feasible motions and planted faults have at most 1.8."""
UNTOLD = 0.2
"""Difference of costs up to which numbers do not tell one reading of poses from another: right readings have at most
0.15 more than wrong ones."""
UNTOLD_TOOL = 0.7
"""The same of the flange and the TCP: more by the cost of a gripper below the table, which may be the fault itself."""

_ORDER_GAIN = 0.6  # of another order of the joints: self-collisions have up to 1.2, but few more than this
_ORDERS = 40  # that are tried, those most within limits first
_GRIPPER = 0.9  # share of frames in which a binary gripper is open or closed
_AGREEMENT = (0.01, 0.03)  # of two recordings of a pose [m, rad], in most frames
_MOVED_M = 0.05  # by which a motion shows an agreement
_ORDERS_OF = {"quaternion_wxyz": ("quaternion_xyzw",), "quaternion_xyzw": ("quaternion_wxyz",)}
"""The other order of quaternions."""
_CHANGES = 3  # keys that are changed together
_OTHERS = re.compile(
    r"fr3|xarm|\bur\d|so-?10\d|koch|aloha|viperx|widowx|wx250|kuka|iiwa|sawyer|jaco|kinova|gen3|yam\b|piper|open_?arm|"
    r"unitree|\bg1\b|\bh1\b|lekiwi|stretch|fetch|baxter|yumi|google_robot|everyday|aubo|flexiv|rizon|agilex|trossen",
    re.IGNORECASE,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadingCandidate:
    """One reading of a file and its cost."""

    name: str
    """What the numbers are."""
    reading: Reading
    misfit: float
    """Mean of `metrics.misfit` over the trajectories."""
    spent: float = 0.0
    """Cost of the changes."""
    changed: tuple[str, ...] = ()
    """Keys that differ from the reading by the names."""

    @property
    def cost(self) -> float:
        """Total cost."""
        return self.misfit + self.spent

    def to_json(self) -> dict[str, Json]:
        """Return the JSON object."""
        return {"name": self.name, "cost": round(max(self.cost, 0.0), 3), "reading": self.reading.to_json()}


@dataclass(frozen=True, slots=True, kw_only=True)
class Assessment:
    """Readings of a file."""

    by_names: ReadingCandidate
    best: ReadingCandidate
    """Differs from `by_names` only if it fits far better."""
    others: tuple[ReadingCandidate, ...]
    """Further readings, the best first."""
    mismatch: str | None = None
    """Why `by_names` cannot be right, whatever fits better."""

    def to_json(self) -> dict[str, Json]:
        """Return the JSON object, which is also a reading file: that of the best reading."""
        doubt = None if self.doubt is None else name_options(self.doubt)
        others = [self.by_names, *self.others] if self.doubt else [*self.others]
        return {**self.best.to_json(), "doubt": doubt, "others": [other.to_json() for other in others[:PRINTED]]}

    @property
    def doubt(self) -> str | None:
        """Why there is no verdict by the names; None if there is no doubt."""
        named = self.by_names
        best = self.best
        if best is named or best.misfit >= UNFIT:
            return self.mismatch
        if "offset" in best.changed:
            return (
                f"{named.reading.describe()}: not absolute angles (cost {named.misfit:.2f}), but perhaps {best.name} "
                f'({best.misfit:.2f}): $reading FILE states the default posture that was subtracted, as {{"offset": '
                "[7 angles in radians]}, or zeros"
            )
        other = json.dumps(best.reading.keys(best.changed))
        return (
            f"{named.reading.describe()} fits the robot badly (cost {named.misfit:.2f}), {best.name} far better "
            f"({best.misfit:.2f}): $reading FILE with {other} reads them so, with "
            f"{json.dumps(named.reading.keys(best.changed))} as they are named"
        )


@lru_cache(maxsize=256)
def assess_readings(
    tools: Resources,
    samples: tuple[TrajectorySample, ...],
    choice: TrajectoryOptions,
    *,
    thorough: bool = False,
    is_franka: bool = True,
) -> Assessment | None:
    """Compare the readings of trajectories that are stored alike; None if none can be measured.

    Args:
        samples: trajectories of one file or dataset, which share one reading.
        choice: options of the user; a key of their reading is never doubted.
        thorough: also compare readings if that by the names fits well.
        is_franka: False for another arm than Franka's, whose default postures and whose flange are others.
    """
    with ExitStack() as stack:
        tables = [(sample, stack.enter_context(open_table(sample, choice.joints))) for sample in samples]

        wanted = choice.reading or Reading()
        named = complete(tables[0][1], wanted)
        if not thorough and (_is_documented(*tables[0], named) or _agrees(tools, *tables[0], named, choice.rate_hz)):
            return None
        misfit = _misfit(tools, tables, named, choice.rate_hz)
        if misfit is None:
            return None
        best = by_names = ReadingCandidate(name=str(named.layout), reading=named, misfit=misfit)
        others: list[ReadingCandidate] = []
        while len(best.changed) < _CHANGES:
            enough = inf if thorough else best.cost - MARGIN  # a reading with that cost is no better one
            tried = list(_variations(tools, tables, best, wanted, choice.rate_hz, enough, is_franka=is_franka))
            others += tried
            better = min(tried, key=lambda candidate: candidate.cost, default=best)
            if best.cost - better.cost < MARGIN:
                break
            best = better
        mismatch = None
        if wanted.columns is None or wanted.layout is None:
            mismatch = _mismatch(tools, tables, by_names, choice.rate_hz)
    rest = sorted((other for other in others if other is not best), key=lambda candidate: candidate.cost)
    return Assessment(by_names=by_names, best=best, others=tuple(rest), mismatch=mismatch)


def _is_documented(sample: TrajectorySample, table: ColumnTable, reading: Reading) -> bool:
    return sample.format is not TrajectoryFormat.NPY and is_documented(table, reading)  # which names nothing


def _agrees(
    tools: Resources, sample: TrajectorySample, table: ColumnTable, reading: Reading, rate_hz: float | None
) -> bool:
    """Return True if the file has poses, too, and these are those of its joint angles, up to one constant pose."""
    poses = find_poses(table) if reading.layout == JOINTS else None
    if poses is None:
        return False
    poses = poses.change(time=reading.time, time_unit=reading.time_unit)
    for layout in (poses.layout, *_ORDERS_OF.get(poses.layout or "", ())):
        try:
            q = apply_reading(sample, table, reading, rate_hz).q
            X = apply_reading(sample, table, poses.change(layout=layout), rate_hz).X_BG
        except (InputError, UnmeasurableError):
            continue
        if q is None or X is None or len(q) != len(X):
            continue
        valid = np.isfinite(q).all(axis=-1) & np.isfinite(X).all(axis=(-1, -2))
        own = tools.plant.forward_path(q[valid])
        if len(own) == 0 or np.ptp(own[:, :3, 3], axis=0).max() < _MOVED_M:
            continue
        for offset in (invert(X[valid]) @ own, own @ invert(X[valid])):  # of the tool, of the world
            middle = offset[np.argsort(offset[:, 0, 3])[len(offset) // 2]]
            differences = pose_difference(offset, middle)
            if all(np.median(d) < bound for d, bound in zip(differences, _AGREEMENT, strict=True)):
                return True
    return False


def _mismatch(
    tools: Resources,
    tables: Sequence[tuple[TrajectorySample, ColumnTable]],
    candidate: ReadingCandidate,
    rate_hz: float | None,
) -> str | None:
    """Return why a reading cannot be right, in numbers; None if it may be, or the file cannot be read."""
    sample, table = tables[0]
    try:
        trajectory = apply_reading(sample, table, candidate.reading, rate_hz)
    except (InputError, UnmeasurableError):
        return None
    evidence = None
    if candidate.misfit >= UNFIT:
        evidence = f"cost {candidate.misfit:.2f}, right readings have less than {UNFIT:g}"
        if trajectory.q is not None:
            evidence = _outside(tools, trajectory.q) or evidence
    elif trajectory.q is not None and not is_numbered(table, candidate.reading):
        evidence = _other_joints(tools, trajectory, candidate.misfit)
    if evidence is None:
        return None
    return (
        f"the numbers do not fit this arm: {evidence}; nor does another reading that was tried: $reading FILE states "
        "columns and layout, or $robot the robot that they are of"
    )


def _outside(tools: Resources, q: Array) -> str | None:
    """Return which joint of angles (T, 7) [rad] is most often outside its limits; None if none is."""
    q = q[np.isfinite(q).all(axis=-1)]
    excess = np.maximum(tools.plant.lower - q, q - tools.plant.upper)
    share = (excess > 0.0).mean(axis=0)
    joint = int(np.argmax(share))
    where = f"{100 * share[joint]:.0f}% of the frames, by up to {excess[:, joint].max():.2f} rad"
    return f"joint {joint + 1} is outside its limits in {where}" if share[joint] > 0.0 else None


def _other_joints(tools: Resources, trajectory: Trajectory, misfit: float) -> str | None:
    """Return why joint angles whose order no name states are in another order, or of another arm."""
    q = np.asarray(trajectory.q)
    rows = q[np.isfinite(q).all(axis=-1)]
    last = rows[:, -1]
    low = float(last.min())
    high = float(last.max())
    near = 0.05 * (high - low)
    at_ends = ((last <= low + near) | (last >= high - near)).mean()
    if low >= -0.01 and high <= 1.01 and high - low > 0.02 and at_ends >= _GRIPPER:
        return f"its last number is like a gripper, {low:.2g} or {high:.2g} in {100 * at_ends:.0f}% of the frames"
    if misfit < _ORDER_GAIN:
        return None
    values = rows[evenly(len(rows), 16), :, None]
    inside = ((values >= tools.plant.lower) & (values <= tools.plant.upper)).mean(axis=0)  # by column and joint
    orders = np.array(list(permutations(range(q.shape[1]))))
    likely = np.argsort(-np.prod(inside[orders, np.arange(q.shape[1])], axis=1), kind="stable")[:_ORDERS]
    costs = [tools.misfit(replace(trajectory, q=q[:, order]), misfit) for order in orders[likely]]
    if misfit - min(costs) < _ORDER_GAIN:
        return None
    return f"cost {misfit:.2f}, in another order of the joints {min(costs):.2f}"


def doubt_frame(
    tools: Resources,
    sample: TrajectorySample,
    choice: TrajectoryOptions,
    result: "KinematicResult",
    judge: Callable[[Trajectory], "KinematicResult"],
    *,
    is_franka: bool = True,
) -> str | None:
    """Return which reading of poses that neither names nor numbers exclude has another verdict; None if none has.

    Args:
        result: verdict on the reading by the names.
        judge: judges another reading.
        is_franka: False for another arm than Franka's, whose flange is another one.
    """
    with open_table(sample, choice.joints) as table:
        named = complete(table, choice.reading or Reading())
        if result.feasible is None or named.layout == JOINTS or _is_documented(sample, table, named):
            return None
        cost = tools.misfit(apply_reading(sample, table, named, choice.rate_hz), inf)
        for change in _untold(named, choice.reading or Reading()):
            if "tool" in change and not is_franka:
                continue
            bound = cost + (UNTOLD_TOOL if "tool" in change else UNTOLD)
            try:
                other = apply_reading(sample, table, named.change(**change), choice.rate_hz)
                verdict = judge(other) if tools.misfit(other, bound) < bound else result
            except (InputError, UnmeasurableError):
                continue
            if verdict.feasible is (not result.feasible):
                names = json.dumps(named.keys(change))
                others = json.dumps(named.change(**change).keys(change))
                return (
                    f"{named.describe()}: neither names nor numbers tell the frame: with {names} the motion is "
                    f"{_describe(result)}, with {others} {_describe(verdict)}; $reading FILE states which"
                )
    return None


def _untold(named: Reading, wanted: Reading) -> Iterator[dict[str, object]]:
    """Yield the keys that differ in the readings of poses by another frame or order of quaternions."""
    tools = ({}, {"tool": "flange"}) if named.tool is None else ({},)
    orders = [{"layout": layout} for layout in _ORDERS_OF.get(named.layout or "", ()) if wanted.layout is None]
    worlds = [dict(a.change) for a in ALTERNATIVES if "base_from_world" in a.change and named.base_from_world is None]
    for tool, order, world in product(tools, ({}, *orders), ({}, *worlds)):
        if change := {**tool, **order, **world}:
            yield change


def _describe(result: "KinematicResult") -> str:
    """Return the verdict with the first violation in numbers."""
    if not result.violations:
        return "feasible"
    first = result.violations[0]
    kind = first.kind.value.replace("_", " ")
    where = f" of {first.joint}" if first.joint else ""
    if first.unit == "m":
        return f"infeasible ({kind}{where}, {1e3 * first.value:.0f} mm, limit {1e3 * first.limit:.0f} mm)"
    return f"infeasible ({kind}{where}, {first.value:.3g} {first.unit}, limit {first.limit:.3g} {first.unit})"


def _misfit(
    tools: Resources,
    tables: Sequence[tuple[TrajectorySample, ColumnTable]],
    reading: Reading,
    rate_hz: float | None,
    enough: float = inf,
) -> float | None:
    """Return the mean misfit of trajectories by a reading; None if all of them are too short.

    A mean of `enough` or more may be a lower bound.
    """
    costs: list[float] = []
    for sample, table in tables:
        try:
            costs.append(
                tools.misfit(apply_reading(sample, table, reading, rate_hz), enough * len(tables) - sum(costs))
            )
        except InputError:
            costs.append(REFUSED)
        except UnmeasurableError:
            continue
    return sum(costs) / len(costs) if costs else None


def _variations(
    tools: Resources,
    tables: Sequence[tuple[TrajectorySample, ColumnTable]],
    start: ReadingCandidate,
    wanted: Reading,
    rate_hz: float | None,
    enough: float,
    *,
    is_franka: bool,
) -> Iterator[ReadingCandidate]:
    """Yield the readings that differ from a candidate by one alternative, can be used and leave `wanted` as it is.

    Costs of `enough` or more may be lower bounds.
    """
    for alternative in alternatives(start.reading, tables[0][1]):
        change = dict(alternative.change)
        spent = start.spent + alternative.cost
        if spent >= enough or any(getattr(wanted, key) is not None for key in alternative.keys):
            continue
        if "offset" in change and not is_franka:
            continue
        if ("angle" in change and start.reading.offset) or ("offset" in change and "angle" in start.changed):
            continue  # small offsets fit any arm, which then rests in its default posture
        if alternative.fits_frame:
            try:
                poses = apply_reading(*tables[0], start.reading, rate_hz).X_BG
            except (InputError, UnmeasurableError):
                continue
            if poses is None:
                continue
            # the middle of the workspace over a table
            change = {"base_from_world": frame_of(poses, (0.5, 0.0, 0.3))}
        reading = start.reading.change(**change)
        misfit = _misfit(tools, tables, reading, rate_hz, enough - spent)
        if misfit is not None and misfit < REFUSED:
            yield ReadingCandidate(
                name=f"{start.name}, {alternative.name}" if start.changed else alternative.name,
                reading=reading,
                misfit=misfit,
                spent=spent,
                changed=(*start.changed, *change),
            )


def doubt_robot(sample: TrajectorySample, choice: TrajectoryOptions, robot: str) -> str | None:
    """Return why a trajectory is not judged as one of `robot`: its file names another one; None if it does not."""
    name = sample.robot
    if name is None or robot not in named_arms() or (choice.reading and choice.reading.robot):
        return None
    named = find_arm(name)
    fitting = (named, *named_arms()[named].arms) if named else ()
    is_other = robot not in fitting if named else bool(_OTHERS.search(name))
    if not is_other or (named, robot) == (PANDA, FR3):
        return None
    return (
        f"the file names the robot {name}, not {'a Panda' if robot == PANDA else robot}: name it by $robot, or insist "
        f'by $reading FILE with {{"robot": "{robot}"}}'
    )


def assess_path(source: Path, options: RobotOptions, make_resources: ResourcesFactory = Resources) -> Assessment:
    """Compare the readings of the first trajectory of a path, and of those that are stored with it.

    Raises:
        UsageError: there is no trajectory, or it cannot be read.
        SetupError: the robot's files are missing.
    """
    tools = load_resources(make_resources, options)
    choice = TrajectoryOptions(joints=tools.plant.robot.column_names)
    sample = find_trajectories(source, choice)[0]
    samples = sample.alike or (sample,)
    try:
        assessment = assess_readings(tools, samples, choice, thorough=True, is_franka=options.is_named)
    except InputError as error:
        assessment = _propose_joints(tools, samples)
        if assessment is None:
            raise UsageError(
                f"{sample.video}: {str(error).removesuffix(PROPOSAL)}; nor do seven consecutive columns fit the robot "
                'as joint angles. A reading file lists the columns: {"columns": ["A", "B", ...], "layout": ...}, see '
                "docs/formats.md"
            ) from None
    if assessment is None:
        raise UsageError(f"{sample.video}: is too short to tell one reading from another")
    return assessment


def _propose_joints(tools: Resources, samples: tuple[TrajectorySample, ...]) -> Assessment | None:
    """Return the seven consecutive numbers that fit the robot best as joint angles; None if none fit."""
    joints = tools.plant.robot.column_names
    with open_table(samples[0], joints) as table:
        readings = list_joint_rows(table)
        rates_hz = [_ANY_RATE_HZ if complete(table, reading).time is None else None for reading in readings]
    choices = [
        TrajectoryOptions(reading=r, rate_hz=rate, joints=joints) for r, rate in zip(readings, rates_hz, strict=True)
    ]
    assessed = [assess_readings(tools, samples, choice, thorough=True) for choice in choices]
    # an offset could be added to any columns
    best = [one.by_names if "offset" in one.best.changed else one.best for one in assessed if one is not None]
    fitting = [candidate for candidate in best if candidate.cost < PROPOSED]
    if not fitting:
        return None
    name = "joint angles in seven consecutive columns, a proposal by their fit: no name says so"
    first, *others = sorted(fitting, key=lambda candidate: candidate.cost)
    first = replace(first, name=name)
    return Assessment(by_names=first, best=first, others=tuple(others))
