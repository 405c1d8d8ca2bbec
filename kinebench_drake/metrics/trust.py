"""One line of trust: what the numbers of a video rest on, and whether they can be used unseen."""

from collections import Counter
from collections.abc import Iterable
from enum import Enum

from kinebench_drake.camera import CONFIRMED, CameraSource, CameraState
from kinebench_drake.errors import count_noun
from kinebench_drake.results.inputs import PeriodSource
from kinebench_drake.results.row import SampleRow, TrustEntry
from kinebench_drake.track import Domain

LOW_CONFIDENCE = 0.8
"""Mean confidence of the tracked frames below which poses deserve a look."""
FEW_TRACKED = 0.95
"""Share of frames with a pose below which the rest deserves a look."""


class TrustLevel(Enum):
    """Whether the numbers of a sample can be used unseen."""

    SOLID = "solid"
    CHECK = "check"
    """They rest on something that should be looked at."""
    UNKNOWN = "unknown"
    """There is no base frame, or no track: there is no verdict."""


def assess_trust(row: SampleRow, period: str, *, is_measured: bool) -> TrustEntry:
    """Assess a video by the keys and metrics of its row.

    Args:
        period: the frame period and its source, in words.
        is_measured: whether the row has results.
    """
    state = row.camera_state
    agreement = row.camera_agreement
    tracked = row.metrics.tracked_fraction
    confidence = row.metrics.confidence_mean
    # Camera and clock of the benchmark's simulator are its own.
    is_episode = state == CameraState.NAMED.value and row.camera_source == CameraSource.BENCHMARK.value
    is_named = state == CameraState.NAMED.value and not is_episode
    camera = f"camera {state}"
    if agreement is not None:
        camera += f", {agreement:.0%} of the arm's contours on image edges"
    elif is_named:
        camera += ", agreement of the arm not measured"
    facts = [camera, f"look {row.domain}"]
    if confidence is not None:
        facts.append(f"mean confidence {confidence:.2f}")
    facts.append(f"frame period {period}")
    if tracked is not None and row.frames is not None:
        facts.append(f"{round((1.0 - tracked) * row.frames)} of {count_noun(row.frames, 'frame')} not measured")
    doubts = {
        "the camera is estimated from the arm": state == CameraState.ESTIMATED.value,
        "the arm does not confirm the named camera": is_named and (agreement is None or agreement < CONFIRMED),
        "frames could not be measured": tracked is not None and tracked < FEW_TRACKED,
        "the mean confidence is low": confidence is not None and confidence < LOW_CONFIDENCE,
        "the look is unfamiliar": row.domain == Domain.UNFAMILIAR.value,
        "the flange is measured without a hand": row.domain == Domain.ARM.value,
        "the frame period is assumed": row.frame_period_source == PeriodSource.BENCHMARK.value and not is_episode,
        "the benchmark camera fits, but the frame period is not the benchmark's 0.2 s": row.frame_period_source
        == PeriodSource.FPS.value
        and state == CameraState.CONFIRMED.value
        and row.camera_source == CameraSource.BENCHMARK.value,
    }
    has_base = state != CameraState.NONE.value
    unknown = {"the base frame is unknown": not has_base, "the track is not trusted": not is_measured}
    level = TrustLevel.SOLID
    reason = "nothing speaks against it"
    for worse, reasons in ((TrustLevel.CHECK, doubts), (TrustLevel.UNKNOWN, unknown)):
        applying = [text for text, applies in reasons.items() if applies]
        if applying:
            level = worse
            reason = applying[0]
    detail = row.base_frame_reason if row.base_frame_reason and not has_base else reason
    return TrustEntry(level=level.value, reason=reason, line=f"{level.value}: {detail} ({'; '.join(facts)})")


def trust_lines(rows: Iterable[SampleRow]) -> list[str]:
    """Count the levels of rows, with reasons, in one line; none if no row has one."""
    counts = Counter((row.trust.level, row.trust.reason) for row in rows if row.trust is not None)
    if not counts:
        return []
    parts = []
    for level in TrustLevel:
        reasons = sorted(((n, reason) for (own, reason), n in counts.items() if own == level.value), reverse=True)
        if reasons:
            listed = "" if level is TrustLevel.SOLID else f" ({'; '.join(f'{reason}: {n}' for n, reason in reasons)})"
            parts.append(f"{sum(n for n, _ in reasons)} {level.value}{listed}")
    return [f"trust: {', '.join(parts)}"]
