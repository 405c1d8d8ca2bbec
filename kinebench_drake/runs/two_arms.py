"""Two arms in a row: which they are, what each is read and judged by, and one row of both."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.formats.trajectories.check import MIN_FRAMES
from kinebench_drake.formats.trajectories.reading import SIDES, Reading, pose_of
from kinebench_drake.formats.trajectories.trajectory import Trajectory
from kinebench_drake.io.jsonl import Json
from kinebench_drake.metrics.executable import INFEASIBLE, UNDECIDED
from kinebench_drake.models.named_arm import named_arms
from kinebench_drake.results.direction import BOUND, worst_value
from kinebench_drake.results.row import Metrics, MetricValue, SampleRow
from kinebench_drake.runs.evaluator import EXECUTABILITY, KINEMATIC_METRICS
from kinebench_drake.runs.resources import Resources, RobotOptions
from kinebench_drake.segments import segments
from kinebench_drake.violation import Violation, ViolationKind

if TYPE_CHECKING:  # loads Drake
    from kinebench_drake.kinematics.arm_pair import ArmPair
    from kinebench_drake.metrics.kinematic_result import KinematicResult


_ORIGIN = (0.0, 0.0, 0.0)
_JOINED: Mapping[str, Callable[[Sequence[float]], float]] = {"motionless": all, "path_length_m": sum}
"""How metrics of both arms become one, where the worse one does not count."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmChoice:
    """One arm of a run: the only one, or one of two."""

    side: str
    """`left` or `right`; empty for the only one."""
    options: RobotOptions
    reading: Reading | None
    """How its numbers are read; None: by their names."""
    place: tuple[float, ...]
    """Pose of its base in the frame that both share: x y z [m], and a quaternion wxyz if it is turned."""


def choose_arms(options: RobotOptions, reading: Reading | None) -> tuple[ArmChoice, ...]:
    """Return the arms that a run judges: both of a pair, unless the reading names one of them.

    A pair is one by name, or two arms that the key `arms` of the reading places.
    """
    names = named_arms()[options.robot].arms if options.robot in named_arms() else ()
    own = reading or Reading()
    if not names and own.arms is None:
        return (ArmChoice(side="", options=options, reading=reading, place=_ORIGIN),)
    arms = []
    for k, side in enumerate(SIDES):
        place = (own.arms or {}).get(side)
        tool = place if isinstance(place, str) else options.tool
        half = len(own.columns or ()) // 2
        columns = own.columns and (own.columns[:half], own.columns[half:])[k]
        chosen = replace(options, robot=names[k] if names else options.robot, tool=tool)
        base = place if isinstance(place, tuple) else _ORIGIN
        choice = own.change(arm=side, arms=None, columns=columns)
        arms.append(ArmChoice(side=side, options=chosen, reading=choice, place=base))
    return tuple(arm for arm in arms if own.arm in (None, arm.side))


def share_times(trajectories: Sequence[Trajectory]) -> list[Trajectory]:
    """Return the trajectories at the times that all have: of two arms the rows that repeat a state may differ.

    Raises:
        InputError: there are fewer than two such times.
    """
    common = np.intersect1d(trajectories[0].t_s, trajectories[-1].t_s)
    if len(common) < MIN_FRAMES:
        raise InputError(f"the arms share {len(common)} times, a path needs at least {MIN_FRAMES}")
    return [_at(trajectory, np.isin(trajectory.t_s, common)) for trajectory in trajectories]


def _at(trajectory: Trajectory, rows: NDArray[np.bool_]) -> Trajectory:
    """Return the rows (T,) of a trajectory that are True."""
    if rows.all():
        return trajectory
    names = ("t_s", "X_BG", "q", "tracked", "finger_width_m")
    arrays = {name: array[rows] for name in names if (array := getattr(trajectory, name)) is not None}
    return replace(trajectory, **arrays, commands=None)


def find_arm_collisions(
    pair: "ArmPair", results: Sequence["KinematicResult"], sides: Sequence[str], *, of_poses: bool
) -> tuple[list[Violation], str | None]:
    """Find runs of frames in which a link of one arm penetrates one of the other, both as recorded and smoothed.

    `value` is the least distance [m], negative in penetration, and that of `link` and `body`; `limit` the least allowed
    distance, of the arm with more noise. Of poses contacts of the tools alone are certain: other postures may avoid the
    others.

    Returns:
        Violations, and why a verdict is open; None if it is not.
    """
    tolerance_m = max(result.contact_tolerance_m for result in results)
    widths = [result.track.finger_width_m for result in results]
    contacts = pair.contacts([result.joints.q for result in results], widths, tolerance_m)
    doubt = None
    if of_poses:
        links = next((contact.links for contact in contacts if not contact.of_tools), None)
        doubt = (
            links and f"{' meets '.join(_with_sides(links, sides))} on the joint paths, which other postures may avoid"
        )
        contacts = [contact for contact in contacts if contact.of_tools]
    if not contacts:
        return [], doubt
    closed = [np.nan_to_num(width) for width in widths]  # of an unknown gap, contacts of open fingers alone are none
    smooth = pair.contacts([result.curves["q_smooth"] for result in results], closed, tolerance_m)
    depths = np.array([np.nan_to_num(contact.distance_m) for contact in contacts])
    again = np.array([np.isfinite(contact.distance_m) for contact in smooth]).any(axis=0)
    violations = []
    for run in segments(np.asarray((depths < 0.0).any(axis=0) & again)):
        deepest = int(depths[:, run].min(axis=1).argmin())
        link, body = _with_sides(contacts[deepest].links, sides)
        worst = float(depths[deepest, run].min())
        kind = ViolationKind.SELF_COLLISION
        violations.append(Violation.of_run(kind, run, None, worst, -tolerance_m, link=link, body=body))
    return violations, doubt


