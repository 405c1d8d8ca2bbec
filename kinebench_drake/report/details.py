"""Details of one sample as lines of text: checks, noise, limits."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.report.moments import find_checks, number
from kinebench_drake.results.row import SampleRow
from kinebench_drake.types import Json

_SUFFIXES = {
    "_m": (1000.0, "mm"),
    "_rad": (180.0 / np.pi, "°"),
    "_s": (1.0, "s"),
    "_hz": (1.0, "Hz"),
    "_px": (1.0, "px"),
}
_MAX_ENTRIES = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class Fact:
    """One finding."""

    depth: int
    name: str
    text: str
    """Empty for the heading of the deeper ones that follow."""


def list_facts(details: Mapping[str, Json], depth: int = 0) -> Iterator[Fact]:
    """Findings in their order, those of an object after its name and one deeper; null ones are left out."""
    for key, value in details.items():
        factor, unit, name = _read(key)
        if value is None:
            continue
        if isinstance(value, Mapping):
            inner = list(list_facts(value, depth + 1))
            if inner:
                yield Fact(depth=depth, name=name, text="")
                yield from inner
        elif isinstance(value, Sequence) and any(isinstance(v, Mapping) for v in value):
            yield Fact(depth=depth, name=name, text="")
            for number, item in enumerate(value[:_MAX_ENTRIES], 1):
                if isinstance(item, Mapping):
                    told = "; ".join(f"{fact.name} {fact.text}" for fact in list_facts(item))
                    yield Fact(depth=depth + 1, name=str(number), text=told)
        else:
            yield Fact(depth=depth, name=name, text=_text(value, factor, unit))


def _read(key: str) -> tuple[float, str, str]:
    """Factor and unit to show a key's values in, and its name in words."""
    for suffix, (factor, unit) in _SUFFIXES.items():
        if key.endswith(suffix):
            return factor, unit, key.removesuffix(suffix).replace("_", " ")
    return 1.0, "", key.replace("_", " ")


def _text(value: Json, factor: float, unit: str) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        return f"{value * factor:.4g} {unit}".strip()
    if isinstance(value, Sequence) and not isinstance(value, str):
        entries = [_text(v, factor, "") for v in value[:_MAX_ENTRIES]]
        more = f" … ({len(value)} in all)" if len(value) > _MAX_ENTRIES else ""
        return f"{', '.join(entries)}{more} {unit}".strip()
    return "–" if value is None else str(value)


@dataclass(frozen=True, slots=True, kw_only=True)
class Resolution:
    """How well one kind of limit could be looked at."""

    kind: str
    window_s: float | None
    bandwidth_hz: float | None
    noise_ratio: float | None
    """Standard error / limit."""
    ratios: tuple[float | None, ...]
    """Greatest value / limit of each joint; None where the noise hides it or there is no limit."""


def resolutions(row: SampleRow) -> list[Resolution]:
    """Windows, bandwidths and joint ratios of the checks in a row's details."""
    found = []
    for kind, check in find_checks(row.details).items():
        ratios = check.get("ratios")
        found.append(
            Resolution(
                kind=kind,
                window_s=number(check.get("window_s")),
                bandwidth_hz=number(check.get("bandwidth_hz")),
                noise_ratio=number(check.get("noise_ratio")),
                ratios=tuple(number(r) for r in ratios) if isinstance(ratios, list | tuple) else (),
            )
        )
    return found


def summarize_checks(row: SampleRow, t_s: Array | None) -> list[Fact]:
    """Noise, slow-down, fastest run and tube of a row, as far as it has them."""
    lines = [
        ("noise of the track", _noise(row)),
        ("slow-down needed", _slowdown(row, t_s)),
        ("fastest run", _fastest(row, t_s)),
        ("smooth trajectory within all limits", _tube(row, t_s)),
    ]
    return [Fact(depth=0, name=name, text=text) for name, text in lines if text is not None]


def _noise(row: SampleRow) -> str | None:
    noise = _part(row, "noise")
    known = {k: v for k in ("position_m", "rotation_rad") if isinstance(v := noise.get(k), int | float)}
    # What is below a micrometre or a microradian is rounding.
    text = ", ".join(fact.text for fact in list_facts({k: 0.0 if v < 1e-6 else v for k, v in known.items()}))
    if not text:
        return None
    return f"{text} (assumed: the track is too short to tell)" if noise.get("assumed") is True else text


def _slowdown(row: SampleRow, t_s: Array | None) -> str | None:
    factor, by = number(row.metrics.get("slowdown_min")), _limiter(_part(row, "slowdown"), t_s)
    if factor is None:
        return None
    verdict = "none, " if factor <= 1.0 else ""
    return f"{verdict}{factor:.3g}{by and f', for {by}'}"


def _fastest(row: SampleRow, t_s: Array | None) -> str | None:
    scale, by = number(row.metrics.get("time_scale")), _limiter(_part(row, "time_scale"), t_s)
    return None if scale is None else f"{scale:.3g} of its own time{by and f', held back by {by}'}"


def _tube(row: SampleRow, t_s: Array | None) -> str | None:
    feasible, radius = row.metrics.get("trajopt_feasible"), number(row.metrics.get("trajopt_position_tube_m"))
    part = _part(row, "trajopt")
    against = part.get("against")
    asked = number(part.get("tube_limit_m"))
    bound = "" if asked is None else f" (allowed: {asked * 1000.0:.3g} mm)"
    if not isinstance(feasible, bool):
        return None
    found = f"within {radius * 1000.0:.3g} mm of the track{bound}" if radius is not None else f"none{bound}"
    if feasible or not isinstance(against, Mapping):
        return found
    value, limit = number(against.get("value")), number(against.get("limit"))
    numbers = "" if value is None or limit is None else f", {value:.4g} against {limit:.4g}"
    return f"{found}; {_limiter({**against, 'limit': against.get('kind')}, t_s)} stands against it{numbers}"


def _limiter(part: Mapping[str, Json], t_s: Array | None) -> str:
    """The limit, joint and time that a finding names; empty if it names no limit."""
    limit, joint, frame = part.get("limit"), part.get("joint"), part.get("frame")
    if limit is None:
        return ""
    whose = f" of {joint}" if joint is not None else ""
    when = ""
    if isinstance(frame, int):
        inside = t_s is not None and 0 <= frame < len(t_s)
        when = f" at {t_s[frame]:.2f} s" if inside and t_s is not None else f" in frame {frame}"
    return f"{str(limit).replace('_', ' ')}{whose}{when}"


def _part(row: SampleRow, name: str) -> Mapping[str, Json]:
    found = row.details.get(name)
    return found if isinstance(found, Mapping) else {}
