"""Preparation of a video for the grounding: its frames, their times, their camera and the priors."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError, UnmeasurableError
from kinebench_drake.formats.videos.sample import CameraSource, VideoSample
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.overrides.overrides import Overrides
from kinebench_drake.io.images import read_image
from kinebench_drake.io.video import WHOLE, Video
from kinebench_drake.results.inputs import PeriodSource
from kinebench_drake.suites.clock import ClipTiming, sample_uniformly
from kinebench_drake.suites.start import START_WIDTH_M, start_q
from kinebench_drake.types import InitialState, Priors

if TYPE_CHECKING:  # loads OpenCV
    from kinebench_drake.grounding.framing.framing import Framing

BENCHMARK_PERIOD_S = 0.2
"""Task time between two frames of a benchmark video (4 control steps at 20 Hz) [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparedVideo:
    """Input of the grounding."""

    frames: NDArray[np.uint8]
    """(T, H, W, 3) RGB, without letter-box bars."""
    camera: Camera
    """Camera of these frames."""
    t_s: Array
    """(T,) task time of each frame [s]."""
    period_s: float
    """Task time between two frames [s]."""
    period_source: PeriodSource
    timing: ClipTiming
    """How the frames of the video lie in task time."""
    framing: "Framing"
    """How the camera's image lies in the video."""
    priors: Priors
    """Quantities that replace estimates."""


def prepare_video(
    video: Video,
    sample: VideoSample,
    period_s: float | None,
    overrides: Overrides,
    *,
    duration_s: float | None = None,
) -> PreparedVideo:
    """Determine frames, camera, times and priors of a video.

    Args:
        video: as decoded.
        sample: labels and camera of the video.
        period_s: task time between two frames from the command line [s].
        overrides: stages of the grounding that are replaced.
        duration_s: task time over which its frames lie evenly [s]; None: they are one period apart.

    Raises:
        InputError: an override is missing, broken or does not fit the video.
        UnmeasurableError: the video is too small or too short, or its shape does not fit the camera's image.
        SetupError: a plug-in cannot be loaded.
    """
    video.require_measurable()
    framing = find_video_framing(sample, video)
    chosen, t_s, period_s, source = choose_frames(sample, video, period_s, duration_s)
    camera = framing.whole_camera(sample.camera)
    priors = overrides.priors(override_names(sample), video.frames, camera, sample.initial_state)
    priors = replace(
        priors,
        camera_is_fitted=sample.camera_source in (CameraSource.ESTIMATED, CameraSource.NONE),
        table_height_m=sample.table_height_m,
    )
    frames = video.frames
    if len(chosen) < len(frames):
        frames, priors = frames[chosen], priors.at(chosen)
    return PreparedVideo(
        frames=framing.crop(frames),
        camera=framing.camera(sample.camera),
        t_s=t_s,
        period_s=period_s,
        period_source=source,
        timing=ClipTiming.NATIVE if duration_s is None else ClipTiming.UNIFORM,
        framing=framing,
        priors=priors.crop(*framing.window),
    )


def with_initial_states(samples: Iterable[VideoSample]) -> list[VideoSample]:
    """Return the samples with the initial state of their task and seed, where the manifest names none.

    A video that begins elsewhere, such as the second clip of an episode, is detected by its first frame.

    Raises:
        SetupError: the Panda's files are missing.
    """
    from kinebench_drake.kinematics.plant import ArmPlant

    plant: ArmPlant | None = None
    completed = []
    for sample in samples:
        task, seed = sample.task, sample.seed
        if sample.initial_state is None and seed is not None and task is not None and task in START_WIDTH_M:
            plant = plant or ArmPlant()
            q = start_q(task, seed)
            initial = InitialState(X_BG=plant.forward(q[:7]), finger_width_m=float(q[7:].sum()))
            sample = replace(sample, initial_state=initial)
        completed.append(sample)
    return completed


def override_names(sample: VideoSample) -> tuple[str, ...]:
    """Return the names that the sample's overrides may have: its id, or the name of the video."""
    if sample.part != WHOLE:
        return (sample.id,)
    stem = sample.path.name if sample.path.is_dir() else sample.path.stem
    return tuple(dict.fromkeys((sample.id, stem)))


def choose_frames(
    sample: VideoSample, video: Video, option_s: float | None, duration_s: float | None
) -> tuple[NDArray[np.intp], Array, float, PeriodSource]:
    """Return the frames to use, their task times [s], the period between two [s], and its source."""
    count = len(video.frames)
    if duration_s is None:
        return np.arange(count), *_times(sample, video, option_s)
    chosen, t_s = sample_uniformly(count, duration_s, option_s or BENCHMARK_PERIOD_S)
    return chosen, t_s, duration_s / (len(t_s) - 1), PeriodSource.TASK_DURATION


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


def find_video_framing(sample: VideoSample, video: Video) -> "Framing":
    """Determine how the camera's image lies in the video.

    Raises:
        UnmeasurableError: the shapes differ, and nothing explains it.
    """
    from kinebench_drake.grounding.framing.search import find_framing  # loads OpenCV

    try:
        conditioning = None if sample.first_frame is None else read_image(sample.first_frame)
    except InputError:
        conditioning = None  # an image with the name of the video need not be its conditioning image
    if sample.mirrored and conditioning is not None:
        conditioning = np.ascontiguousarray(conditioning[:, ::-1])
    try:
        return find_framing(video.frames, sample.camera, conditioning)
    except UnmeasurableError as error:
        raise UnmeasurableError(f"{sample.camera_source.value} {error}") from None
