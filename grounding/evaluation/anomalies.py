"""Detection of planted anomalies, clip by clip."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from kinebench_drake.errors import SetupError, UsageError
from kinebench_drake.executors.base import Executor, WorkerCrash
from kinebench_drake.executors.progress import Observer
from kinebench_drake.grounding.evaluation.clip import TruthClipFile, choose, find_clips
from kinebench_drake.grounding.evaluation.errors import read_anomaly
from kinebench_drake.grounding.evaluation.store import MeasurementStore, fingerprint
from kinebench_drake.grounding.evaluation.variants import VariantTools
from kinebench_drake.grounding.pipeline import GroundingPipeline
from kinebench_drake.io.reader import read_video
from kinebench_drake.types import Anomaly, AnomalyKind

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
class PlantedCase:
    """Planted anomaly of a clip."""

    kind: AnomalyKind
    frame_start: int
    """First affected frame (0-based)."""
    frame_end: int
    """Last affected frame, inclusive."""
    size: float
    """Size in the unit of the kind."""
    form: str
    """Course in time; empty if the kind has a single form."""


Case = tuple[TruthClipFile, PlantedCase | None]
"""Clip with its planted anomaly; None for a clean clip."""


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

    def to_json(self) -> dict[str, Any]:
        """Return the JSON object."""
        return {
            "id": self.id,
            "task": self.task,
            "planted": None if self.planted is None else {**asdict(self.planted), "kind": self.planted.kind.value},
            "scores": {kind.value: score for kind, score in self.scores.items()},
            "found": [a.to_json() for a in self.detected],
        }

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> "ClipAnomalies":
        """Read the object that `to_json` returns."""
        planted = data["planted"]
        return cls(
            id=data["id"],
            task=data["task"],
            planted=None if planted is None else PlantedCase(**{**planted, "kind": AnomalyKind(planted["kind"])}),
            scores={AnomalyKind(kind): float(score) for kind, score in data["scores"].items()},
            detected=tuple(map(read_anomaly, data["found"])),
        )


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


@dataclass(frozen=True, slots=True)
class AnomalyWorkerFactory:
    """Creates, in each process, the function that runs the detectors on clips."""

    weights: Path | None
    """Weights in place of those shipped."""

    def __call__(self) -> Callable[[Case], ClipAnomalies]:
        """Return the function that runs the detectors on one clip."""
        pipeline = VariantTools.load(self.weights).shipped
        return lambda case: detect(*case, pipeline)


def detect(clip: TruthClipFile, planted: PlantedCase | None, pipeline: GroundingPipeline) -> ClipAnomalies:
    """Ground a clip and return the output of the detectors."""
    detections = pipeline.ground(read_video(clip.video).frames, clip.camera, clip.load().t_s).detections
    return ClipAnomalies(
        id=clip.id,
        task=clip.task,
        planted=planted,
        scores={kind: round(score, 4) for kind, score in detections.scores.items()},
        detected=detections.anomalies,
    )


def find_cases(clean: Path, faulty: Path, limit: int | None) -> list[Case]:
    """Return the clips of two folders with their planted anomalies.

    Args:
        clean: folder of clean videos.
        faulty: folder of videos with planted anomalies.
        limit: number of clean videos, and of videos of each kind, size and form, taken from all tasks in turn.

    Raises:
        UsageError: a folder lacks its manifest or ground truth, or a faulty clip its planted anomaly.
    """
    cases: list[Case] = [(clip, None) for clip in choose(find_clips(clean), limit)]
    grades: dict[tuple[AnomalyKind, float, str], list[tuple[TruthClipFile, PlantedCase]]] = {}
    faults = _read_faults(faulty)
    for clip in find_clips(faulty):
        if clip.id not in faults:
            raise UsageError(f"{faulty.name}: truth/faults.json names no fault of {clip.id}")
        planted = faults[clip.id]
        grades.setdefault((planted.kind, planted.size, planted.form), []).append((clip, planted))
    for members in grades.values():
        kept = {clip.id for clip in choose([clip for clip, _ in members], limit)}
        cases += [(clip, planted) for clip, planted in members if clip.id in kept]
    return cases


def _read_faults(folder: Path) -> dict[str, PlantedCase]:
    path = folder / "truth" / "faults.json"
    try:
        return {
            name: PlantedCase(
                kind=AnomalyKind(fault["kind"]),
                frame_start=int(fault["frame_start"]),
                frame_end=int(fault["frame_end"]),
                size=float(fault["size"]),
                form=str(fault.get("form") or ""),
            )
            for name, fault in json.loads(path.read_text()).items()
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        raise UsageError(
            f"{folder.name}: has no usable truth/faults.json; make such a folder with "
            "`python -m benchmarks planted-videos`"
        ) from None


def detect_all(
    cases: Sequence[Case], weights: Path | None, executor: Executor, observer: Observer, keep: Path | None
) -> list[ClipAnomalies]:
    """Run the detectors on all clips whose output is not in the file `keep` yet.

    Raises:
        SetupError: a worker died; finished clips are stored.
        UsageError: `keep` holds something else.
    """
    store = MeasurementStore(keep, ClipAnomalies)
    base = fingerprint(modules=[__name__], files=[weights] if weights else [])
    keys = {clip.id: f"{base}-{clip.digest()}" for clip, _ in cases}
    todo = [case for case in cases if keys[case[0].id] not in store]
    observer.start(len(cases), len(cases) - len(todo))
    for outcome in executor.run(AnomalyWorkerFactory(weights), todo):
        clip, _ = outcome.item
        if isinstance(outcome, WorkerCrash):
            raise SetupError(f"{clip.id}: {outcome.reason}; run the same command again, what is finished is kept")
        store.put(keys[clip.id], outcome.result)
        observer.advance(clip.id)
    return [store[keys[clip.id]] for clip, _ in cases]
