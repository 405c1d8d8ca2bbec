"""A video made ready to be grounded: its frames, their camera, their times, and what is known of them beforehand."""

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError, UnmeasurableError, UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.decoded import Video
from kinebench_drake.grounding.frame_folder import read_picture
from kinebench_drake.grounding.framing import Framing
from kinebench_drake.grounding.known import Known
from kinebench_drake.grounding.sources.sources import Sources
from kinebench_drake.inputs import Sample
from kinebench_drake.manifest import MAX_PERIOD_S, MIN_PERIOD_S
from kinebench_drake.measure import MIN_TRACKED
from kinebench_drake.stages import Grounded, Stages

BENCHMARK_PERIOD_S = 0.2
"""Task time between two frames of a benchmark video (4 control steps at 20 Hz) [s]."""


class PeriodSource(Enum):
    """Where the task time between two frames comes from, in order of precedence."""

    MANIFEST = "manifest"
    OPTION = "option"
    MANIFEST_FPS = "manifest_fps"
    DATASET = "dataset"
    TIME_STAMPS = "time_stamps"
    FPS = "fps"
    BENCHMARK = "benchmark"


@dataclass(frozen=True, slots=True, kw_only=True)
class Footage:
    """What the grounding is given."""

    frames: NDArray[np.uint8]
    """(T, H, W, 3) RGB, without the bars that the video may have."""
    camera: Camera
    """The camera of these frames."""
    t_s: Array
    """(T,) task time of each frame [s]."""
    period_s: float
    """Task time between two frames [s]."""
    period_source: PeriodSource
    framing: Framing
    """What was done to the camera's picture."""
    known: Known
    """What takes the place of estimates."""

    def ground(self, stages: Stages) -> Grounded:
        """Find the gripper.

        Raises:
            InputError: what is known is of another video.
            UnmeasurableError: too few frames show a gripper to make a path.
            SetupError: weights or libraries are missing.
        """
        grounded = stages.ground(self.frames, self.camera, self.t_s, self.known)
        tracked = int(grounded.track.tracked.sum())
        if tracked < MIN_TRACKED:
            raise UnmeasurableError(
                f"the gripper was found in {tracked} of {len(self.t_s)} frames, a path needs {MIN_TRACKED}: is the "
                "robot in view, and is this the video's camera?"
            )
        return grounded


def make_footage(video: Video, sample: Sample, period_s: float | None, sources: Sources) -> Footage:
    """Make a video ready.

    Args:
        video: as decoded.
        sample: what its owner says about it.
        period_s: task time between two frames [s] from the command line.
        sources: which stages of the grounding are done elsewhere.

    Raises:
        InputError: what takes the place of estimates is absent, broken or of another video.
        UnmeasurableError: the video is too small or too short, or of another shape than its camera's picture.
        SetupError: a plug-in cannot be made ready.
    """
    video.require_measurable()
    framing = _framing(sample, video)
    t_s, period_s, source = _times(sample, video, period_s)
    whole = sources.known(names_of(sample), video.frames, framing.whole_camera(sample.camera), sample.first)
    return Footage(
        frames=framing.cut(video.frames),
        camera=framing.camera(sample.camera),
        t_s=t_s,
        period_s=period_s,
        period_source=source,
        framing=framing,
        known=whole.cut(*framing.window),
    )


def check_period(period_s: float | None) -> None:
    """Make sure that a task time between two frames, where one is told, is one.

    Raises:
        UsageError: it is not.
    """
    if period_s is not None and not MIN_PERIOD_S <= period_s <= MAX_PERIOD_S:
        raise UsageError(
            f"--frame-period is {period_s}, expected seconds from {MIN_PERIOD_S:g} to {MAX_PERIOD_S:g}, such as 0.2"
        )


def names_of(sample: Sample) -> tuple[str, ...]:
    """What files that belong to the video may be called: after its id, or after the video itself."""
    if sample.is_part:
        return (sample.id,)
    stem = sample.path.name if sample.path.is_dir() else sample.path.stem
    return tuple(dict.fromkeys((sample.id, stem)))


def _times(sample: Sample, video: Video, option_s: float | None) -> tuple[Array, float, PeriodSource]:
    """Task time of each frame [s], the period between two [s], and where it comes from."""
    if sample.frame_period_s is not None:
        period_s, source = sample.frame_period_s, PeriodSource.MANIFEST
    elif option_s is not None:
        period_s, source = option_s, PeriodSource.OPTION
    elif sample.fps is not None:
        period_s, source = 1.0 / sample.fps, PeriodSource.MANIFEST_FPS
    elif sample.dataset_period_s is not None:
        period_s, source = sample.dataset_period_s, PeriodSource.DATASET
    elif video.stamps_s is not None:
        return video.stamps_s, float(np.median(np.diff(video.stamps_s))), PeriodSource.TIME_STAMPS
    elif video.fps is not None:
        period_s, source = 1.0 / video.fps, PeriodSource.FPS
    else:
        period_s, source = BENCHMARK_PERIOD_S, PeriodSource.BENCHMARK
    return np.arange(len(video.frames), dtype=np.float64) * period_s, period_s, source


def _framing(sample: Sample, video: Video) -> Framing:
    """Where the camera's picture is in the video.

    Raises:
        UnmeasurableError: its shape is another, and nothing tells why.
    """
    from kinebench_drake.grounding.reframing import find_framing  # loads OpenCV

    try:
        picture = None if sample.first_frame is None else read_picture(sample.first_frame)
    except InputError:
        picture = None  # a picture that happens to be called like the video need not be one
    try:
        return find_framing(video.frames, sample.camera, picture)
    except UnmeasurableError as error:
        raise UnmeasurableError(f"{sample.camera_source.value} {error}") from None
