"""An audit's rows held against the truth: false alarms, faults found, reasons named, rows that explain nothing."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from benchmarks.sample import Kind, Truth
from kinebench_drake.errors import InputError, cause
from kinebench_drake.results.aggregate import Estimate, estimate
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.types import Json


@dataclass(frozen=True, slots=True, kw_only=True)
class Count:
    """How often something was so, and where."""

    share: Estimate
    """Share with its interval (Wilson, 95 %)."""
    hits: int
    """Numerator of the share."""
    ids: tuple[str, ...]
    """The trajectories to look at: false alarms, misses, wrong reasons."""

    def to_json(self) -> dict[str, Json]:
        """As an object."""
        return {"hits": self.hits, **self.share.to_json(), "ids": list(self.ids)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """One kind of trajectories in numbers."""

    kind: Kind
    total: int
    """Trajectories of the kind."""
    judged_infeasible: Count
    """Rows that say infeasible: false alarms where the truth is feasible, detections where it is not. The ids are
    those that are wrong."""
    reason_named: Count | None
    """Rows that say infeasible and name a right reason, of all of a planted kind; the ids are those that do not."""
    undecided: tuple[str, ...]
    """Rows whose `feasible` is null."""
    missing: tuple[str, ...]
    """Trajectories without a row."""
    errors: tuple[str, ...]
    """Rows with status error."""
    unexplained: tuple[str, ...]
    """Rows with status error, or without a reason where one is due: not ok, or a null metric."""

    def to_json(self) -> dict[str, Json]:
        """As an object."""
        return {
            "kind": self.kind.value,
            "total": self.total,
            "judged_infeasible": self.judged_infeasible.to_json(),
            "reason_named": None if self.reason_named is None else self.reason_named.to_json(),
            "undecided": list(self.undecided),
            "missing": list(self.missing),
            "errors": list(self.errors),
            "unexplained": list(self.unexplained),
        }


def read_rows(path: Path) -> list[SampleRow]:
    """Rows of a samples.jsonl, or of the output folder that holds it.

    Raises:
        InputError: it is absent or damaged.
    """
    file = path / "samples.jsonl" if path.is_dir() else path
    try:
        return [SampleRow.from_json(json.loads(line)) for line in file.read_text().splitlines()]
    except (OSError, ValueError) as error:
        raise InputError(f"{file.name}: cannot be read ({cause(error)})") from None


def compare(rows: Iterable[SampleRow], truths: Mapping[str, Truth]) -> tuple[Verdict, ...]:
    """One verdict for each kind that `truths` (by id) holds; rows are matched by id, or by their file's name."""
    found: dict[str, SampleRow] = {}
    for row in rows:
        found.setdefault(row.id if row.id in truths else PurePosixPath(row.video).stem, row)
    kinds = {kind: [t for t in truths.values() if t.kind is kind] for kind in Kind}
    return tuple(_verdict(kind, group, found) for kind, group in kinds.items() if group)


def _verdict(kind: Kind, truths: Sequence[Truth], found: Mapping[str, SampleRow]) -> Verdict:
    pairs = [(truth, found[truth.id]) for truth in truths if truth.id in found]
    ok = [(truth, row) for truth, row in pairs if row.status is Status.OK]
    wrong = [
        truth.id for truth, row in pairs if truth.feasible is not None and (row.feasible is False) is truth.feasible
    ]
    named = [row.feasible is False and _names(row, truth) for truth, row in pairs]
    return Verdict(
        kind=kind,
        total=len(truths),
        judged_infeasible=_count([row.feasible is False for _, row in pairs], len(truths), wrong),
        reason_named=_count(named, len(truths), [t.id for (t, _), right in zip(pairs, named, strict=True) if not right])
        if truths[0].reasons
        else None,
        undecided=tuple(truth.id for truth, row in ok if row.feasible is None),
        missing=tuple(truth.id for truth in truths if truth.id not in found),
        errors=tuple(truth.id for truth, row in pairs if row.status is Status.ERROR),
        unexplained=tuple(truth.id for truth, row in pairs if _unexplained(row)),
    )


def _names(row: SampleRow, truth: Truth) -> bool:
    return bool({reason.value for reason in truth.reasons} & {str(v.get("kind")) for v in row.violations})


def _unexplained(row: SampleRow) -> bool:
    if row.status is Status.OK:
        return any(value is None and not row.null_reasons.get(name) for name, value in row.metrics.items())
    return row.status is Status.ERROR or not row.reason


def _count(values: Sequence[bool], total: int, ids: Sequence[str]) -> Count:
    return Count(share=estimate(values, total=total), hits=sum(values), ids=tuple(ids))


def table(verdicts: Sequence[Verdict]) -> str:
    """The verdicts as Markdown, with the trajectories to look at below."""
    lines = [
        "| kind | trajectories | judged infeasible | right reason named | undecided | missing | errors | unexplained |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    notes = []
    for v in verdicts:
        named = "" if v.reason_named is None else _percent(v.reason_named)
        counts = " | ".join(str(len(ids)) for ids in (v.undecided, v.missing, v.errors, v.unexplained))
        lines.append(f"| {v.kind.value} | {v.total} | {_percent(v.judged_infeasible)} | {named} | {counts} |")
        alarm = "false alarms" if v.kind in (Kind.FEASIBLE, Kind.NOISY) else "not found"
        wrong = () if v.reason_named is None else v.reason_named.ids
        found_but = tuple(i for i in wrong if i not in v.judged_infeasible.ids)
        for name, ids in (
            (alarm, v.judged_infeasible.ids),
            ("found for another reason", found_but),
            ("undecided", v.undecided),
            ("missing", v.missing),
            ("errors", v.errors),
            ("unexplained", v.unexplained),
        ):
            if ids:
                notes.append(f"{v.kind.value}, {name}: {' '.join(ids)}")
    planted = [v for v in verdicts if v.reason_named is not None]
    if len(planted) > 1:
        found = _together([v.judged_infeasible for v in planted])
        named = _together([v.reason_named for v in planted if v.reason_named is not None])
        empty = " | ".join([""] * 4)
        lines.append(f"| all planted | {sum(v.total for v in planted)} | {found} | {named} | {empty} |")
    return "\n".join([*lines, *(["", *notes] if notes else [])])


def _together(counts: Sequence[Count]) -> str:
    values = [hit for c in counts for hit in [True] * c.hits + [False] * (c.share.n - c.hits)]
    return _percent(_count(values, sum(c.share.total for c in counts), ()))


def _percent(count: Count) -> str:
    s = count.share
    if s.mean is None or s.low is None or s.high is None:
        return ""
    return f"{count.hits}/{s.n} = {100 * s.mean:.1f} % ({100 * s.low:.1f} to {100 * s.high:.1f})"
