"""Comparison of an audit's rows with the ground truth: false alarms, detections, right reasons."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from benchmarks.markdown import table
from benchmarks.trajectory import TrajectoryKind, TrajectoryTruth
from kinebench_drake.errors import InputError, cause
from kinebench_drake.io.jsonl import parse_json
from kinebench_drake.results.aggregate import Estimate, estimate
from kinebench_drake.results.row import SampleRow


@dataclass(frozen=True, slots=True, kw_only=True)
class ShareCount:
    """A share with its interval and the exceptions."""

    share: Estimate
    """Share with its 95 % Wilson interval."""
    hits: int
    """Numerator of the share."""
    ids: tuple[str, ...]
    """Trajectories to inspect: false alarms, misses, wrong reasons."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KindSummary:
    """Results of all trajectories of one kind."""

    kind: TrajectoryKind
    total: int
    """Number of trajectories."""
    judged_infeasible: ShareCount
    """Rows with `feasible` false: false alarms if the truth is feasible, detections if not; ids of the wrong rows."""
    reason_named: ShareCount | None
    """Rows with `feasible` false that name a right reason, of all with a planted fault; ids of the other rows."""
    undecided: tuple[str, ...]
    """Rows whose `feasible` is null."""
    missing: tuple[str, ...]
    """Trajectories without a row."""


def read_rows(path: Path) -> list[SampleRow]:
    """Read the rows of a samples.jsonl, or of the output folder that holds it.

    Raises:
        InputError: it is absent or damaged.
    """
    file = path / "samples.jsonl" if path.is_dir() else path
    try:
        return [SampleRow.from_json(parse_json(line)) for line in file.read_bytes().splitlines()]
    except (OSError, ValueError) as error:
        raise InputError(f"{file.name}: cannot be read ({cause(error)})") from None


def compare(rows: Iterable[SampleRow], truths: Mapping[str, TrajectoryTruth]) -> tuple[KindSummary, ...]:
    """Summarize each kind in `truths` (by id); rows are matched by id, or by the name of their file."""
    by_id: dict[str, SampleRow] = {}
    for row in rows:
        by_id.setdefault(row.id if row.id in truths else PurePosixPath(row.video).stem, row)
    kinds = {kind: [t for t in truths.values() if t.kind is kind] for kind in TrajectoryKind}
    return tuple(_summary(kind, group, by_id) for kind, group in kinds.items() if group)


def _summary(kind: TrajectoryKind, truths: Sequence[TrajectoryTruth], rows: Mapping[str, SampleRow]) -> KindSummary:
    pairs = [(truth, rows[truth.id]) for truth in truths if truth.id in rows]
    wrong = [truth.id for truth, row in pairs if (row.feasible is False) is truth.feasible]
    named = [row.feasible is False and _names(row, truth) for truth, row in pairs]
    return KindSummary(
        kind=kind,
        total=len(truths),
        judged_infeasible=_count([row.feasible is False for _, row in pairs], len(truths), wrong),
        reason_named=_count(named, len(truths), [t.id for (t, _), right in zip(pairs, named, strict=True) if not right])
        if truths[0].reasons
        else None,
        undecided=tuple(truth.id for truth, row in pairs if row.feasible is None),
        missing=tuple(truth.id for truth in truths if truth.id not in rows),
    )


def _names(row: SampleRow, truth: TrajectoryTruth) -> bool:
    return bool({reason.value for reason in truth.reasons} & {v.kind.value for v in row.violations})


def _count(values: Sequence[bool], total: int, ids: Sequence[str]) -> ShareCount:
    return ShareCount(share=estimate(values, total=total), hits=sum(values), ids=tuple(ids))


def summary_table(summaries: Sequence[KindSummary]) -> str:
    """Return the summaries as a Markdown table, with the trajectories to inspect below."""
    head = ("kind", "trajectories", "judged infeasible", "right reason named")
    rows = []
    notes = []
    for s in summaries:
        named = "" if s.reason_named is None else _percent(s.reason_named)
        counts = [str(len(ids)) for ids in (s.undecided, s.missing)]
        rows.append([s.kind.value, str(s.total), _percent(s.judged_infeasible), named, *counts])
        feasible = s.kind in (TrajectoryKind.FEASIBLE, TrajectoryKind.NOISY)
        wrong_reason = () if s.reason_named is None else s.reason_named.ids
        for name, ids in (
            ("false alarms" if feasible else "not detected", s.judged_infeasible.ids),
            ("another reason named", tuple(i for i in wrong_reason if i not in s.judged_infeasible.ids)),
            ("undecided", s.undecided),
            ("missing", s.missing),
        ):
            if ids:
                notes.append(f"{s.kind.value}, {name}: {' '.join(ids)}")
    planted = [s for s in summaries if s.reason_named is not None]
    if len(planted) > 1:
        detected = _pooled([s.judged_infeasible for s in planted])
        named = _pooled([s.reason_named for s in planted if s.reason_named is not None])
        rows.append(["all planted", str(sum(s.total for s in planted)), detected, named, "", ""])
    lines = table((*head, "undecided", "missing"), rows)
    return "\n".join([*lines, *(["", *notes] if notes else [])])


def _pooled(counts: Sequence[ShareCount]) -> str:
    values = [hit for c in counts for hit in [True] * c.hits + [False] * (c.share.n - c.hits)]
    return _percent(_count(values, sum(c.share.total for c in counts), ()))


def _percent(count: ShareCount) -> str:
    s = count.share
    if s.mean is None or s.low is None or s.high is None:
        return ""
    return f"{count.hits}/{s.n} = {100 * s.mean:.1f} % ({100 * s.low:.1f} to {100 * s.high:.1f})"
