"""Detection of planted anomalies, clip by clip."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from benchmarks.perception.clip import PlantedCase, TruthClipFile, choose, find_clips
from benchmarks.perception.store import MeasurementStore, fingerprint
from benchmarks.perception.variants import VariantTools
from kinebench_drake.anomaly import Anomaly, AnomalyKind
from kinebench_drake.errors import UsageError
from kinebench_drake.executors.base import Executor, Observer
from kinebench_drake.io.reader import read_video

_START_FRAMES = {
    AnomalyKind.VANISH: 1,
    AnomalyKind.DUPLICATE: 2,
    AnomalyKind.TELEPORT: 1,
    AnomalyKind.FREEZE: 1,
    AnomalyKind.DEFORMATION: 3,
    AnomalyKind.FINGERS: 2,
}
"""Tolerance of the first frame by kind; a kind that begins too small to be visible may start in any of its frames."""
_ENDING = (AnomalyKind.VANISH, AnomalyKind.DUPLICATE, AnomalyKind.FREEZE, AnomalyKind.DEFORMATION)
"""Kinds whose last frame must be right as well."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClipAnomalies:
    """Output of the detectors for one clip."""

    id: str
    task: str
    planted: PlantedCase | None
    """Planted anomaly; None for a clean clip."""
    scores: Mapping[AnomalyKind, float]
    """Score of the clip by kind, 1 at the detection threshold."""
    detected: tuple[Anomaly, ...]

    @property
    def is_named(self) -> bool:
        """True if an anomaly of the planted kind is detected in any frame."""
        return self.planted is not None and any(a.kind is self.planted.kind for a in self.detected)

    @property
    def is_located(self) -> bool:
        """True if the planted anomaly is detected in the right frames."""
        return self.planted is not None and any(located(self.planted, a) for a in self.detected)


def located(planted: PlantedCase, detected: Anomaly) -> bool:
    """Return whether a detected anomaly is the planted one: same kind, start (and end) within the tolerance.

    An anomaly that grows, or that small motion hides at first, may be detected in any of its frames.
    """
    if detected.kind is not planted.kind:
        return False
    tolerance = _START_FRAMES.get(planted.kind)
    if tolerance is None:
        return detected.frame_start <= planted.frame_end and detected.frame_end >= planted.frame_start
    starts = abs(detected.frame_start - planted.frame_start) <= tolerance
    ends = abs(detected.frame_end - planted.frame_end) <= tolerance
    return starts and (ends or planted.kind not in _ENDING)


def make_detector(weights: Path | None) -> Callable[[TruthClipFile], ClipAnomalies]:
    """Return the function that grounds a clip and runs the detectors; `weights` in place of those shipped."""
    pipeline = VariantTools.load(weights).shipped

    def detect(clip: TruthClipFile) -> ClipAnomalies:
        detections = pipeline.ground(read_video(clip.video).frames, clip.camera, clip.load().t_s).detections
        return ClipAnomalies(
            id=clip.id,
            task=clip.task,
            planted=clip.planted,
            scores={kind: round(score, 4) for kind, score in detections.scores.items()},
            detected=detections.anomalies,
        )

    return detect


def find_cases(clean: Path, faulty: Path, limit: int | None) -> list[TruthClipFile]:
    """Return clean clips, then clips with planted anomalies.

    At most `limit` clean ones, and of each kind, size and form, taken from all tasks in turn.

    Raises:
        UsageError: a folder lacks its manifest or ground truth, or a faulty clip its planted anomaly.
    """
    cases = [replace(clip, planted=None) for clip in choose(find_clips(clean), limit)]
    grades: dict[tuple[AnomalyKind, float, str], list[TruthClipFile]] = {}
    for clip in find_clips(faulty):
        if clip.planted is None:
            raise UsageError(
                f"{faulty.name}: truth/faults.json names no fault of {clip.id}; make such a folder with "
                "`python -m benchmarks planted-videos`"
            )
        grades.setdefault((clip.planted.kind, clip.planted.size, clip.planted.form), []).append(clip)
    for members in grades.values():
        cases += choose(members, limit)
    return cases


def detect_all(
    clips: Sequence[TruthClipFile], weights: Path | None, executor: Executor, observer: Observer, keep: Path | None
) -> list[ClipAnomalies]:
    """Run the detectors on all clips whose output is not in the file `keep` yet.

    Raises:
        SetupError: a worker died; finished clips are stored.
        UsageError: `keep` holds something else.
    """
    store = MeasurementStore(keep, ClipAnomalies)
    base = fingerprint(modules=[__name__], files=[weights] if weights else [])
    keys = {clip.id: f"{base}-{clip.digest()}" for clip in clips}
    make_worker = partial(make_detector, weights)
    return store.complete(clips, lambda c: keys[c.id], executor, make_worker, observer, lambda c: c.id)
