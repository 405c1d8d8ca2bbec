"""One line of `samples.jsonl`: the result of one sample.

In memory a stored row keeps its numbers and labels; what takes most bytes is read from the file on demand.
"""

import os
from collections.abc import ItemsView, Iterator, Mapping
from dataclasses import dataclass, field, fields
from enum import Enum
from functools import lru_cache
from pathlib import Path
from types import UnionType
from typing import Any, cast

from kinebench_drake.errors import InputError
from kinebench_drake.io.jsonl import Json, dump, finite, intern_text, parse_json
from kinebench_drake.results.direction import BOUND


class RowFile:
    """A file of lines, open as long as a row refers to it: rows stay readable when the file is replaced."""

    def __init__(self, path: Path) -> None:
        """Open the file.

        Raises:
            OSError: it cannot be opened.
        """
        self._fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)

    def __del__(self) -> None:
        if hasattr(self, "_fd"):
            os.close(self._fd)

    @property
    def size(self) -> int:
        """Size of the file [bytes]."""
        return os.fstat(self._fd).st_size

    def read(self, start: int, size: int) -> bytes:
        """Read a part of the file."""
        return os.pread(self._fd, size, start)


class RowLine:
    """Place of one row in a file: offset of its first byte and number of bytes."""

    __slots__ = ("file", "size", "start")

    def __init__(self, file: RowFile, start: int, size: int) -> None:
        self.file = file
        self.start = start
        self.size = size

    def read(self) -> bytes:
        """Return the bytes of the line, with its line feed."""
        return self.file.read(self.start, self.size)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(None), ()  # in another process the file is not open


class StoredObject(Mapping[str, Json]):
    """An object of a stored row, such as `details`: read and parsed at each access."""

    __slots__ = ("_line", "_name")

    def __init__(self, line: RowLine, name: str) -> None:
        self._line = line
        self._name = name

    def __getitem__(self, key: str) -> Json:
        return self._parse()[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._parse())

    def __len__(self) -> int:
        return len(self._parse())

    def items(self) -> ItemsView[str, Json]:
        """Return names and values; the row is read once."""
        return self._parse().items()

    def __repr__(self) -> str:
        return repr(self._parse())

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (self._parse(),)

    def _parse(self) -> dict[str, Json]:
        row = cast(dict[str, Any], parse_json(self._line.read()))
        return cast(dict[str, Json], intern_text(row[self._name]))


class PackedObject(Mapping[str, Json]):
    """An object with few bytes: its names are shared with all objects of the same names."""

    __slots__ = ("_places", "_values")

    def __init__(self, values: Mapping[str, Json]) -> None:
        self._places = _places(tuple(values))
        self._values = tuple(map(_pack_value, values.values()))

    def __getitem__(self, key: str) -> Json:
        return self._values[self._places[key]]

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        return repr(dict(self))

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (dict(self),)


def _pack_value(value: Json) -> Json:
    if value is None or isinstance(value, float | int):  # most values: what follows takes longer
        return value
    if isinstance(value, Mapping | list):
        text = dump(value)
        # Many samples have the same camera or framing: short objects are kept and shared.
        return _shared(text) if len(text) <= 200 else cast(Json, intern_text(value))
    return cast(Json, intern_text(value))


@lru_cache(maxsize=4096)
def _places(names: tuple[str, ...]) -> dict[str, int]:
    return {intern_text(name): k for k, name in enumerate(names)}


@lru_cache(maxsize=4096)
def _shared(text: str) -> Json:
    return cast(Json, intern_text(parse_json(text)))


