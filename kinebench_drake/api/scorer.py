"""Scores of clips in a training loop: models that stay loaded, a verdict, its reasons, numbers and a bounded reward."""

import multiprocessing
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.api.runs import PathName, own_arguments
from kinebench_drake.api.single import camera_setting
from kinebench_drake.camera import Camera, CameraSetting, CameraSource
from kinebench_drake.errors import SetupError, UsageError
from kinebench_drake.executors.local import one_thread
from kinebench_drake.formats.videos.sample import VideoSample
from kinebench_drake.grounding.overrides.overrides import Overrides
from kinebench_drake.io.video import Video
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.runs.config import ScoreConfig, check_period
from kinebench_drake.runs.evaluator import SampleHashes, complete_row
from kinebench_drake.runs.resources import Resources
from kinebench_drake.runs.score import VideoEvaluator


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
    reward: float
    """Between 0 and 1: half for a motion that can be executed as a whole, half for the evidence; see `reward_of`."""


def reward_of(row: SampleRow) -> float:
    """Return the reward (v + e) / 2 of a row, between 0 and 1.

    v is 1 if the clip is executable and the arm moves, else 0; an open verdict counts as no. e is the mean confidence
    over all frames, 0 for those without a pose. A frame that is lost lowers e and can only open a verdict, so a model
    gains nothing by hiding the gripper; nor by standing still.
    """
    if row.status is not Status.OK:
        return 0.0
    evidence = (row.metrics.confidence_mean or 0.0) * (row.metrics.tracked_fraction or 0.0)
    verdict = row.executable is True and not row.metrics.motionless
    return 0.5 * (float(verdict) + evidence)


class Scorer:
    """Scores clips; the networks and the robot are loaded once, in each process.

    Example:
        with Scorer(jobs=2) as scorer:
            scores = scorer.batch(clips, camera=camera, period_s=0.2)
            best = clips[max(range(len(clips)), key=lambda k: scores[k].reward)]
    """

    def __init__(self, *, jobs: int = 1) -> None:
        """Create a scorer; processes start, and models are loaded, with the first clip.

        Args:
            jobs: processes of `batch`; 1: the calling one. With more, a script needs the guard
                `if __name__ == "__main__":`.

        Raises:
            UsageError: there is no such number of processes.
        """
        if jobs < 1:
            raise UsageError(f"jobs is {jobs}, expected 1 or more")
        self._jobs = jobs
        self._tools: Resources | None = None
        self._pool: ProcessPoolExecutor | None = None

    @own_arguments()
    def __call__(
        self,
        frames: NDArray[np.uint8],
        *,
        camera: Camera | CameraSetting | PathName | None = None,
        period_s: float,
    ) -> Score:
        """Score one clip in this process; one that cannot be measured has a reward of 0 and its reason.

        Args:
            frames: (T, H, W, 3) uint8 RGB.
            camera: the camera, what its camera.json states, or its name or the path of that file; None: the benchmark's
                or another named one where the arm confirms it, else estimated.
            period_s: task time between two frames [s].

        Raises:
            UsageError: an argument cannot be used.
            SetupError: weights or libraries are missing.
        """
        if self._tools is None:
            self._tools = _evaluator(period_s).setup()
        return _score(self._tools, frames, camera_setting(camera), period_s)

    @own_arguments()
    def batch(
        self,
        clips: Sequence[NDArray[np.uint8]],
        *,
        camera: Camera | CameraSetting | PathName | None = None,
        period_s: float,
    ) -> list[Score]:
        """Score some clips of one camera, in `jobs` processes that stay; arguments and exceptions as for one clip."""
        if self._jobs == 1:
            return [self(frames, camera=camera, period_s=period_s) for frames in clips]
        if self._pool is None:
            self._pool = ProcessPoolExecutor(self._jobs, multiprocessing.get_context("spawn"), _start)
        try:
            return list(self._pool.map(partial(_score_here, camera=camera_setting(camera), period_s=period_s), clips))
        except BrokenProcessPool:
            self.close()
            raise SetupError("a process of the scorer ended, such as for lack of memory: use fewer jobs") from None

    def close(self) -> None:
        """End the processes."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _evaluator(period_s: float) -> VideoEvaluator:
    nowhere = Path("unwritten")
    config = ScoreConfig(out=nowhere, source=nowhere, frame_period_s=period_s)
    return VideoEvaluator(config=config, overrides=Overrides())


def _score(tools: Resources, frames: NDArray[np.uint8], camera: CameraSetting | None, period_s: float) -> Score:
    check_period(period_s)
    sample = VideoSample(id="clip", path=Path("clip"), video="clip").filmed_by(camera, CameraSource.ARGUMENT)
    evaluator = _evaluator(period_s)
    video = Video(frames=np.asarray(frames), fps=None, stamps_s=None)
    with one_thread():
        blank = evaluator.blank_row(sample, SampleHashes(content="", input=None))
        row = complete_row(blank, lambda row: evaluator.measure(sample, video, tools, row).row)
    numbers = {name: float(value) for name, value in row.metrics.numbers.items() if value is not None}
    reasons = row.executable_reasons if row.reason is None else (row.reason,)
    return Score(
        executable=row.executable if row.status is Status.OK else None,
        feasible=row.feasible,
        reasons=reasons,
        numbers={name: value for name, value in numbers.items() if np.isfinite(value)},
        reward=reward_of(row),
    )


_own: list[Resources] = []
"""Resources of a worker process."""


def _start() -> None:
    _own.append(_evaluator(1.0).setup())


def _score_here(frames: NDArray[np.uint8], *, camera: CameraSetting | None, period_s: float) -> Score:
    return _score(_own[0], frames, camera, period_s)
