"""One line of `samples.jsonl`: the result of one sample."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from enum import Enum
from pathlib import Path
from types import UnionType
from typing import Any, cast

from kinebench_drake.errors import InputError
from kinebench_drake.io.jsonl import Json, finite, intern_text
from kinebench_drake.results.rowfile import PackedObject, RowLine, StoredObject


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
    """What is against executing the sample as a whole (`metrics.executable`); empty if it is executable."""
    violations: tuple[Mapping[str, Json], ...] = ()
    """Objects of kind, frame_start, frame_end, joint, value, limit."""
    metrics: Mapping[str, Json] = field(default_factory=dict)
    """Metrics by name: numbers, booleans, lists, or null if not measurable."""
    null_reasons: Mapping[str, str] = field(default_factory=dict)
    """Reason for each null metric, by name; for a sample that is not ok see `reason`."""
    without_lost: Mapping[str, Json] = field(default_factory=dict)
    """Of a sample with lost or unreachable frames: metrics of the other frames alone, where these differ."""
    details: Mapping[str, Json] = field(default_factory=dict)
    """Data behind the verdict: noise, limits per joint and others."""
    extra: Mapping[str, Json] = field(default_factory=dict)
    """Further top-level keys. Videos: frames, width, height, fps, frame_period_s, frame_period_source,
    camera_source, seed, prompt. Trajectories: frames, frames_tracked, duration_s, frame_period_s, judged,
    columns, warnings, format, seed, prompt, success. Suite runs: success, progress, rounds, verdict."""

    @property
    def sample_index(self) -> int:
        """Number of the sample among those of its episode, from 0."""
        index = self.extra.get("sample_index")
        return index if isinstance(index, int) else 0

    @property
    def episode(self) -> str:
        """Id of the episode, which is that of its first sample."""
        return self.id.removesuffix(sample_suffix(self.sample_index))

    def to_json(self) -> dict[str, Json]:
        """Return the JSON object, in a fixed order of keys, without NaN, infinity or invalid text."""
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "extra"}
        values["status"] = self.status.value
        return cast(dict[str, Json], intern_text(finite({**values, **self.extra})))

    @classmethod
    def from_json(cls, data: object, line: RowLine | None = None) -> "SampleRow":
        """Convert a parsed line; unknown keys go to `extra`.

        Args:
            data: JSON value.
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
            row = cls(**values, extra=extra)
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


_STORED = ("null_reasons", "without_lost", "details")
"""Fields that are read from the file on demand."""
_NAMES = frozenset(f.name for f in fields(SampleRow)) - {"extra"}
_LABELS = _NAMES - {"violations", "metrics", *_STORED}
_TYPES: Mapping[str, type | UnionType] = {
    **dict.fromkeys(("id", "video", "content_hash"), str),
    **dict.fromkeys(("task", "model", "reason"), str | None),
    **dict.fromkeys(("metrics", "null_reasons", "without_lost", "details"), Mapping),
    **dict.fromkeys(("feasible", "executable"), bool | None),
}
