"""Nested findings of a row as lines of text, with units read off the keys' suffixes."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kinebench_drake.row import Json

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
