"""When a track came nearest to each limit, or broke it: the table of worst moments."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.report.frames import JointLimits, joint_limits, limit_ratios
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.trackfile import TrackFile
from kinebench_drake.types import Json

_DEGREES, _MILLIMETRES = (180.0 / np.pi, "°"), (1000.0, "mm")
_UNITS = {
    "unreachable": _MILLIMETRES,
    "joint_limit": _DEGREES,
    "self_collision": _MILLIMETRES,
    "table_collision": _MILLIMETRES,
    "velocity": (1.0, "rad/s"),
    "acceleration": (1.0, "rad/s²"),
    "jerk": (1.0, "rad/s³"),
    "torque": (1.0, "N m"),
}
"""Factor and unit in which the values of each kind of limit are shown; others are shown as they are."""
_RATES = ("velocity", "acceleration", "jerk", "torque")
_NEAR = {
    "joint_limit": "joint angle",
    "self_collision": "clearance to itself",
    "table_collision": "clearance to the table",
}
"""What is measured against the limits that are no rates."""
_DISTANCES = {"self_collision": "self_distance_m", "table_collision": "table_distance_m"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """The worst that a track does to one limit."""

    kind: str
    label: str
    """What the table calls it."""
    broken: bool
    joint: str | None
    when: str
    after_s: float | None
    """When it begins, after the track's start [s]; None if unknown."""
    value: float | None
    """In `unit`."""
    limit: float | None
    """In `unit`."""
    unit: str
    ratio: float | None
    """Value / limit; above 1 is past the limit. None where that has no meaning."""


def worst_moments(row: SampleRow, file: TrackFile | None) -> list[Moment]:
    """All limits broken, then how near the track comes to the others, the nearest first.

    What a row's `details` say of a limit goes before what the curves of its file show.

    Args:
        row: violations and details.
        file: the track; None if there is none: then frames are given, not times.
    """
    t_s = file.track.t_s if file else None
    broken = [_violation(v, t_s) for v in row.violations]
    kinds = {moment.kind for moment in broken}
    near = [m for m in _nearest(row, file) if m.kind not in kinds] if file else []
    return broken + sorted(near, key=lambda moment: 0.0 if moment.ratio is None else -moment.ratio)


def find_checks(details: Mapping[str, Json]) -> dict[str, Mapping[str, Json]]:
    """What details say of each rate's limit, by kind: objects that hold a `ratio_max`, at any depth."""
    found: dict[str, Mapping[str, Json]] = {}
    for key, value in details.items():
        if not isinstance(value, Mapping):
            continue
        if key in _RATES and isinstance(value.get("ratio_max"), int | float):
            found[key] = value
        else:
            found = {**find_checks(value), **found}
    return found


def _violation(v: Mapping[str, Json], t_s: Array | None) -> Moment:
    kind = str(v.get("kind"))
    start, end, joint = v.get("frame_start"), v.get("frame_end"), v.get("joint")
    value, limit = number(v.get("value")), number(v.get("limit"))
    ratio = abs(value / limit) if kind in _RATES and value is not None and limit else None
    factor, unit = _UNITS.get(kind, (1.0, ""))
    return Moment(
        kind=kind,
        label=kind.replace("_", " "),
        broken=True,
        joint=None if joint is None else str(joint),
        when=_when(start, end, t_s) if isinstance(start, int) and isinstance(end, int) else "–",
        after_s=float(t_s[start] - t_s[0])
        if t_s is not None and isinstance(start, int) and 0 <= start < len(t_s)
        else None,
        value=None if value is None else value * factor,
        limit=None if limit is None else limit * factor,
        unit=unit,
        ratio=ratio,
    )


def _nearest(row: SampleRow, file: TrackFile) -> Iterator[Moment]:
    limits, t_s = joint_limits(row), file.track.t_s
    ratios, checks = limit_ratios(file, limits), find_checks(row.details)
    for kind in _RATES:
        moment = _checked(kind, checks[kind], limits, t_s[0]) if kind in checks else None
        ratio = ratios.get(kind)
        if moment is None and ratio is not None and np.isfinite(ratio).any():
            frame, j = np.unravel_index(np.nanargmax(ratio), ratio.shape)
            value = abs(float(file.curves[kind][frame, j]))
            moment = _moment(
                kind, limits.joints[j], t_s[frame], t_s[0], value, float(limits.rates[kind][j]), ratio[frame, j]
            )
        if moment is not None:
            yield moment
    if limits.position is not None and np.isfinite(file.q).any():
        lower, upper = limits.position
        off_centre = np.abs(file.q - 0.5 * (lower + upper)) / (0.5 * (upper - lower))
        frame, j = np.unravel_index(np.nanargmax(off_centre), off_centre.shape)
        angle = float(file.q[frame, j])
        limit = float(upper[j] if angle > 0.5 * (lower[j] + upper[j]) else lower[j])
        yield _moment("joint_limit", limits.joints[j], t_s[frame], t_s[0], angle, limit, off_centre[frame, j])
    for kind, name in _DISTANCES.items():
        distance = file.curves.get(name)
        if distance is not None and np.isfinite(distance).any():
            nearest = int(np.nanargmin(distance))
            yield _moment(kind, None, t_s[nearest], t_s[0], float(distance[nearest]), 0.0, None)


def _checked(kind: str, check: Mapping[str, Json], limits: JointLimits, t_first: float) -> Moment | None:
    """What the details' check says; None if it names no joint that has a limit."""
    ratio, joint, time = number(check.get("ratio_max")), check.get("joint"), number(check.get("t_worst_s"))
    if ratio is None or joint not in limits.joints or kind not in limits.rates:
        return None
    limit = float(limits.rates[kind][limits.joints.index(str(joint))])
    return _moment(kind, str(joint), time, t_first, ratio * limit, limit, ratio)


def _moment(
    kind: str,
    joint: str | None,
    time: float | None,
    t_first: float,
    value: float,
    limit: float,
    ratio: float | None,
) -> Moment:
    factor, unit = _UNITS[kind]
    return Moment(
        kind=kind,
        label=_NEAR.get(kind, kind),
        broken=False,
        joint=joint,
        when="–" if time is None else f"{time:.2f} s",
        after_s=None if time is None else float(time - t_first),
        value=value * factor,
        limit=limit * factor,
        unit=unit,
        ratio=None if ratio is None else float(ratio),
    )


def _when(start: int, end: int, t_s: Array | None) -> str:
    frames = f"frame {start}" if start == end else f"frames {start} to {end}"
    if t_s is None or not 0 <= start <= end < len(t_s):
        return frames
    span = f"{t_s[start]:.2f} s" if start == end else f"{t_s[start]:.2f} to {t_s[end]:.2f} s"
    return f"{span} ({frames})"


def number(value: Json) -> float | None:
    """A value as a number; None where it is none."""
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None
