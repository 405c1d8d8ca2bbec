"""The verdict of a row in words, and the trust in it: for the lines of a run, its pages and replays."""

from collections.abc import Iterable, Iterator

from kinebench_drake.errors import count_noun
from kinebench_drake.io.jsonl import as_number
from kinebench_drake.metrics.executable import INFEASIBLE, LOST, OPEN, UNCHECKED, UNDECIDED, FailureVerdict, reason_kind
from kinebench_drake.metrics.following import FOLLOWING_SHARE
from kinebench_drake.metrics.trust import TrustLevel
from kinebench_drake.report.limit_table import describe_violation, format_frames
from kinebench_drake.results.row import SampleRow, Status

_FAILURES = {cause.value: f"failed: {cause.value}" for cause in FailureVerdict}
VERDICT_LABELS = {
    **{"error": "error", "infeasible": "infeasible", "deviates": "does not follow", **_FAILURES},
    **{"unmeasurable": "unmeasurable", "feasible": "not executable, no limit broken", "unjudged": "undecided"},
    **{"tracked": "tracked", "checked": "feasible as far as checked"},
    **{"executable": "executable", "success": "success", "follows": "follows"},
}
"""Labels of the verdicts, the worst first."""
GOOD_VERDICTS = ("executable", "success", "follows")
_MOST_SPANS = 3
"""Stretches of frames that a cause lists."""


def verdict_of(row: SampleRow) -> str:
    """Return the verdict of a row, a key of VERDICT_LABELS; of a closed-loop episode its outcome."""
    if row.status is not Status.OK:
        return str(row.status.value)
    if row.has("follows"):
        return "unjudged" if row.follows is None else "follows" if row.follows else "deviates"
    if row.has("verdict"):
        cause = row.verdict if row.verdict in _FAILURES else None
        return "success" if row.success else cause or "unjudged"
    if row.executable or row.feasible is False:
        return "executable" if row.executable else "infeasible"
    if row.feasible and [reason_kind(reason) for reason in row.executable_reasons] == [UNCHECKED]:
        return "checked"
    if row.executable is None:
        was_judged = row.feasible is not None or row.executable_reasons
        return "unjudged" if was_judged else "tracked"
    return "feasible"


def describe_verdict(row: SampleRow) -> str:
    """Describe the verdict of a row and what decides on it.

    Such as `not executable: vanish, frames 4 to 13`, or `failed: task, not on target` of an episode.
    """
    name = name_verdict(row)
    cause = explain_verdict(row)
    separator = ", " if ":" in name else ": "
    return f"{name}{separator}{cause}" if cause else name


def name_verdict(row: SampleRow) -> str:
    """Return the verdict of a row in words: of a video whether it is executable, of a trajectory whether feasible."""
    verdict = verdict_of(row)
    if verdict == "tracked":
        return _count_tracked(row)
    if verdict == "success" and row.executable_reasons:
        return f"success, {'executable undecided' if row.executable is None else 'not executable'}"
    is_video = "anomalies" in row.metrics
    if is_video and verdict in ("infeasible", "feasible"):
        return "not executable"
    if not is_video and verdict == "executable":
        return "feasible"
    return VERDICT_LABELS[verdict]


def explain_verdict(row: SampleRow) -> str:
    """Return what decides on the verdict of a row; empty if nothing needs to be said."""
    cause = row.reason or row.follow_reason or (None if row.cause is None else row.cause.text)
    return cause or "; ".join(_list_causes(row))


def follow_lines(rows: Iterable[SampleRow]) -> list[str]:
    """State how many clips are inside the tube of each control's actions; empty for rows without controls."""
    controls = [row.controls for row in rows if row.controls]
    if not controls:
        return []
    counts = [
        f"{name} {sum((as_number(c.get(name)) or 0.0) >= FOLLOWING_SHARE for c in controls)}" for name in controls[0]
    ]
    return [f"inside the tube of the actions of a control: {', '.join(counts)} of {count_noun(len(controls), 'clip')}"]


def describe_trust(row: SampleRow) -> str:
    """Return the level of trust in a row, with its reason unless it is solid; empty if the row has none."""
    trust = row.trust
    if trust is None:
        return ""
    return trust.level if trust.level == TrustLevel.SOLID.value else f"{trust.level}, {trust.reason}"


def _count_tracked(row: SampleRow) -> str:
    fraction = row.metrics.tracked_fraction
    if fraction is None or row.frames is None:
        return VERDICT_LABELS["tracked"]
    return f"tracked {round(fraction * row.frames)} of {count_noun(row.frames, 'frame')}"


def _list_causes(row: SampleRow) -> Iterator[str]:
    """Describe the reasons of `executable`; where some speak against the sample, those that leave it open are left out.

    A camera that moves is no such reason: a robot can execute its video.
    """
    open_causes = {UNDECIDED, LOST, UNCHECKED, OPEN}
    for reason in row.executable_reasons:
        if row.executable is not False or reason_kind(reason) not in open_causes:
            yield _describe_reason(row, reason)


def _describe_reason(row: SampleRow, reason: str) -> str:
    kind, _, detail = reason.partition(": ")
    if kind == INFEASIBLE and row.violations:
        others = len(row.violations) - 1
        worst = describe_violation(row.violations[0])
        return f"{worst} and {count_noun(others, 'violation')} more" if others else worst
    if kind == UNDECIDED:
        return row.null_reasons.get("feasible", "no reason stored")
    if kind == LOST:
        spans = [
            f"{format_frames(int(str(e['frame_start'])), int(str(e['frame_end'])))} {e['reason']}"
            for e in row.lost_frames or ()
        ]
        return f"no pose in {detail}" + (f" ({', '.join(spans[:_MOST_SPANS])})" if spans else "")
    if kind == UNCHECKED:
        return f"limits of {detail} are not checked"
    if kind == OPEN:
        return f"{detail.replace('_', ' ')} is open"
    spans = [format_frames(a.frame_start, a.frame_end) for a in row.anomalies if a.kind.value == kind]
    more = [f"{len(spans) - _MOST_SPANS} more"] if len(spans) > _MOST_SPANS else []
    return ", ".join([kind.replace("_", " "), *(spans[:_MOST_SPANS] or [detail]), *more])
