"""One line of trust: what the numbers of a video rest on, and whether they can be used unseen."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum

from kinebench_drake.camera import CONFIRMED, CameraSource, CameraState
from kinebench_drake.errors import count_noun
from kinebench_drake.io.jsonl import Json, as_object
from kinebench_drake.track import Domain

TRUST = "trust"
"""Key of a row."""
_FILE_RATE = "fps"  # source of a frame period that is 1 / fps of the file
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Trust:
    """Trust in the numbers of one video."""

    level: TrustLevel
    reason: str
    """What decides on the level."""
    facts: tuple[str, ...]
    """Camera, look, confidence, frame period and frames without a pose, a clause each."""
    detail: str | None = None
    """The reason with its numbers; None if it has none."""

    @property
    def line(self) -> str:
        """Level, reason and facts in one line."""
        return f"{self.level.value}: {self.detail or self.reason} ({'; '.join(self.facts)})"

    def to_json(self) -> dict[str, Json]:
        """Serialize into `trust` of samples.jsonl."""
        return {"level": self.level.value, "reason": self.reason, "line": self.line}


def assess_trust(extra: Mapping[str, Json], metrics: Mapping[str, Json], period: str, *, is_measured: bool) -> Trust:
    """Assess a video by the keys and metrics of its row.

    `extra` has `camera_state`, `camera_source`, `camera_agreement`, `domain`, `frames` and `frame_period_source`,
    `metrics` has `tracked_fraction` and `confidence_mean`; `period` is the frame period and its source, in words,
    `is_measured` whether the row has results.
    """
    state = extra.get("camera_state")
    agreement = extra.get("camera_agreement")
    domain = extra.get("domain")
    tracked = metrics.get("tracked_fraction")
    confidence = metrics.get("confidence_mean")
    frames = extra.get("frames")
    camera = f"camera {state}"
    if isinstance(agreement, float):
        camera += f", {agreement:.0%} of the arm's contours on image edges"
    facts = [camera, f"look {domain}"]
    if isinstance(confidence, float):
        facts.append(f"mean confidence {confidence:.2f}")
    facts.append(f"frame period {period}")
    if isinstance(tracked, float) and isinstance(frames, int):
        facts.append(f"{round((1.0 - tracked) * frames)} of {count_noun(frames, 'frame')} not measured")
    doubts = {
        "the camera is estimated from the arm": state == CameraState.ESTIMATED.value,
        "the arm does not confirm the named camera": state == CameraState.NAMED.value
        and isinstance(agreement, float)
        and agreement < CONFIRMED,
        "frames could not be measured": isinstance(tracked, float) and tracked < FEW_TRACKED,
        "the mean confidence is low": isinstance(confidence, float) and confidence < LOW_CONFIDENCE,
        "the look is unfamiliar": domain == Domain.UNFAMILIAR.value,
        "the flange is measured without a hand": domain == Domain.ARM.value,
        "the benchmark camera fits, but the frame period is not the benchmark's 0.2 s": extra.get("frame_period_source")
        == _FILE_RATE
        and state == CameraState.CONFIRMED.value
        and extra.get("camera_source") == CameraSource.BENCHMARK.value,
    }
    has_base = state != CameraState.NONE.value
    unknown = {"the base frame is unknown": not has_base, "the track is not trusted": not is_measured}
    detail = extra.get("base_frame_reason")
    for level, reasons in ((TrustLevel.UNKNOWN, unknown), (TrustLevel.CHECK, doubts)):
        for reason, applies in reasons.items():
            if applies:
                own = detail if isinstance(detail, str) and not has_base else None
                return Trust(level=level, reason=reason, facts=tuple(facts), detail=own)
    return Trust(level=TrustLevel.SOLID, reason="nothing speaks against it", facts=tuple(facts))


def trust_lines(rows: Iterable[Mapping[str, Json]]) -> list[str]:
    """Count the levels of rows by their `extra`, with reasons, in one line; none if no row has one."""
    counts = Counter[tuple[str, str]]()
    for extra in rows:
        trust = as_object(extra.get(TRUST))
        if trust:
            counts[str(trust.get("level")), str(trust.get("reason"))] += 1
    if not counts:
        return []
    parts = []
    for level in TrustLevel:
        reasons = sorted(((n, reason) for (own, reason), n in counts.items() if own == level.value), reverse=True)
        if reasons:
            listed = "" if level is TrustLevel.SOLID else f" ({'; '.join(f'{reason}: {n}' for n, reason in reasons)})"
            parts.append(f"{sum(n for n, _ in reasons)} {level.value}{listed}")
    return [f"trust: {', '.join(parts)}"]