def _with_sides(links: Sequence[str], sides: Sequence[str]) -> list[str]:
    return [f"{side}_{link.removeprefix(f'{side}_')}" for side, link in zip(sides, links, strict=True)]


def join_rows(
    row: SampleRow, sides: Mapping[str, SampleRow], contacts: Sequence[Violation], doubt: str | None
) -> SampleRow:
    """Return one row of both arms from the rows of each: the worse metrics, all violations, each with its arm.

    Args:
        row: the blank row of the sample.
        sides: rows of the arms.
        contacts: collisions between the arms.
        doubt: why the verdict on contacts is open; None if it is not.
    """
    rows = [*sides.values()]
    of_arms = [replace(violation, arm=side) for side, own in sides.items() for violation in own.violations]
    violations = sorted((*of_arms, *contacts), key=lambda violation: violation.rank)
    verdicts = [own.feasible for own in rows] + [None if doubt else True]
    feasible = False if violations or False in verdicts else None if None in verdicts else True
    verdict = [INFEASIBLE] if feasible is False else [UNDECIDED] if feasible is None else []
    others = [reason for own in rows for reason in own.executable_reasons if reason not in (INFEASIBLE, UNDECIDED)]
    metrics, reasons = _join_metrics(sides, contacts)
    if feasible is None:
        reasons["feasible"] = doubt or _reason(sides, "feasible")
    details: dict[str, Json] = {
        side: {**own.details, "metrics": own.metrics.numbers, "frames_tracked": own.frames_tracked}
        for side, own in sides.items()
    }
    idle = [own.idle_ends for own in rows if own.idle_ends is not None]
    gaps = {frame for own in rows for frame in own.dropped_samples or ()}
    lags = [own.action_lag for own in rows if own.action_lag is not None]
    frame_doubts = [f"{side}: {own.base_frame_reason}" for side, own in sides.items() if own.base_frame_reason]
    joined = rows[0].extended(
        **({"base_frame_reason": frame_doubts[0]} if frame_doubts else {}),
        arms=[*sides],
        frames_tracked=min(own.frames_tracked or 0 for own in rows),
        columns="; ".join(f"{side}: {own.columns}" for side, own in sides.items()),
        dropped_samples=sorted(gaps),
        idle_ends=np.min(idle, axis=0).tolist() if len(idle) == len(rows) else None,
        fingerprint="".join(own.fingerprint or "" for own in rows) or None,
        **({"action_lag": max(lags, key=lambda lag: abs(lag.frames))} if lags else {}),
        warnings=[f"{side}: {text}" for side, own in sides.items() for text in own.warnings or ()],
    )
    return replace(
        joined,
        feasible=feasible,
        executable=False if feasible is False else None if verdict or others else True,
        executable_reasons=(*verdict, *dict.fromkeys(others)),
        violations=tuple(violations),
        metrics=Metrics({**row.metrics, **metrics}),
        null_reasons=reasons,
        details=details,
    )


def _reason(sides: Mapping[str, SampleRow], name: str) -> str:
    """Return why a value of one of the arms is null."""
    stated = (f"{side}: {own.null_reasons[name]}" for side, own in sides.items() if name in own.null_reasons)
    return next(stated, "unmeasurable on this sample")


def _join_metrics(
    sides: Mapping[str, SampleRow], contacts: Sequence[Violation]
) -> tuple[dict[str, MetricValue], dict[str, str]]:
    """Return the worse of the metrics of both arms, and why some are null."""
    metrics: dict[str, MetricValue] = {}
    reasons: dict[str, str] = {}
    for name in dict.fromkeys(name for own in sides.values() for name in own.metrics):
        if worst_value(name.removesuffix(BOUND), [0.0]) is None and name not in KINEMATIC_METRICS:
            continue
        values = [own.metrics.number(name) for own in sides.values()]
        numbers = [value for value in values if value is not None]
        join = _JOINED.get(name, partial(worst_value, name.removesuffix(BOUND)))
        metrics[name] = None if None in values else join(numbers)
        if metrics[name] is None:
            reasons[name] = _reason(sides, name)
    score = metrics.get(EXECUTABILITY)
    if contacts and isinstance(score, float):
        excess = max(violation.value / violation.limit for violation in contacts)
        metrics[EXECUTABILITY] = score * (1.0 + excess**4) ** -0.25  # as of a frame (`metrics.executability`)
    return metrics, reasons


@lru_cache(maxsize=1)
def load_pair(tools: tuple[Resources, ...], places: tuple[tuple[float, ...], ...]) -> "ArmPair":
    """Return the model of the distances between two arms, see `ArmChoice.place`."""
    from kinebench_drake.kinematics.arm_pair import ArmPair

    return ArmPair([tool.plant for tool in tools], [pose_of(place) for place in places])
