"""Doubt about how a trajectory's numbers are to be read: another reading of them that fits the robot far better."""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import product
from math import inf
from pathlib import Path

from kinebench_drake.errors import InputError, UnmeasurableError, UsageError, name_options
from kinebench_drake.formats.trajectories.columns import complete, list_joint_rows
from kinebench_drake.formats.trajectories.reading import (
    ANGLES,
    JOINTS,
    LAYOUTS,
    LENGTHS,
    TIMES,
    Reading,
    TrajectoryOptions,
    frame_of,
)
from kinebench_drake.formats.trajectories.source import apply_reading, find_trajectories, open_table
from kinebench_drake.formats.trajectories.trajectory import ColumnTable, TrajectorySample
from kinebench_drake.io.jsonl import Json
from kinebench_drake.runs.resources import Resources, ResourcesFactory, RobotOptions, load_resources

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
        }.items()
    ),
    Alternative(name="poses in a frame other than the robot's base", cost=0.6, fits_frame=True),
)
"""All but those of other units."""


def alternatives(reading: Reading) -> Iterator[Alternative]:
    """Yield the alternatives that a complete reading has: layouts of as many numbers, other units and frames."""
    is_pose = reading.layout != JOINTS
    sizes = set(LAYOUTS[reading.layout or JOINTS])
    for alternative in ALTERNATIVES:
        layout = alternative.change.get("layout")
        if not is_pose and layout is None and alternative.change != {"deltas": True}:
            continue
        if isinstance(layout, str) and (layout == reading.layout or not sizes & set(LAYOUTS[layout])):
            continue
        if any(getattr(reading, key) == value for key, value in alternative.change.items()):
            continue
        yield alternative
    for units in product(*_UNITS.values()):
        present = reading.keys(_UNITS)
        change = {key: unit for key, unit in zip(_UNITS, units, strict=True) if unit != present[key]}
        if change and (is_pose or "length" not in change) and (reading.time is not None or "time_unit" not in change):
            yield Alternative(
                name=", ".join(_NOUNS[unit] for unit in change.values()), cost=UNIT_COST * len(change), change=change
            )


MARGIN = 0.3
"""Difference of costs (`metrics.misfit`) from which another reading fits far better."""
REFUSED = 3.0
"""Cost of a reading by which a file cannot be used: more than that of any motion."""
PROPOSED = 0.95
"""Cost below which a reading is proposed that no name states: wrong readings of recordings have 0.99 or more."""
PRINTED = 5
"""Further readings that are printed."""

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
        return {"name": self.name, "cost": round(self.cost, 3), "reading": self.reading.to_json()}


@dataclass(frozen=True, slots=True, kw_only=True)
class Assessment:
    """Readings of a file."""

    by_names: ReadingCandidate
    best: ReadingCandidate
    """Differs from `by_names` only if it fits far better."""
    others: tuple[ReadingCandidate, ...]
    """Further readings, the best first."""

    def to_json(self) -> dict[str, Json]:
        """Return the JSON object, which is also a reading file: that of the best reading."""
        doubt = None if self.doubt is None else name_options(self.doubt)
        others = [self.by_names, *self.others] if self.doubt else [*self.others]
        return {**self.best.to_json(), "doubt": doubt, "others": [other.to_json() for other in others[:PRINTED]]}

    @property
    def doubt(self) -> str | None:
        """Why there is no verdict by the names; None if there is no doubt."""
        if self.best is self.by_names:
            return None
        named = self.by_names
        best = self.best
        return (
            f"{named.reading.describe()} fits the robot badly (cost {named.cost:.2f}), {best.name} far better "
            f"({best.cost:.2f}): $reading FILE with {json.dumps(best.reading.keys(best.changed))} reads them so, with "
            f"{json.dumps(named.reading.keys(best.changed))} as they are named"
        )


