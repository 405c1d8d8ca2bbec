"""Scores of clips in a training loop: models that stay loaded, a verdict, its reasons, numbers and a bounded reward."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
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
from kinebench_drake.runs.score import VideoEvaluator, VideoMeasurement

if TYPE_CHECKING:  # loads Drake
    from kinebench_drake.metrics.executability import Executability

SPOT_CHECK = 16
"""Clips of which one has the camera of a `Scorer` checked."""
_NOWHERE = Path("unwritten")


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

    def __init__(
        self,
        *,
        jobs: int = 1,
        weights: Mapping[str, float] | None = None,
        camera: Camera | CameraSetting | PathName | None = None,
        stride: int = 1,
    ) -> None:
        """Create a scorer; processes start, and models are loaded, with the first clip.

        Args:
            jobs: processes of `batch`; 1: the calling one. With more, a script needs the guard
                `if __name__ == "__main__":`.
            weights: exponents of the terms of the executability, 0 leaves one out; 1 for those not named.
            camera: the camera of all clips for which a call names none, as in a call. In each process it is checked
                with every clip until one passes, then with one clip in 16; None: each clip's is checked.
            stride: every how many frames are measured in full (docs/reward.md).

        Raises:
            UsageError: there is no such number of processes, no such camera, or no such stride.
        """
        for name, value in {"jobs": jobs, "stride": stride}.items():
            if value < 1:
                raise UsageError(f"{name} is {value}, expected 1 or more")
        self._jobs = jobs
        self._weights = dict(weights or {})
        self._make_worker = partial(_ClipScorer, camera_setting(camera), stride)
        self._worker: _ClipScorer | None = None
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
            self._queue = JobQueue(self._make_worker, workers=self._jobs, most=np.inf)
        futures = self._queue.submit([(frames, ask) for frames in clips])
        return [future.result() for future in futures or ()]

    def _score(self, frames: NDArray[np.uint8], ask: Mapping[str, Any]) -> Score:
        if self._worker is None:
            self._worker = self._make_worker()
        return self._worker((frames, ask))

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


class _ClipScorer:
    """Scoring of clips in one process."""

    def __init__(self, camera: CameraSetting | None, stride: int) -> None:
        from kinebench_drake.grounding.camera.watch import CameraWatch  # loads torch

        config = ScoreConfig(out=_NOWHERE, source=_NOWHERE, stride=stride)
        self._evaluator = VideoEvaluator(config=config, overrides=Overrides())
        self._tools = self._evaluator.setup()
        self._camera = camera
        self._watch = CameraWatch(every=SPOT_CHECK)

    def __call__(self, item: tuple[NDArray[np.uint8], Mapping[str, Any]]) -> Score:
        """Score frames (T, H, W, 3) with the arguments of a call."""
        frames, ask = item
        return self._score(np.asarray(frames), **ask)

    def _score(
        self, frames: NDArray[np.uint8], *, camera: CameraSetting | None, period_s: float, **rating: Any
    ) -> Score:
        check_period(period_s)
        watch = self._watch if camera is None and self._camera is not None else None
        sample = VideoSample(id="clip", path=Path("clip"), video="clip", frame_period_s=period_s)
        sample = sample.filmed_by(camera or self._camera, CameraSource.ARGUMENT)
        video = Video(frames=frames, fps=None, stamps_s=None)
        measured: list[VideoMeasurement] = []

        def measure(row: SampleRow) -> SampleRow:
            measured.append(self._evaluator.measure(sample, video, self._tools, row, watch))
            return measured[0].row

        with one_thread():
            row = complete_row(self._evaluator.blank_row(sample, SampleHashes(content="", input=None)), measure)
        return _read_score(row, _rate(measured[0], **rating) if measured else None)


def _read_score(row: SampleRow, rating: "Executability | None") -> Score:
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
