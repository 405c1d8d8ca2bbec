"""The limits of a row, and the peak of its track against each: the table of broken and nearest limits."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kinebench_drake.anomaly import Anomaly
from kinebench_drake.geometry import Array
from kinebench_drake.results.details import RateCheck, read_details
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.trackfile import TrackFile
from kinebench_drake.violation import UNITS, Violation

RATES = ("velocity", "acceleration", "jerk", "torque")
"""Limits on magnitudes per joint, also the names of their curves."""
_SHOWN = {
    "m": (1000.0, "mm"),
    "rad": (180.0 / np.pi, "°"),
    "rad/s": (1.0, "rad/s"),
    "rad/s^2": (1.0, "rad/s²"),
    "rad/s^3": (1.0, "rad/s³"),
    "N m": (1.0, "N m"),
}
"""Factor and unit for readers by unit in files."""
_KINDS = {kind.value: unit for kind, unit in UNITS.items()}
_LABELS = {
    "joint_limit": "joint angle",
    "self_collision": "self-collision clearance",
    "table_collision": "table clearance",
}
_DISTANCES = {"self_collision": "self_distance_m", "table_collision": "table_distance_m"}


@dataclass(frozen=True, slots=True, kw_only=True)
class RowLimits:
    """Limits that a track was judged by, in the order of its joints; None where a row has none."""

    joints: tuple[str, ...]
    """(7,) joint names."""
    position: tuple[Array, Array] | None
    """(7,) lower and upper limits [rad]."""
    rates: Mapping[str, Array]
    """(7,) greatest magnitudes by curve: `velocity` [rad/s], `acceleration` [rad/s^2], `jerk` [rad/s^3], `torque`
    [N m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitPeak:
    """The largest value of a track relative to one limit."""

    kind: str
    label: str
    """Name in the table."""
    broken: bool
    """True for a violation."""
    joint: str | None
    """Joint, or link and obstacle; None for limits of no single joint."""
    when: str
    """Time or frames, as text."""
    offset_s: float | None
    """Its start, after the track's start [s]; None if unknown."""
    value: float | None
    """In `unit`."""
    limit: float | None
    """In `unit`."""
    unit: str
    ratio: float | None
    """Value / limit, above 1 past the limit; None if undefined."""


def joint_limits(row: SampleRow) -> RowLimits:
    """Read the limits in a row's `details`."""
    limits = read_details(row).limits
    joints = limits.joints or tuple(f"joint {k + 1}" for k in range(7))
    position = limits.position
    rates = {name: getattr(limits, name) for name in RATES}
    return RowLimits(
        joints=tuple(joints),
        position=None if position is None else (_bounds(position.lower), _bounds(position.upper)),
        rates={name: _bounds(limit) for name, limit in rates.items() if limit is not None},
    )


def _bounds(values: Sequence[float]) -> Array:
    """Return limits (7,) as an array, infinite where there is none."""
    return np.where(np.isnan(values), np.inf, np.array(values, dtype=np.float64))


def limit_ratios(file: TrackFile, limits: RowLimits) -> dict[str, Array]:
    """Compute |value| / limit (T, 7) of the curves that have a limit; NaN where the curve has no value."""
    return {
        name: np.abs(file.curves[name]) / file.curves.get(f"{name}_limit", limit)
        for name, limit in limits.rates.items()
        if name in file.curves and file.curves[name].ndim == 2
    }


def find_peaks(row: SampleRow, file: TrackFile | None) -> list[LimitPeak]:
    """List all violations in the row's order, by cause, then the peaks against the other limits by ratio.

    Args:
        row: violations and details; the checks in `details` take precedence over the curves of the file.
        file: the track; None if there is none: violations then have frames instead of times.
    """
    violations = [locate_fault(v, file.track.t_s if file else None) for v in row.violations]
    kinds = {peak.kind for peak in violations}
    others = [peak for peak in _unbroken_peaks(row, file) if peak.kind not in kinds] if file else []
    return violations + sorted(others, key=lambda peak: 0.0 if peak.ratio is None else -peak.ratio)


def find_checks(row: SampleRow) -> dict[str, RateCheck]:
    """Return the checks of rate limits of a row by kind, those that have a ratio."""
    checks = read_details(row).checks
    return {kind: check for kind, check in checks.items() if kind in RATES and math.isfinite(check.ratio_max)}


def describe_violation(violation: Violation) -> str:
    """Describe a violation of a row in a clause: kind, joint, value and limit with their unit, frames."""
    peak = locate_fault(violation, None)
    joint = "" if peak.joint is None else f" of {peak.joint}"
    numbers = "" if None in (peak.value, peak.limit) else f", {peak.value:.4g} {peak.unit} (limit {peak.limit:.4g})"
    return f"{peak.label}{joint}{numbers}, {peak.when}"


def in_unit(kind: str, value: float) -> tuple[float, str]:
    """Return a value of a kind of limit as on the page, and its unit; empty for a kind without one."""
    factor, unit = _SHOWN.get(_KINDS.get(kind, ""), (1.0, ""))
    return value * factor, unit


def locate_fault(fault: Violation | Anomaly, t_s: Array | None) -> LimitPeak:
    """Return the worst moment of a violation, or of an anomaly, which has no value and no limit."""
    kind = fault.kind.value
    is_inside = t_s is not None and 0 <= fault.frame_start < len(t_s)
    peak = LimitPeak(
        kind=kind,
        label=kind.replace("_", " "),
        broken=True,
        joint=None,
        when=_format_span(fault.frame_start, fault.frame_end, t_s),
        offset_s=float(t_s[fault.frame_start] - t_s[0]) if is_inside else None,  # type: ignore[index]
        value=None,
        limit=None,
        unit="",
        ratio=None,
    )
    if isinstance(fault, Anomaly):
        return peak
    factor, unit = _SHOWN.get(fault.unit, (1.0, ""))
    is_number = math.isfinite(fault.value) and math.isfinite(fault.limit)
    return replace(
        peak,
        joint=" ".join(part for part in (fault.arm, fault.joint) if part) or None
        if fault.body is None
        else f"{fault.link} with {fault.body}",
        value=fault.value * factor if is_number else None,
        limit=fault.limit * factor if is_number else None,
        unit=unit,
        ratio=abs(fault.value / fault.limit) if kind in RATES and is_number and fault.limit else None,
    )


def format_frames(start: int, end: int) -> str:
    """Format a stretch of frames, such as `frames 3 to 9`; both ends are included."""
    return f"frame {start}" if start == end else f"frames {start} to {end}"


def _format_span(start: int, end: int, t_s: Array | None) -> str:
    frames = format_frames(start, end)
    if t_s is None or not 0 <= start <= end < len(t_s):
        return frames
    span = f"{t_s[start]:.2f} s" if start == end else f"{t_s[start]:.2f} to {t_s[end]:.2f} s"
    return f"{span} ({frames})"


def _limit_at(file: TrackFile, limits: RowLimits, kind: str, joint: int, frame: int | None) -> float:
    """Return the limit of a joint at a frame, of a kind whose limits may depend on the position."""
    own = file.curves.get(f"{kind}_limit")
    return float(limits.rates[kind][joint] if own is None or frame is None else own[frame, joint])


def _unbroken_peaks(row: SampleRow, file: TrackFile) -> Iterator[LimitPeak]:
    limits = joint_limits(row)
    t_s = file.track.t_s
    ratios = limit_ratios(file, limits)
    checks = find_checks(row)

    def peak(
        kind: str, joint: str | None, time: float | None, value: float, limit: float, ratio: float | None
    ) -> LimitPeak:
        factor, unit = _SHOWN[_KINDS[kind]]
        return LimitPeak(
            kind=kind,
            label=_LABELS.get(kind, kind),
            broken=False,
            joint=joint,
            when="–" if time is None else f"{time:.2f} s",
            offset_s=None if time is None else float(time - t_s[0]),
            value=value * factor,
            limit=limit * factor,
            unit=unit,
            ratio=None if ratio is None else float(ratio),
        )

    for kind in RATES:
        check = checks.get(kind)
        ratio = ratios.get(kind)
        if check is not None and check.joint in limits.joints and kind in limits.rates:
            limit = _limit_at(file, limits, kind, limits.joints.index(check.joint), check.frame)
            yield peak(kind, check.joint, check.t_worst_s, check.ratio_max * limit, limit, check.ratio_max)
        elif ratio is not None and np.isfinite(ratio).any():
            frame, j = np.unravel_index(np.nanargmax(ratio), ratio.shape)
            value = abs(float(file.curves[kind][frame, j]))
            limit = _limit_at(file, limits, kind, int(j), int(frame))
            yield peak(kind, limits.joints[j], t_s[frame], value, limit, ratio[frame, j])
    if limits.position is not None and np.isfinite(file.q).any():
        lower, upper = limits.position
        off_centre = np.abs(file.q - 0.5 * (lower + upper)) / (0.5 * (upper - lower))
        frame, j = np.unravel_index(np.nanargmax(off_centre), off_centre.shape)
        angle = float(file.q[frame, j])
        limit = float(upper[j] if angle > 0.5 * (lower[j] + upper[j]) else lower[j])
        yield peak("joint_limit", limits.joints[j], t_s[frame], angle, limit, off_centre[frame, j])
    for kind, name in _DISTANCES.items():
        distance = file.curves.get(name)
        if distance is not None and np.isfinite(distance).any():
            nearest = int(np.nanargmin(distance))
            yield peak(kind, None, t_s[nearest], float(distance[nearest]), 0.0, None)
