"""The drop list of a run: which samples of a data set not to train on, and why; also as SARIF.

GitHub and editors show the findings of checkers in that format. Source: OASIS, "Static Analysis Results Interchange
Format (SARIF) Version 2.1.0", 2020.
"""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from enum import Enum
from statistics import median
from urllib.parse import quote

from kinebench_drake.errors import count_noun
from kinebench_drake.io.jsonl import Json
from kinebench_drake.results.row import SampleRow, Status

DROPS = "drops.jsonl"
"""File of the drop list in an output folder."""
GATED = ("score", "audit")
"""Kinds of runs that end with a drop list."""

LONGEST_LAG_S = 0.5
"""Longest time in which a controlled arm follows its commands [s]."""
_SCHEMA = "https://docs.oasis-open.org/sarif/sarif/v2.1.0/errata01/os/schemas/sarif-schema-2.1.0.json"


class DropReason(Enum):
    """Reason to drop a sample, or frames of it, with its meaning."""

    NOT_MEASURED = "not_measured", "The sample cannot be read or measured."
    INFEASIBLE = "infeasible", "The robot cannot execute the motion."
    DROPPED_SAMPLES = "dropped_samples", "The recording lacks samples."
    IDLE_ENDS = "idle_ends", "The robot rests at the start or at the end."
    ACTION_OFFSET = "action_offset", "Actions and states are shifted against each other."
    DUPLICATE = "duplicate", "The motion is a copy of another sample's."

    def __init__(self, key: str, meaning: str) -> None:
        self.key = key
        self.meaning = meaning

    @property
    def drops_all(self) -> bool:
        """True if the whole sample is to be dropped, not its idle frames alone."""
        return self is not DropReason.IDLE_ENDS


@dataclass(frozen=True, slots=True, kw_only=True)
class Drop:
    """An entry of the drop list."""

    id: str
    video: str
    """Video or trajectory, as in the row."""
    reason: DropReason
    frame_start: int | None
    """First frame concerned (0-based); None for all frames."""
    frame_end: int | None
    """Last frame concerned, inclusive."""
    detail: str
    """The fault in a clause."""

    def to_json(self) -> dict[str, Json]:
        """Return the line of the drop list."""
        return {**asdict(self), "reason": self.reason.key}


def list_drops(rows: Iterable[SampleRow]) -> list[Drop]:
    """Return the drop list of rows, in their order; of equal motions the first stays."""
    rows = list(rows)
    usual = median([row.action_lag.frames for row in rows if row.action_lag is not None] or [0])
    first: dict[str, str] = {}
    drops = []
    for row in rows:
        faults = list(_faults(row, usual))
        mark = row.fingerprint
        if mark is not None and first.setdefault(mark, row.id) != row.id:
            faults.append((DropReason.DUPLICATE, (None, None), f"same motion as {first[mark]}"))
        for reason, (start, end), detail in faults:
            drop = Drop(id=row.id, video=row.video, reason=reason, frame_start=start, frame_end=end, detail=detail)
            drops.append(drop)
    return drops


def _faults(row: SampleRow, usual_lag: float) -> Iterable[tuple[DropReason, tuple[int | None, int | None], str]]:
    """Yield the reasons to drop a sample, besides that of being a copy, with frames and a clause."""
    if row.status is not Status.OK:
        yield DropReason.NOT_MEASURED, (None, None), row.reason or row.status.value
    if row.feasible is False:
        names = (f"{v.arm or ''} {v.kind.value.replace('_', ' ')}".strip() for v in row.violations)
        kinds = ", ".join(dict.fromkeys(names))
        start = min((v.frame_start for v in row.violations), default=None)
        yield DropReason.INFEASIBLE, (start, max((v.frame_end for v in row.violations), default=None)), kinds
    if gaps := row.dropped_samples:
        yield DropReason.DROPPED_SAMPLES, (gaps[0], gaps[-1]), f"{count_noun(len(gaps), 'sample')} missing"
    if row.idle_ends is not None and row.frames is not None:
        start, end = row.idle_ends
        if start:
            yield DropReason.IDLE_ENDS, (0, start - 1), f"rests for {start} frames at the start"
        if end:
            yield DropReason.IDLE_ENDS, (row.frames - end, row.frames - 1), f"rests for {end} frames at the end"
    lag = row.action_lag
    if lag is not None and row.frame_period_s is not None:
        late = lag.frames - lag.tolerance > LONGEST_LAG_S / row.frame_period_s
        if lag.frames + lag.tolerance < 0 or late or abs(lag.frames - usual_lag) > lag.tolerance + 1:
            detail = f"states follow actions by {count_noun(lag.frames, 'frame')}, in the data set by {usual_lag:g}"
            yield DropReason.ACTION_OFFSET, (None, None), detail


def to_sarif(drops: Sequence[Drop], version: str) -> dict[str, Json]:
    """Return the log of a drop list; `version` is that of this program. Frames are in the messages and properties."""
    rules: list[Json] = [{"id": reason.key, "shortDescription": {"text": reason.meaning}} for reason in DropReason]
    driver: dict[str, Json] = {"name": "kinebench-drake", "semanticVersion": version, "rules": rules}
    results = list(map(_result, drops))
    return {"$schema": _SCHEMA, "version": "2.1.0", "runs": [{"tool": {"driver": driver}, "results": results}]}


def _result(drop: Drop) -> Json:
    frames = "" if drop.frame_start is None else f", frames {drop.frame_start} to {drop.frame_end}"
    path, _, part = drop.video.partition("#")
    place: dict[str, Json] = {
        "physicalLocation": {"artifactLocation": {"uri": quote(path)}},
        "logicalLocations": [{"name": part or drop.id, "kind": "resource"}],
    }
    return {
        "ruleId": drop.reason.key,
        "ruleIndex": list(DropReason).index(drop.reason),
        "level": "error" if drop.reason.drops_all else "warning",
        "message": {"text": f"{drop.id}{frames}: {drop.detail}"},
        "locations": [place],
        "properties": {"frame_start": drop.frame_start, "frame_end": drop.frame_end},
    }
