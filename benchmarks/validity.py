"""Videos of the same episodes without and with a planted fault: their numbers, and success in closed loop.

Work folder, all of which an interrupted measurement resumes from:

    videos/             clean and faulty videos with ground truth (`planted_videos`); planted.jsonl: one line an episode
    score/              output folder of `kinebench-drake score videos/manifest.jsonl`
    executions.jsonl    success of each video's track in the simulator
    trials.jsonl        one `ValidityTrial` a line
    study.json          revision and hash of the weights
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path

from pydantic import TypeAdapter

from benchmarks.executions import ClipTrack, Extractor, TrackExecution, execute_all
from benchmarks.faults.fault import GRADES, FaultGrade
from benchmarks.perception.store import MeasurementStore
from benchmarks.planted_videos import PlantedVideo, PlantingOrder, PlantingResult, make_planter, write_index
from benchmarks.record import current_revision
from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.errors import UsageError
from kinebench_drake.executors.base import Executor
from kinebench_drake.executors.local import LocalExecutor
from kinebench_drake.io.jsonl import Json, read_lines, read_object, write_json, write_lines
from kinebench_drake.results.provenance import weights_hash
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.store import artifact_path
from kinebench_drake.runs.config import ScoreConfig
from kinebench_drake.runs.runner import RunObserver
from kinebench_drake.runs.score import score_videos
from kinebench_drake.suites.catalog import EpisodeSpec, load_suite
from kinebench_drake.suites.families.registry import TASKS

SUITE = 2
SPLIT = "unseen"
"""Episodes with the half of the assets and looks that the networks were not trained on."""
SIZES = 3
"""Sizes of each kind of fault."""
_TRIALS = "trials.jsonl"
_STUDY = "study.json"
_TRIES = 20
"""Episodes of each task that may fail without a fault before the study gives up."""


def study_grades(sizes: int) -> tuple[FaultGrade, ...]:
    """Return one to SIZES sizes of each kind of fault, in its first form: the greatest, the gated one, the least."""
    return tuple(
        FaultGrade(kind=kind, size=size, form=grades.forms[0])
        for kind, grades in GRADES.items()
        for size in sorted((max(grades.sizes), grades.gate, min(grades.sizes))[:sizes])
    )


def study_specs() -> Iterator[EpisodeSpec]:
    """Yield episodes of all tasks in turn; only tasks that one clip solves, as a fault is in one clip."""
    suite = load_suite(SUITE)
    tasks = [task for task in suite.tasks_of(SPLIT) if TASKS[task].card.clips == 1]
    for seed in range(_TRIES):
        yield from suite.specs(SPLIT, 1, tasks=tasks, offset=seed)


@dataclass(frozen=True, slots=True, kw_only=True)
class ValidityTrial:
    """Numbers of one video, and success of its track in the simulator."""

    id: str
    episode: str
    """Id of the episode."""
    task: str
    kind: AnomalyKind | None
    """Kind of the planted fault; None for the clean video."""
    size: float
    """Size of the fault, in the unit of `PlantedFault.size`; 0 for the clean video."""
    success: bool
    """True if the task succeeds when the video's track is executed."""
    reason: str
    """Conditions of the task that are not met, or why nothing was executed."""
    numbers: dict[str, float | bool | None]
    """Metrics by name, with `feasible` and `executable`; None if not measurable."""
    anomalies: tuple[str, ...]
    """Kinds of anomalies that the detectors report."""


TRIAL = TypeAdapter(ValidityTrial)


def measure(work: Path, episodes: int, sizes: int, jobs: int, observer: RunObserver) -> None:
    """Measure the study on `episodes` episodes; a larger number continues a smaller one.

    Raises:
        UsageError: too few episodes succeed without a fault, or the folder holds something else.
        SetupError: something is missing on this machine, or a worker died. What is finished is kept.
    """
    executor = LocalExecutor(jobs=jobs)
    videos = _plant(work / "videos", episodes, study_grades(sizes), executor, observer)
    config = ScoreConfig(source=work / "videos" / "manifest.jsonl", out=work / "score", jobs=jobs, replays=None)
    rows = {row.id: row for row in score_videos(config, observer).rows}
    specs = {spec.id: spec for spec in study_specs()}
    clips = [
        ClipTrack(
            id=v.id,
            spec=specs[v.episode],
            extractor=Extractor.GROUNDING,
            source=artifact_path(work / "score", "tracks", v.id),
        )
        for v in videos
    ]
    executions = execute_all(clips, work / "executions.jsonl", None, jobs, observer)
    trials = [_trial(v, rows[v.id], done) for v, done in zip(videos, executions, strict=True)]
    write_lines(work / _TRIALS, [TRIAL.dump_python(trial, mode="json") for trial in trials])
    revision = current_revision()
    write_json(work / _STUDY, {"revision": revision, "weights": weights_hash()[:12]})


def _plant(
    folder: Path, episodes: int, grades: tuple[FaultGrade, ...], executor: Executor, observer: RunObserver
) -> list[PlantedVideo]:
    """Render the videos of the first episodes that succeed, and write their index."""
    (folder / "truth").mkdir(parents=True, exist_ok=True)
    store = MeasurementStore(folder / "planted.jsonl", PlantingResult)
    labels = ",".join(grade.label for grade in grades)
    order = partial(PlantingOrder, grades=grades, with_clean=True, out=folder)
    specs = study_specs()
    solved = list[PlantingResult]()
    while len(solved) < episodes:
        orders = [order(spec=spec) for spec in islice(specs, episodes - len(solved))]
        if not orders:
            raise UsageError(f"only {len(solved)} episodes succeed without a fault, {episodes} are wanted")
        results = store.complete(
            orders, lambda o: f"{labels}-{o.spec.id}", executor, make_planter, observer, lambda o: o.spec.id
        )
        solved += [result for result in results if any(video.success for video in result.videos)]
    videos = [video for result in solved for video in result.videos]
    write_index(folder, videos)
    return sorted(videos, key=lambda video: video.id)


def _trial(video: PlantedVideo, row: SampleRow, execution: TrackExecution) -> ValidityTrial:
    numbers = {"executable": row.executable, "feasible": row.feasible}
    return ValidityTrial(
        id=video.id,
        episode=video.episode,
        task=video.task,
        kind=None if video.fault is None else video.fault.kind,
        size=0.0 if video.fault is None else video.fault.size,
        success=execution.success,
        reason=execution.reason,
        numbers={**numbers, **row.metrics.numbers},
        anomalies=tuple(sorted({anomaly.kind.value for anomaly in row.anomalies})),
    )


def read_study(work: Path) -> tuple[list[ValidityTrial], dict[str, Json]]:
    """Read the trials of a work folder, and the revision and weights that they were measured with.

    Raises:
        UsageError: the folder holds no finished measurement.
    """
    if not (work / _STUDY).is_file():
        raise UsageError(f"{work.name}: holds no finished study; run `python -m benchmarks validity measure` first")
    trials = read_lines(work / _TRIALS, TRIAL.validate_python)
    return trials, dict(read_object(work / _STUDY))  # type: ignore[arg-type]
