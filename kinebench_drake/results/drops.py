"""The drop list of a run: which samples of a data set not to train on, and why."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from statistics import median

from kinebench_drake.errors import count_noun
from kinebench_drake.io.jsonl import Json, as_object, write_lines
from kinebench_drake.results.row import SampleRow, Status

DROPS = "drops.jsonl"
"""File of the drop list in an output folder."""
GATED = ("score", "audit")
"""Kinds of runs that end with a drop list."""
MOST_LAG_S = 0.5
"""Longest time in which a controlled arm follows its commands [s]."""


class DropReason(Enum):
    """Reason to drop a sample, or frames of it."""

    NOT_MEASURED = "not_measured"
    INFEASIBLE = "infeasible"
    DROPPED_SAMPLES = "dropped_samples"
    IDLE_ENDS = "idle_ends"
    ACTION_OFFSET = "action_offset"
    DUPLICATE = "duplicate"

    @property
    def meaning(self) -> str:
        """The fault in one sentence."""
        return _MEANINGS[self]

    @property
    def drops_all(self) -> bool:
        """True if the whole sample is to be dropped, not its idle frames alone."""
        return self is not DropReason.IDLE_ENDS


_MEANINGS = {
    DropReason.NOT_MEASURED: "The sample cannot be read or measured.",
    DropReason.INFEASIBLE: "The robot cannot execute the motion.",
    DropReason.DROPPED_SAMPLES: "The recording lacks samples.",
    DropReason.IDLE_ENDS: "The robot rests at the start or at the end.",
    DropReason.ACTION_OFFSET: "Actions and states are shifted against each other.",
    DropReason.DUPLICATE: "The motion is a copy of another sample's.",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Drop:
    """An entry of the drop list."""

    id: str
    video: str
    """Video or trajectory, as in the row."""
    reason: DropReason
    frames: tuple[int, int] | None
    """First and last frame concerned (0-based, inclusive); None for all, or unknown."""
    detail: str
    """The fault in a clause."""

    def to_json(self) -> dict[str, Json]:
        """Return the line of the drop list."""
        start, end = self.frames or (None, None)
        return {
            "id": self.id,
            "video": self.video,
            "reason": self.reason.value,
            "frame_start": start,
            "frame_end": end,
            "detail": self.detail,
        }


def list_drops(rows: Iterable[SampleRow]) -> list[Drop]:
    """Return the drop list of rows, in their order; of equal motions the first stays."""
    rows = list(rows)
    lags = [as_object(row.extra.get("action_lag")).get("frames") for row in rows]
    usual = median([lag for lag in lags if isinstance(lag, int)] or [0])
    first: dict[str, str] = {}
    drops = []
    for row in rows:
        for reason, frames, detail in _faults(row, usual):
            drops.append(Drop(id=row.id, video=row.video, reason=reason, frames=frames, detail=detail))
        mark = row.extra.get("fingerprint")
        if isinstance(mark, str) and first.setdefault(mark, row.id) != row.id:
            detail = f"same motion as {first[mark]}"
            drops.append(Drop(id=row.id, video=row.video, reason=DropReason.DUPLICATE, frames=None, detail=detail))
    return drops


def write_drops(out: Path, drops: Sequence[Drop]) -> None:
    """Write the drop list of an output folder.

    Raises:
        SetupError: writing failed.
    """
    write_lines(out / DROPS, (drop.to_json() for drop in drops))


def _faults(row: SampleRow, usual_lag: float) -> Iterable[tuple[DropReason, tuple[int, int] | None, str]]:
    """Yield the reasons to drop a sample, besides that of being a copy, with frames and a clause."""
    extra = row.extra
    if row.status is not Status.OK:
        yield DropReason.NOT_MEASURED, None, row.reason or row.status.value
    if row.feasible is False:
        runs = [(int(str(v["frame_start"])), int(str(v["frame_end"]))) for v in row.violations]
        kinds = ", ".join(dict.fromkeys(str(v["kind"]).replace("_", " ") for v in row.violations))
        span = (min(start for start, _ in runs), max(end for _, end in runs)) if runs else None
        yield DropReason.INFEASIBLE, span, kinds
    gaps = extra.get("dropped_samples")
    if isinstance(gaps, list) and gaps:
        at = [int(str(frame)) for frame in gaps]
        yield DropReason.DROPPED_SAMPLES, (at[0], at[-1]), f"{count_noun(len(at), 'sample')} missing"
    idle, count = extra.get("idle_ends"), extra.get("frames")
    if isinstance(idle, list) and isinstance(count, int):
        start, end = (int(str(rest)) for rest in idle)
        if start:
            yield DropReason.IDLE_ENDS, (0, start - 1), f"rests for {start} frames at the start"
        if end:
            yield DropReason.IDLE_ENDS, (count - end, count - 1), f"rests for {end} frames at the end"
    lag, period_s = as_object(extra.get("action_lag")), extra.get("frame_period_s")
    if lag and isinstance(period_s, float):
        value, doubt = int(str(lag["frames"])), int(str(lag["tolerance"]))
        late = value - doubt > MOST_LAG_S / period_s
        if value + doubt < 0 or late or abs(value - usual_lag) > doubt + 1:
            detail = f"states follow actions by {count_noun(value, 'frame')}, in the data set by {usual_lag:g}"
            yield DropReason.ACTION_OFFSET, None, detail
