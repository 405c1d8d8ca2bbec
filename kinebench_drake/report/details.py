"""Details of one sample as lines of text: summaries of the checks, and all other entries."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.io.jsonl import Json, as_object
from kinebench_drake.report.limits import in_unit, to_number
from kinebench_drake.results.row import SampleRow

_SUFFIXES = {
    "_m": (1000.0, "mm"),
    "_rad": (180.0 / np.pi, "°"),
    "_s": (1.0, "s"),
    "_hz": (1.0, "Hz"),
    "_px": (1.0, "px"),
}
"""Factor and unit on the page by suffix of the key."""
_MAX_ENTRIES = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class DetailLine:
    """One entry."""

    depth: int
    """Level of nesting."""
    name: str
    text: str
    """Value; empty for the heading of a nested object."""


def list_details(details: Mapping[str, Json], depth: int = 0) -> Iterator[DetailLine]:
    """List entries in their order, those of an object one level below its name; null entries are left out."""
    for key, value in details.items():
        suffix = next((suffix for suffix in _SUFFIXES if key.endswith(suffix)), "")
        factor, unit = _SUFFIXES.get(suffix, (1.0, ""))
        name = key.removesuffix(suffix).replace("_", " ")
        if value is None:
            continue
        if isinstance(value, Mapping):
            inner = list(list_details(value, depth + 1))
            if inner:
                yield DetailLine(depth=depth, name=name, text="")
                yield from inner
        elif isinstance(value, Sequence) and any(isinstance(v, Mapping) for v in value):
            yield DetailLine(depth=depth, name=name, text="")
            for number, item in enumerate(value[:_MAX_ENTRIES], 1):
                if isinstance(item, Mapping):
                    text = "; ".join(f"{line.name} {line.text}" for line in list_details(item))
                    yield DetailLine(depth=depth + 1, name=str(number), text=text)
        else:
            yield DetailLine(depth=depth, name=name, text=_format(value, factor, unit))


def _format(value: Json, factor: float, unit: str) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        return f"{value * factor:.4g} {unit}".strip()
    if isinstance(value, Sequence) and not isinstance(value, str):
        entries = [_format(v, factor, "") for v in value[:_MAX_ENTRIES]]
        more = f" … ({len(value)} in all)" if len(value) > _MAX_ENTRIES else ""
        return f"{', '.join(entries)}{more} {unit}".strip()
    return "–" if value is None else str(value)


def summarize_checks(row: SampleRow, t_s: Array | None) -> list[DetailLine]:
    """Summarize noise, slow-down, fastest execution and optimised trajectory of a row, as far as it has them."""
    lines = [
        ("noise of the track", _noise(row)),
        ("slow-down needed", _slowdown(row, t_s)),
        ("fastest execution", _fastest(row, t_s)),
        ("smooth trajectory within all limits", _trajectory(row, t_s)),
    ]
    return [DetailLine(depth=0, name=name, text=text) for name, text in lines if text is not None]


def _noise(row: SampleRow) -> str | None:
    noise = as_object(row.details.get("noise"))
    values = {k: v for k in ("position_m", "rotation_rad") if isinstance(v := noise.get(k), int | float)}
    # Values below a micrometre or a microradian are rounding errors.
    text = ", ".join(line.text for line in list_details({k: 0.0 if v < 1e-6 else v for k, v in values.items()}))
    if not text:
        return None
    return f"{text} (assumed: the track is too short for an estimate)" if noise.get("assumed") is True else text


def _slowdown(row: SampleRow, t_s: Array | None) -> str | None:
    factor, limit = to_number(row.metrics.get("slowdown_min")), _format_limit(row.details.get("slowdown"), t_s)
    return None if factor is None else f"{'none, ' if factor <= 1.0 else ''}{factor:.3g}{limit and f', for {limit}'}"


def _fastest(row: SampleRow, t_s: Array | None) -> str | None:
    scale, limit = to_number(row.metrics.get("time_scale")), _format_limit(row.details.get("time_scale"), t_s)
    return None if scale is None else f"{scale:.3g} of its own duration{limit and f', limited by {limit}'}"


def _trajectory(row: SampleRow, t_s: Array | None) -> str | None:
    feasible, radius = row.metrics.get("trajopt_feasible"), to_number(row.metrics.get("trajopt_position_tube_m"))
    if not isinstance(feasible, bool):
        return None
    section = as_object(row.details.get("trajopt"))
    tube, obstacle = to_number(section.get("tube_limit_m")), section.get("against")
    bound = "" if tube is None else f" (allowed: {tube * 1000.0:.3g} mm)"
    text = f"within {radius * 1000.0:.3g} mm of the track{bound}" if radius is not None else f"none{bound}"
    if feasible or not isinstance(obstacle, Mapping):
        return text
    value, limit = to_number(obstacle.get("value")), to_number(obstacle.get("limit"))
    kind, numbers = str(obstacle.get("kind")), ""
    if value is not None and limit is not None:
        (shown, unit), (most, _) = in_unit(kind, value), in_unit(kind, limit)
        numbers = f", {shown:.4g} against {most:.4g} {unit}".rstrip()
    return f"{text}; prevented by {_format_limit({**obstacle, 'limit': kind}, t_s)}{numbers}"


def _format_limit(details: Json, t_s: Array | None) -> str:
    """Format the limit, joint and time in the details of a check; empty if they name no limit."""
    limit, joint, frame = (as_object(details).get(key) for key in ("limit", "joint", "frame"))
    if limit is None:
        return ""
    when = ""
    if isinstance(frame, int):
        when = f" at {t_s[frame]:.2f} s" if t_s is not None and 0 <= frame < len(t_s) else f" in frame {frame}"
    return f"{str(limit).replace('_', ' ')}{'' if joint is None else f' of {joint}'}{when}"
