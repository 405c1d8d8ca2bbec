"""JSON made wrong: values of wrong types and sizes, keys missing and added, depths that no one expects."""

import copy
import json
from collections.abc import Iterator
from typing import Any

from numpy.random import Generator

from kinebench_drake.validation.fuzz.octets import mutate_bytes

ODD: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 3, 2**31, 2**63, 2**64, -(2**63), 10**400, 0.5, -0.0, 1e308, -1e308, 1e-320),
    *(float("nan"), float("inf"), float("-inf"), "", " ", "nan", "1", "-1", "1e999", "true", "null", ".", "..", "/"),
    *("../../etc/passwd", "/etc/passwd", "a/../../b", "~root", "a\0b", "\x1b[2Jgone", "two\nlines", "\r", "\ud800"),
    *("\u202egnp.exe", "\u0000", "é" * 200, "x" * 10_000, "<script>alert(1)</script>", "{episode_chunk:99999999999d}"),
    *(
        "{x.__class__}",
        "%n%s",
        "${HOME}",
        "`id`",
        "v2.1",
        "con",
        "NUL",
        [],
        {},
        [[]],
        [None],
        [1, [2, [3]]],
        [[1, 2], [3]],
    ),
    *({"": {}}, {"bytes": "x"}, [0] * 1000, [[0.0] * 4] * 4, {"status_code": "0"}, [float("nan")] * 7),
)
"""What stands where something else is expected."""
_DEEP = (50, 900, 5_000, 200_000)


def mutate_json(rng: Generator, data: bytes) -> bytes:
    """A JSON text after changes to what it says, or to its letters."""
    if rng.random() < 0.25:
        return mutate_bytes(rng, data) if rng.random() < 0.7 else _foul(rng, data)
    try:
        return dump(mutate_value(rng, json.loads(data)))
    except (ValueError, RecursionError, OverflowError):  # made wrong before, or beyond what can be written
        return mutate_bytes(rng, data)


def mutate_lines(rng: Generator, data: bytes) -> bytes:
    """JSON lines after changes to one or more of them."""
    lines = data.split(b"\n")
    for _ in range(min(int(rng.geometric(0.7)), 4)):
        k = int(rng.integers(len(lines)))
        kind = rng.random()
        if kind < 0.7:
            lines[k] = mutate_json(rng, lines[k])
        elif kind < 0.8:
            lines.insert(k, lines[int(rng.integers(len(lines)))])
        elif kind < 0.9 and len(lines) > 1:
            del lines[k]
        else:
            return mutate_bytes(rng, b"\n".join(lines))
    return b"\n".join(lines)


def mutate_value(rng: Generator, value: Any) -> Any:
    """A value after one to four changes anywhere in it; the given one stays as it is."""
    value = [copy.deepcopy(value)]  # so that the whole has a place, too
    for _ in range(min(int(rng.geometric(0.6)), 4)):
        places = list(_places(value))
        holder, key = places[int(len(places) * rng.random())]
        _change(rng, holder, key)
        value = value or [None]
    return value[0]


def dump(value: Any) -> bytes:
    """JSON as lax writers have it: with NaN and infinity, in ASCII."""
    return json.dumps(value).encode()


def odd(rng: Generator) -> Any:
    """Something that nobody expects."""
    return copy.deepcopy(ODD[int(rng.integers(len(ODD)))])


def _places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Every place in a value, by what holds it and its key or number there."""
    todo = [value]
    while todo:
        holder = todo.pop()
        for key in list(holder) if isinstance(holder, dict) else range(len(holder)):
            yield holder, key
            if isinstance(holder[key], dict | list):
                todo.append(holder[key])


def _change(rng: Generator, holder: Any, key: Any) -> None:
    kind, old = int(rng.integers(10)), holder[key]
    if kind == 0:
        del holder[key]
    elif kind == 1 and isinstance(holder, dict):
        holder[str(odd(rng))] = odd(rng)
    elif kind == 1:
        holder.insert(key, odd(rng))
    elif kind == 2:
        holder[key] = [old]
    elif kind == 3:
        holder[key] = {"value": old}
    elif kind == 4 and isinstance(old, int | float) and not isinstance(old, bool):
        holder[key] = old * float(rng.choice([-1.0, 0.0, 1e-6, 1e3, 1e30, 1e308]))
    elif kind == 4:
        holder[key] = str(old)[:200]
    elif kind == 5 and isinstance(holder, dict):
        holder[f"{key} "] = holder.pop(key)
    elif kind == 6 and isinstance(old, list) and old:
        holder[key] = old[: int(rng.integers(len(old)))] if rng.random() < 0.5 else old * 3
    else:
        holder[key] = odd(rng)


def _foul(rng: Generator, data: bytes) -> bytes:
    """Texts that parsers stumble over."""
    depth = _DEEP[int(rng.integers(len(_DEEP)))]
    choices = (
        b"[" * depth + b"]" * depth,
        b'{"a":' * depth + b"1" + b"}" * depth,
        b"[" * depth,
        b"\xef\xbb\xbf" + data,
        data.decode(errors="replace").encode("utf-16"),
        data.replace(b'"', b"'"),
        b"9" * 5_000,
        b'"\\ud800"',
        data + data,
        b"\0" * 64,
        data.replace(b":", b": 1" + b"0" * 5_000 + b" ,", 1),
    )
    return choices[int(rng.integers(len(choices)))]
