"""Rows of `samples.jsonl` for tests, from their JSON values."""

from kinebench_drake.results.record import read_record
from kinebench_drake.results.row import Metrics, SampleRow, Status
from kinebench_drake.violation import UNITS, Violation, ViolationKind


def make_violation(kind="velocity", frame_start=0, frame_end=0, joint=None, value=2.0, limit=1.0, unit=None, **others):
    """Return a violation of a kind; what a test does not depend on may be left out."""
    unit = unit or UNITS[ViolationKind(kind)]
    data = {"kind": kind, "frame_start": frame_start, "frame_end": frame_end, "joint": joint}
    return read_record(Violation, {**data, "value": value, "limit": limit, "unit": unit, **others})


def make_row(id="a", status=Status.OK, *, metrics=(), violations=(), extra=(), **changes):
    """Return a row; `extra` are its further keys."""
    row = SampleRow(
        **{
            **{"id": id, "video": f"{id}.mp4", "task": None, "model": None, "status": status, "content_hash": "0"},
            **{"reason": None if status is Status.OK else "because", **changes},
        },
        metrics=Metrics.from_json(dict(metrics)),
        violations=tuple(v if isinstance(v, Violation) else make_violation(**v) for v in violations),
    )
    return row.extended(**dict(extra))


def make_cause(verdict, text="never on target"):
    """Return the JSON object of a cause of failure."""
    return {"verdict": verdict, **dict.fromkeys(("round", "frame_start", "frame_end", "value", "limit")), "text": text}