class Status(Enum):
    """Outcome of a sample."""

    OK = "ok"
    UNMEASURABLE = "unmeasurable"
    ERROR = "error"


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleRow:
    """The result of one sample."""

    id: str
    video: str
    """Video or trajectory as named by the input, relative to it."""
    task: str | None
    model: str | None
    status: Status
    reason: str | None
    """Reason for a status other than ok, one line."""
    content_hash: str
    """SHA-256 of all inputs of the result: a row with the same hash need not be computed again."""
    feasible: bool | None = None
    executable: bool | None = None
    executable_reasons: tuple[str, ...] = ()
    """What speaks against executing the sample, and what could not be measured (`metrics.executable`)."""
    violations: tuple[Mapping[str, Json], ...] = ()
    """Objects of kind, frame_start, frame_end, joint, value, limit, unit; by cause, within a kind by frame."""
    metrics: Mapping[str, Json] = field(default_factory=dict)
    """Metrics by name: numbers, booleans, lists, or null if not measurable. Where frames are lost or out of reach,
    NAME_bound is the worst that NAME can be."""
    null_reasons: Mapping[str, str] = field(default_factory=dict)
    """Reason for each null metric, by name; for a sample that is not ok see `reason`."""
    details: Mapping[str, Json] = field(default_factory=dict)
    """Data behind the verdict: noise, limits per joint and others."""
    extra: Mapping[str, Json] = field(default_factory=dict)
    """Further top-level keys. Videos: frames, width, height, fps, frame_period_s, frame_period_source,
    camera_source, seed, prompt. Trajectories: frames, frames_tracked, duration_s, frame_period_s, judged,
    columns, warnings, format, seed, prompt, success. Suite runs: success, progress, rounds, verdict."""
    line: RowLine | None = field(default=None, compare=False, repr=False)
    """Place in the file of a stored row."""

    @property
    def sample_index(self) -> int:
        """Number of the sample among those of its episode, from 0."""
        index = self.extra.get("sample_index")
        return index if isinstance(index, int) else 0

    @property
    def episode(self) -> str:
        """Id of the episode, which is that of its first sample."""
        return self.id.removesuffix(sample_suffix(self.sample_index))

    def bound(self, name: str) -> Json:
        """Return the worst that a metric can be, by which samples are compared: its value unless frames are lost."""
        return self.metrics.get(name + BOUND, self.metrics.get(name))

    def to_json(self) -> dict[str, Json]:
        """Return the JSON object, in a fixed order of keys, without NaN, infinity or invalid text."""
        values = {name: getattr(self, name) for name in _NAMES}
        values["status"] = self.status.value
        return cast(dict[str, Json], intern_text(finite({**values, **self.extra})))

    def is_same(self, other: "SampleRow") -> bool:
        """Return whether both rows have the same JSON."""
        if self.line is not None and other.line is not None and self.line.read() == other.line.read():
            return True
        return dump(self.to_json()) == dump(other.to_json())

    @classmethod
    def from_json(cls, data: object, line: RowLine | None = None) -> "SampleRow":
        """Convert a parsed line; unknown keys go to `extra`.

        Args:
            line: its place in a file, from which the row reads on demand what takes most memory; None: it keeps all.

        Raises:
            InputError: the object is not a row.
        """
        if not isinstance(data, dict):
            raise InputError(f"expected an object, found {type(data).__name__}")
        data = cast(dict[str, Any], data)
        values: dict[str, Any] = {name: intern_text(data[name]) for name in _LABELS if name in data}
        try:
            values["status"] = Status(values["status"])
            values["executable_reasons"] = tuple(values.get("executable_reasons") or ())
            values["violations"] = tuple(map(PackedObject, data.get("violations") or ()))
            values["metrics"] = PackedObject(data.get("metrics") or {})
            for name in _STORED:
                stored = data.get(name) or {}
                is_object = isinstance(stored, dict)
                values[name] = StoredObject(line, name) if line and stored and is_object else intern_text(stored)
            extra = PackedObject({k: v for k, v in data.items() if k not in _NAMES})
            row = cls(**values, extra=extra, line=line)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise InputError(f"not a row of samples.jsonl ({error})") from None
        for name, kind in _TYPES.items():
            if not isinstance(getattr(row, name), kind):
                raise InputError(f"not a row of samples.jsonl ({name} is {getattr(row, name)!r:.60})")
        # The id names the sample's files.
        if not row.id or row.id != Path(row.id).name or row.id.startswith(".") or "\0" in row.id:
            raise InputError(f"not a row of samples.jsonl (its id {row.id!r:.60} is no file name)")
        if not all(isinstance(v, Mapping) and isinstance(v.get("kind"), str) for v in row.violations):
            raise InputError("not a row of samples.jsonl (a violation has no kind)")
        return row


def sample_suffix(index: int) -> str:
    """Return what follows the id of an episode in that of one of its samples; the first sample has the same id."""
    return f"_k{index}" if index else ""


_STORED = ("null_reasons", "details")
"""Fields that are read from the file on demand."""
_NAMES = tuple(f.name for f in fields(SampleRow) if f.name not in ("extra", "line"))
"""Keys of every row, in their order."""
_LABELS = {*_NAMES} - {"violations", "metrics", *_STORED}
_TYPES: Mapping[str, type | UnionType] = {
    **dict.fromkeys(("id", "video", "content_hash"), str),
    **dict.fromkeys(("task", "model", "reason"), str | None),
    **dict.fromkeys(("metrics", "null_reasons", "details"), Mapping),
    **dict.fromkeys(("feasible", "executable"), bool | None),
}
