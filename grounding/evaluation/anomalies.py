"""PlantedCase anomalies held against what the detectors find, clip by clip."""

import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from kinebench_drake.errors import InputError, SetupError, UsageError
from kinebench_drake.executors.base import Executor, WorkerCrash
from kinebench_drake.executors.progress import Observer
from kinebench_drake.grounding.evaluation.clip import TruthClipFile, choose, find_clips
from kinebench_drake.grounding.evaluation.store import fingerprint
from kinebench_drake.grounding.evaluation.variants import VariantTools
from kinebench_drake.grounding.pipeline import GroundingPipeline
from kinebench_drake.io.atomic import disk_errors
from kinebench_drake.io.reader import read_video
from kinebench_drake.types import Anomaly, AnomalyKind

_DETECTORS = Path(__file__).parents[1] / "anomaly"
_START_FRAMES = {
    AnomalyKind.VANISH: 1,
    AnomalyKind.DUPLICATE: 2,
    AnomalyKind.TELEPORT: 1,
    AnomalyKind.FREEZE: 1,
    AnomalyKind.DEFORMATION: 3,
    AnomalyKind.FINGERS: 2,
}
"""By how many frames the start of a kind may be named off; what begins too small to see may be named anywhere in it."""
_ENDING = (AnomalyKind.VANISH, AnomalyKind.DUPLICATE, AnomalyKind.FREEZE, AnomalyKind.DEFORMATION)
"""Kinds whose end must be right as well."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantedCase:
    """A fault as its truth tells it."""

    kind: AnomalyKind
    frame_start: int
    """First affected frame (0-based)."""
    frame_end: int
    """Last one, inclusive."""
    size: float
    """In the kind's own unit."""
    form: str
    """How it goes on in time; empty where its kind has one way only."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClipAnomalies:
    """What the detectors say of one clip."""

    id: str
    task: str
    planted: PlantedCase | None
    """Its fault; None of a clean clip."""
    scores: Mapping[AnomalyKind, float]
    """The clip's score of each kind, 1 at the threshold."""
    found: tuple[Anomaly, ...]

    @property
    def is_named(self) -> bool:
        """Whether an anomaly of the planted kind is found at all."""
        return self.planted is not None and any(a.kind is self.planted.kind for a in self.found)

    @property
    def is_located(self) -> bool:
        """Whether one is found in the right frames."""
        return self.planted is not None and any(located(self.planted, a) for a in self.found)

    def to_json(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "id": self.id,
            "task": self.task,
            "planted": None if self.planted is None else {**asdict(self.planted), "kind": self.planted.kind.value},
            "scores": {kind.value: score for kind, score in self.scores.items()},
            "found": [{**asdict(a), "kind": a.kind.value} for a in self.found],
        }

    @classmethod
    def from_json(cls, row: dict[str, Any]) -> "ClipAnomalies":
        """The reverse of `to_json`."""
        planted = row["planted"]
        return cls(
            id=row["id"],
            task=row["task"],
            planted=None if planted is None else PlantedCase(**{**planted, "kind": AnomalyKind(planted["kind"])}),
            scores={AnomalyKind(kind): float(score) for kind, score in row["scores"].items()},
            found=tuple(Anomaly(**{**a, "kind": AnomalyKind(a["kind"])}) for a in row["found"]),
        )


def located(planted: PlantedCase, found: Anomaly) -> bool:
    """Whether an anomaly is that fault: of its kind, in its frames, beginning (and ending) where it does.

    A fault that grows, or that a small motion hides at first, may be found in any of its frames.
    """
    if found.kind is not planted.kind:
        return False
    tolerance = _START_FRAMES.get(planted.kind)
    if tolerance is None:
        return found.frame_start <= planted.frame_end and found.frame_end >= planted.frame_start
    starts = abs(found.frame_start - planted.frame_start) <= tolerance
    ends = abs(found.frame_end - planted.frame_end) <= tolerance
    return starts and (ends or planted.kind not in _ENDING)


@dataclass(frozen=True, slots=True)
class AnomalyExaminer:
    """Makes, in each process, what looks at clips."""

    weights: Path | None
    """Weights in place of those shipped."""

    def __call__(self) -> Callable[[tuple[TruthClipFile, PlantedCase | None]], ClipAnomalies]:
        """A function that looks at one clip."""
        pipeline = VariantTools.load(self.weights).shipped

        def look(case: tuple[TruthClipFile, PlantedCase | None]) -> ClipAnomalies:
            return examine(*case, pipeline)

        return look


def examine(clip: TruthClipFile, planted: PlantedCase | None, pipeline: GroundingPipeline) -> ClipAnomalies:
    """Ground a clip and ask the detectors.

    Raises:
        InputError: the pipeline tells no scores.
    """
    findings = pipeline.ground(read_video(clip.video).frames, clip.camera, clip.load().t_s).detections
    if findings is None:
        raise InputError(f"{clip.id}: this pipeline tells no scores of anomalies")
    return ClipAnomalies(
        id=clip.id,
        task=clip.task,
        planted=planted,
        scores={kind: round(score, 4) for kind, score in findings.scores.items()},
        found=findings.anomalies,
    )


def find_cases(clean: Path, faulty: Path, limit: int | None) -> list[tuple[TruthClipFile, PlantedCase | None]]:
    """The clips of two folders with their faults; `limit`: so many clean ones, and of each fault, tasks in turn.

    Raises:
        UsageError: a folder lacks its manifest or truth, or a faulty clip its fault.
    """
    cases: list[tuple[TruthClipFile, PlantedCase | None]] = [(clip, None) for clip in choose(find_clips(clean), limit)]
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
            "`python -m benchmarks.planted_videos`"
        ) from None


def measure(
    cases: Sequence[tuple[TruthClipFile, PlantedCase | None]],
    weights: Path | None,
    engine: Executor,
    observer: Observer,
    keep: Path | None,
) -> list[ClipAnomalies]:
    """Look at all clips; what stands in `keep` already is not looked at again.

    Raises:
        SetupError: a worker died; what is finished is kept.
        UsageError: `keep` holds something else.
    """
    base = fingerprint(files=[*sorted(_DETECTORS.glob("*.py")), *([weights] if weights else [])])
    keys = {clip.id: f"{base}-{clip.digest()}" for clip, _ in cases}
    done = {row["key"]: ClipAnomalies.from_json(row) for row in _rows(keep)}
    todo = [case for case in cases if keys[case[0].id] not in done]
    observer.start(len(cases), len(cases) - len(todo))
    for result in engine.run(AnomalyExaminer(weights), todo):
        if isinstance(result, WorkerCrash):
            raise SetupError(
                f"{result.item[0].id}: {result.reason}; run the same command again, what is finished is kept"
            )
        findings = result.result
        done[keys[findings.id]] = findings
        _append(keep, {"key": keys[findings.id], **findings.to_json()})
        observer.advance(findings.id)
    return [done[keys[clip.id]] for clip, _ in cases]


def _rows(path: Path | None) -> Iterator[dict[str, Any]]:
    """The whole lines of a file, if there is one."""
    if path is None or not path.is_file():
        return
    try:
        for line in path.read_text().split("\n")[:-1]:
            row = json.loads(line)
            ClipAnomalies.from_json(row)
            yield row
    except (ValueError, KeyError, TypeError):
        raise UsageError(f"{path.name}: holds no findings of this version; remove it to start anew") from None


def _append(path: Path | None, row: dict[str, Any]) -> None:
    if path is not None:
        with disk_errors(path.name), path.open("a") as file:
            file.write(json.dumps(row, allow_nan=False) + "\n")
            file.flush()
            os.fsync(file.fileno())
