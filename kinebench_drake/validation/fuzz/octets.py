"""Bytes made wrong, whatever they mean."""

import re
from collections.abc import Callable

from numpy.random import Generator

_LONGEST = 4096  # bytes that one change touches
_INTEGERS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 2**63 - 1, 2**64 - 1)
_NUMBERS = (b"0", b"-1", b"1e308", b"1e999", b"NaN", b"nan", b"inf", b"99999999999999999999", b"0x10", b"", b"1_0")
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


def mutate_bytes(rng: Generator, data: bytes) -> bytes:
    """The bytes after one to four changes."""
    for _ in range(min(int(rng.geometric(0.5)), 4)):
        data = _CHANGES[int(rng.integers(len(_CHANGES)))](rng, data)
    return data


def _span(rng: Generator, data: bytes) -> tuple[int, int]:
    """A stretch of the data, short ones and those near the beginning more often."""
    length = min(int(rng.geometric(0.05)) if rng.random() < 0.8 else int(rng.integers(1, _LONGEST)), len(data))
    last = max(len(data) - length, 0)
    begin = int(last * rng.random() ** 2) if last else 0
    return begin, begin + length


def _flip(rng: Generator, data: bytes) -> bytes:
    if not data:
        return data
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 9))):
        changed[int(len(data) * rng.random() ** 2)] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def _noise(rng: Generator, data: bytes) -> bytes:
    begin, end = _span(rng, data)
    return data[:begin] + rng.bytes(end - begin) + data[end:]


def _truncate(rng: Generator, data: bytes) -> bytes:
    return data[: int(len(data) * rng.random())]


def _behead(rng: Generator, data: bytes) -> bytes:
    return data[_span(rng, data)[1] :]


def _drop(rng: Generator, data: bytes) -> bytes:
    begin, end = _span(rng, data)
    return data[:begin] + data[end:]


def _double(rng: Generator, data: bytes) -> bytes:
    begin, end = _span(rng, data)
    return data[:end] + data[begin:end] * int(rng.integers(1, 20)) + data[end:]


def _fill(rng: Generator, data: bytes) -> bytes:
    begin, end = _span(rng, data)
    return data[:begin] + bytes([int(rng.choice([0, 0, 0x20, 0xFF]))]) * (end - begin) + data[end:]


def _splice(rng: Generator, data: bytes) -> bytes:
    """A stretch of the data over another."""
    begin, end = _span(rng, data)
    at = int(rng.integers(len(data) + 1))
    return data[:at] + data[begin:end] + data[at + end - begin :]


def _swap(rng: Generator, data: bytes) -> bytes:
    a, b = sorted((_span(rng, data), _span(rng, data)))
    if a[1] > b[0]:
        return data
    return data[: a[0]] + data[b[0] : b[1]] + data[a[1] : b[0]] + data[a[0] : a[1]] + data[b[1] :]


def _integer(rng: Generator, data: bytes) -> bytes:
    """An integer that counts, sizes and offsets like to be."""
    size = int(rng.choice([1, 2, 4, 8]))
    number = int(_INTEGERS[int(rng.integers(len(_INTEGERS)))]) % (1 << (8 * size))
    begin = _span(rng, data)[0]
    return data[:begin] + number.to_bytes(size, "big" if rng.random() < 0.5 else "little") + data[begin + size :]


def _number(rng: Generator, data: bytes) -> bytes:
    """A number written in digits, replaced by another."""
    found = list(_NUMBER.finditer(data[:_LONGEST]))
    if not found:
        return _flip(rng, data)
    match = found[int(rng.integers(len(found)))]
    return data[: match.start()] + _NUMBERS[int(rng.integers(len(_NUMBERS)))] + data[match.end() :]


def _append(rng: Generator, data: bytes) -> bytes:
    return data + rng.bytes(int(rng.integers(1, 200)))


def _empty(rng: Generator, data: bytes) -> bytes:
    return b"" if rng.random() < 0.2 else _flip(rng, data)


_CHANGES: tuple[Callable[[Generator, bytes], bytes], ...] = (
    *(_flip, _flip, _noise, _truncate, _truncate, _behead, _drop, _double, _fill, _splice, _swap),
    *(_integer, _integer, _number, _append, _empty),
)
