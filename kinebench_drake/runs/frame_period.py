"""Task times of the frames of a video: the frame period and its source, and the frames that are used."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.clip_timing import ClipTiming, sample_uniformly
from kinebench_drake.formats.videos.sample import VideoSample
from kinebench_drake.geometry import Array
from kinebench_drake.io.video import Video
from kinebench_drake.results.inputs import BENCHMARK_PERIOD_S, PeriodSource


@dataclass(frozen=True, slots=True, kw_only=True)
class TimedFrames:
    """Frames of a video that are used, and when they are."""

    rows: NDArray[np.intp]
    """(T,) their numbers in the video."""
    t_s: Array
    """(T,) task time of each [s]."""
    period_s: float
    """Task time between two [s]."""
    source: PeriodSource
    timing: ClipTiming
    """How the frames of the video lie in task time."""


def time_frames(sample: VideoSample, video: Video, option_s: float | None, duration_s: float | None) -> TimedFrames:
    """Choose the frames of a video and determine their times.

    Args:
        video: as decoded.
        option_s: task time between two frames from the command line [s].
        duration_s: task time over which its frames lie evenly [s]; None: they are one period apart.
    """
    count = len(video.frames)
    if duration_s is None:
        t_s, period_s, source = _times(sample, video, option_s)
        rows = np.arange(count)
        timing = ClipTiming.NATIVE
    else:
        rows, t_s = sample_uniformly(count, duration_s, option_s or BENCHMARK_PERIOD_S)
        period_s = duration_s / (len(t_s) - 1)
        source = PeriodSource.TASK_DURATION
        timing = ClipTiming.UNIFORM
    return TimedFrames(rows=rows, t_s=t_s, period_s=period_s, source=source, timing=timing)


def _times(sample: VideoSample, video: Video, option_s: float | None) -> tuple[Array, float, PeriodSource]:
    """Return the task time of each frame [s], the period between two [s], and its source."""
    periods = {
        PeriodSource.MANIFEST: sample.frame_period_s,
        PeriodSource.OPTION: option_s,
        PeriodSource.MANIFEST_FPS: None if sample.fps is None else 1.0 / sample.fps,
        PeriodSource.DATASET: sample.dataset_period_s,
        PeriodSource.TIME_STAMPS: None if video.stamps_s is None else float(np.median(np.diff(video.stamps_s))),
        PeriodSource.FPS: None if video.fps is None else 1.0 / video.fps,
        PeriodSource.BENCHMARK: BENCHMARK_PERIOD_S,
    }
    period_s, source = next((period, source) for source, period in periods.items() if period is not None)
    if video.stamps_s is not None and source is PeriodSource.TIME_STAMPS:
        return video.stamps_s, period_s, source
    return np.arange(len(video.frames), dtype=np.float64) * period_s, period_s, source
