"""One line of `samples.jsonl`: what became of one sample."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from enum import Enum
from pathlib import Path
from types import UnionType
from typing import Any, cast

from kinebench_drake.errors import InputError
from kinebench_drake.io.jsonl import finite, intern_text
from kinebench_drake.types import Json


class Status(Enum):
    """How far a sample got."""

    OK = "ok"
    UNMEASURABLE = "unmeasurable"
    ERROR = "error"


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleRow:
    """The result of one sample."""

    id: str
    video: str
    """The video or trajectory as named by the input, relative to it."""
    task: str | None
    model: str | None
    status: Status
    reason: str | None
    """One line saying why the status is not ok."""
    content_hash: str
    """SHA-256 of everything the result follows from: the same hash need not be computed again."""
    feasible: bool | None = None
    violations: tuple[Mapping[str, Json], ...] = ()
    """Objects of kind, frame_start, frame_end, joint, value, limit."""
    metrics: Mapping[str, Json] = field(default_factory=dict)
    """Metric names to numbers, booleans, lists, or null where there is nothing to measure."""
    null_reasons: Mapping[str, str] = field(default_factory=dict)
    """Why a metric is null, by its name; of a sample that is not ok `reason` says it."""
    details: Mapping[str, Json] = field(default_factory=dict)
    """What stands behind the verdict: noise, limits joint by joint and the like."""
    extra: Mapping[str, Json] = field(default_factory=dict)
    """Further top-level keys. Of a video: frames, width, height, fps, frame_period_s, frame_period_source,
    camera_source, seed, prompt. Of a trajectory: frames, frames_tracked, duration_s, frame_period_s, judged,
    columns, warnings, format, seed, prompt, success. Of a suite run: success, progress, rounds, verdict."""

    def slim(self) -> "SampleRow":
        """The same row for keeping and writing: half as large, as it comes from a worker process, with sound texts."""
        return replace(self, **{f.name: intern_text(getattr(self, f.name)) for f in fields(self)})

    def to_json(self) -> dict[str, Json]:
        """The object as written, in a fixed order of keys, without NaN or infinity."""
        named = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "extra"}
        named["status"] = self.status.value
        return cast(dict[str, Json], finite({**named, **self.extra}))

    @classmethod
    def from_json(cls, data: object) -> "SampleRow":
        """Row from a parsed line; keys of no field of their own go to `extra`.

        Raises:
            InputError: the object is no row.
        """
        if not isinstance(data, dict):
            raise InputError(f"expected an object, found {type(data).__name__}")
        data = cast(dict[str, Any], intern_text(data))
        names = {f.name for f in fields(cls)} - {"extra"}
        known = {k: v for k, v in data.items() if k in names}
        try:
            known["status"] = Status(known["status"])
            known["violations"] = tuple(known.get("violations") or ())
            for name in ("metrics", "null_reasons", "details"):
                known[name] = known.get(name) or {}
            row = cls(**known, extra={k: v for k, v in data.items() if k not in names})
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"not a row of samples.jsonl ({error})") from None
        for name, form in _FORMS.items():
            if not isinstance(getattr(row, name), form):
                raise InputError(f"not a row of samples.jsonl ({name} is {getattr(row, name)!r:.60})")
        # The id names the sample's files.
        if not row.id or row.id != Path(row.id).name or row.id.startswith(".") or "\0" in row.id:
            raise InputError(f"not a row of samples.jsonl (its id {row.id!r:.60} is no file name)")
        if not all(isinstance(v, Mapping) and isinstance(v.get("kind"), str) for v in row.violations):
            raise InputError("not a row of samples.jsonl (a violation is of no kind)")
        return row


_FORMS: Mapping[str, type | UnionType] = {
    **dict.fromkeys(("id", "video", "content_hash"), str),
    **dict.fromkeys(("task", "model", "reason"), str | None),
    **dict.fromkeys(("metrics", "null_reasons", "details"), Mapping),
    "feasible": bool | None,
}