@lru_cache(maxsize=256)
def assess_readings(
    tools: Resources, samples: tuple[TrajectorySample, ...], choice: TrajectoryOptions, *, thorough: bool = False
) -> Assessment | None:
    """Compare the readings of trajectories that are stored alike; None if none can be measured.

    Args:
        samples: trajectories of one file or dataset, which share one reading.
        choice: options of the user; a key of their reading is never doubted.
        thorough: also compare readings if that by the names fits well.
    """
    with ExitStack() as stack:
        tables = [(sample, stack.enter_context(open_table(sample))) for sample in samples]

        wanted = choice.reading or Reading()
        named = complete(tables[0][1], wanted)
        misfit = _misfit(tools, tables, named, choice.rate_hz)
        if misfit is None:
            return None
        best = by_names = ReadingCandidate(name=str(named.layout), reading=named, misfit=misfit)
        others: list[ReadingCandidate] = []
        while len(best.changed) < _CHANGES and (best.cost >= MARGIN or thorough):
            enough = inf if thorough else best.cost - MARGIN  # a reading with that cost is no better one
            tried = list(_variations(tools, tables, best, wanted, choice.rate_hz, enough))
            others += tried
            better = min(tried, key=lambda candidate: candidate.cost, default=best)
            if best.cost - better.cost < MARGIN:
                break
            best = better
    rest = sorted((other for other in others if other is not best), key=lambda candidate: candidate.cost)
    return Assessment(by_names=by_names, best=best, others=tuple(rest))


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
) -> Iterator[ReadingCandidate]:
    """Yield the readings that differ from a candidate by one alternative, can be used and leave `wanted` as it is.

    Costs of `enough` or more may be lower bounds.
    """
    for alternative in alternatives(start.reading):
        change = dict(alternative.change)
        spent = start.spent + alternative.cost
        if spent >= enough or any(getattr(wanted, key) is not None for key in alternative.keys):
            continue
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


def doubt_robot(sample: TrajectorySample, choice: TrajectoryOptions) -> str | None:
    """Return why a trajectory is not judged as a Panda's: its file names another robot; None if it does not."""
    name = sample.robot
    if name is None or not _OTHERS.search(name) or (choice.reading and choice.reading.robot):
        return None
    return (
        f"the file names the robot {name}, not a Panda: name it by $robot, or insist by $reading FILE "
        'with {"robot": "panda"}'
    )


def assess_path(source: Path, options: RobotOptions, make_resources: ResourcesFactory = Resources) -> Assessment:
    """Compare the readings of the first trajectory of a path, and of those that are stored with it.

    Raises:
        UsageError: there is no trajectory, or it cannot be read.
        SetupError: the robot's files are missing.
    """
    choice = TrajectoryOptions()
    sample = find_trajectories(source, choice)[0]
    tools = load_resources(make_resources, options)
    samples = sample.alike or (sample,)
    try:
        assessment = assess_readings(tools, samples, choice, thorough=True)
    except InputError as error:
        assessment = _propose_joints(tools, samples)
        if assessment is None:
            raise UsageError(f"{sample.video}: {error}") from None
    if assessment is None:
        raise UsageError(f"{sample.video}: is too short to tell one reading from another")
    return assessment


def _propose_joints(tools: Resources, samples: tuple[TrajectorySample, ...]) -> Assessment | None:
    """Return the seven consecutive numbers that fit the robot best as joint angles; None if none fit."""
    with open_table(samples[0]) as table:
        choices = [TrajectoryOptions(reading=reading) for reading in list_joint_rows(table)]
    assessed = [assess_readings(tools, samples, choice, thorough=True) for choice in choices]
    fitting = [one for one in assessed if one is not None and one.best.cost < PROPOSED]
    if not fitting:
        return None
    chosen = min(fitting, key=lambda one: one.best.cost)
    name = "joint angles in seven consecutive columns, a proposal by their fit: no name says so"
    best = replace(chosen.best, name=name)
    return replace(chosen, by_names=best, best=best)
