"""Scores of clips in a training loop: models that stay loaded, a verdict, its reasons, numbers and a bounded reward."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.api.runs import PathName, own_arguments
from kinebench_drake.api.single import camera_setting
from kinebench_drake.camera import Camera, CameraSetting, CameraSource
from kinebench_drake.errors import UsageError
from kinebench_drake.executors.local import one_thread
from kinebench_drake.executors.queue import JobQueue
from kinebench_drake.formats.videos.sample import VideoSample
from kinebench_drake.grounding.overrides.overrides import Overrides
from kinebench_drake.io.video import Video
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.runs.config import ScoreConfig, check_period
from kinebench_drake.runs.evaluator import SampleHashes, complete_row
from kinebench_drake.runs.resources import Resources
from kinebench_drake.runs.score import VideoEvaluator, VideoMeasurement

if TYPE_CHECKING:  # loads Drake
    from kinebench_drake.metrics.executability import Executability


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """What the geometry of one clip says."""

    executable: bool | None
    """Whether a robot can do all that the clip shows; None: frames could not be measured, or there is no base frame."""
    feasible: bool | None
    """Whether the arm can follow the motion that was seen; None if undecided."""
    reasons: tuple[str, ...]
    """What speaks against the clip, and what could not be measured."""
    numbers: Mapping[str, float]
    """Metrics by name, as in samples.jsonl, without those that could not be measured. NAME_bound: the worst that NAME
    can be where frames are lost."""
    executability: float | None
    """Score of the motion with the weights of the scorer, 0 to 1 (docs/reward.md); None: too little was measured, or
    there is no base frame."""
    terms: Mapping[str, float]
    """Score by each term alone, and by the lost frames (`coverage`); empty where there is none."""

    @classmethod
    def failed(cls, reason: str) -> Self:
        """Return the score of a clip that could not be read."""
        return cls(executable=None, feasible=None, reasons=(reason,), numbers={}, executability=None, terms={})

    @property
    def reward(self) -> float:
        """The executability; 0 where there is none."""
        return self.executability or 0.0


class Scorer:
    """Scores clips; the networks and the robot are loaded once, in each process.

    Example:
        with Scorer(jobs=2) as scorer:
            scores = scorer.batch(clips, camera=camera, period_s=0.2)
            best = clips[max(range(len(clips)), key=lambda k: scores[k].reward)]
    """

    def __init__(self, *, jobs: int = 1, weights: Mapping[str, float] | None = None) -> None:
        """Create a scorer; processes start, and models are loaded, with the first clip.

        Args:
            jobs: processes of `batch`; 1: the calling one. With more, a script needs the guard
                `if __name__ == "__main__":`.
            weights: exponents of the terms of the executability, 0 leaves one out; 1 for those not named.

        Raises:
            UsageError: there is no such number of processes.
        """
        if jobs < 1:
            raise UsageError(f"jobs is {jobs}, expected 1 or more")
        self._jobs = jobs
        self._weights = dict(weights or {})
        self._tools: Resources | None = None
        self._queue: JobQueue[tuple[NDArray[np.uint8], Mapping[str, Any]], Score] | None = None

    @own_arguments()
    def __call__(
        self,
        frames: NDArray[np.uint8],
        *,
        camera: Camera | CameraSetting | PathName | None = None,
        period_s: float,
        first_frame: NDArray[np.uint8] | None = None,
        motion_m: float | None = None,
    ) -> Score:
        """Score one clip in this process; one that cannot be measured has a reward of 0 and its reason.

        Args:
            frames: (T, H, W, 3) uint8 RGB.
            camera: the camera, what its camera.json states, or its name or the path of that file; None: the benchmark's
                or another named one where the arm confirms it, else estimated.
            period_s: task time between two frames [s].
            first_frame: (h, w, 3) uint8 RGB, the image with which the clip should begin; None: not compared.
            motion_m: length of the path that is expected of the TCP, such as that of a reference [m]; None: unknown.

        Raises:
            UsageError: an argument cannot be used.
            SetupError: weights or libraries are missing.
        """
        rating = {"weights": self._weights, "first_frame": first_frame, "motion_m": motion_m}
        return self._score(frames, {"camera": camera_setting(camera), "period_s": period_s, **rating})

    @own_arguments()
    def batch(
        self,
        clips: Sequence[NDArray[np.uint8]],
        *,
        camera: Camera | CameraSetting | PathName | None = None,
        period_s: float,
        first_frame: NDArray[np.uint8] | None = None,
        motion_m: float | None = None,
    ) -> list[Score]:
        """Score some clips of one prompt, in `jobs` processes that stay; arguments and exceptions as for one clip."""
        rating = {"weights": self._weights, "first_frame": first_frame, "motion_m": motion_m}
        ask = {"camera": camera_setting(camera), "period_s": period_s, **rating}
        if self._jobs == 1:
            return [self._score(frames, ask) for frames in clips]
        if self._queue is None:
            self._queue = JobQueue(_make_worker, workers=self._jobs, most=np.inf)
        futures = self._queue.submit([(frames, ask) for frames in clips])
        return [future.result() for future in futures or ()]

    def _score(self, frames: NDArray[np.uint8], ask: Mapping[str, Any]) -> Score:
        if self._tools is None:
            self._tools = _evaluator(ask["period_s"]).setup()
        return _score(self._tools, frames, **ask)

    def close(self) -> None:
        """End the processes."""
        if self._queue is not None:
            self._queue.close()
            self._queue = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


@lru_cache(maxsize=8)
def _evaluator(period_s: float) -> VideoEvaluator:
    nowhere = Path("unwritten")
    config = ScoreConfig(out=nowhere, source=nowhere, frame_period_s=period_s)
    return VideoEvaluator(config=config, overrides=Overrides())


def _score(
    tools: Resources, frames: NDArray[np.uint8], *, camera: CameraSetting | None, period_s: float, **ask: Any
) -> Score:
    check_period(period_s)
    sample = VideoSample(id="clip", path=Path("clip"), video="clip").filmed_by(camera, CameraSource.ARGUMENT)
    evaluator = _evaluator(period_s)
    video = Video(frames=np.asarray(frames), fps=None, stamps_s=None)
    measured: list[VideoMeasurement] = []

    def measure(row: SampleRow) -> SampleRow:
        measured.append(evaluator.measure(sample, video, tools, row))
        return measured[0].row

    with one_thread():
        row = complete_row(evaluator.blank_row(sample, SampleHashes(content="", input=None)), measure)
    rating = _rate(measured[0], **ask) if measured else None
    numbers = {name: float(value) for name, value in row.metrics.numbers.items() if value is not None}
    reasons = row.executable_reasons if row.reason is None else (row.reason,)
    return Score(
        executable=row.executable if row.status is Status.OK else None,
        feasible=row.feasible,
        reasons=reasons,
        numbers={name: value for name, value in numbers.items() if np.isfinite(value)},
        executability=rating.score if rating else None,
        terms=rating.terms if rating else {},
    )


def _rate(
    measured: VideoMeasurement,
    *,
    weights: Mapping[str, float],
    first_frame: NDArray[np.uint8] | None,
    motion_m: float | None,
) -> "Executability | None":
    from kinebench_drake.metrics.executability import FAULT, gather_faults, rate_faults, start_ratio  # loads Drake

    if measured.kinematics is None:
        return None
    curves = dict(measured.grounding.measured.curves)
    if first_frame is not None:
        ratio = start_ratio(measured.grounding.frames[0], first_frame)
        curves[FAULT + "start"] = np.full(len(measured.grounding.track.t_s), ratio)
    faults = gather_faults(measured.kinematics, curves)
    return rate_faults(faults, weights, motion_m) if faults else None


def _make_worker() -> Callable[[tuple[NDArray[np.uint8], Mapping[str, Any]]], Score]:
    tools = _evaluator(1.0).setup()
    return lambda item: _score(tools, item[0], **item[1])
