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

_SEPARATOR = "; "
"""Text between the reasons of a row."""


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
    reasons = [text for text, applies in {**unknown, **doubts}.items() if applies]
    level = TrustLevel.UNKNOWN if any(unknown.values()) else TrustLevel.CHECK if reasons else TrustLevel.SOLID
    reason = _SEPARATOR.join(reasons) or "nothing speaks against it"
    detail = reason
    if row.base_frame_reason and not has_base:
        detail = _SEPARATOR.join([row.base_frame_reason, *reasons[1:]])
    return TrustEntry(level=level.value, reason=reason, line=f"{level.value}: {detail} ({'; '.join(facts)})")


def trust_lines(rows: Iterable[SampleRow]) -> list[str]:
    """Count the levels of rows, and of each the reasons, in one line; none if no row has one."""
    entries = [row.trust for row in rows if row.trust is not None]
    parts = []
    for level in TrustLevel:
        reasons = [entry.reason for entry in entries if entry.level == level.value]
        if reasons:
            counts = Counter(reason for own in reasons for reason in own.split(_SEPARATOR))
            ranked = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
            listed = "" if level is TrustLevel.SOLID else f" ({'; '.join(f'{reason}: {n}' for reason, n in ranked)})"
            parts.append(f"{len(reasons)} {level.value}{listed}")
    return [f"trust: {', '.join(parts)}"] if parts else []
