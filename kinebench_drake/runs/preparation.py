"""Preparation of a video for the grounding: its frames, their times, their camera and the priors."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera, CameraSetting
from kinebench_drake.errors import InputError, UnmeasurableError
from kinebench_drake.formats.videos.sample import VideoSample
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.clip import Clip
from kinebench_drake.grounding.overrides.overrides import Overrides
from kinebench_drake.grounding.priors import Priors
from kinebench_drake.io.images import read_image
from kinebench_drake.io.video import WHOLE, Video
from kinebench_drake.models.panda.robot import GripperKind
from kinebench_drake.results.inputs import PeriodSource
from kinebench_drake.suites.clock import ClipTiming, sample_uniformly
from kinebench_drake.suites.start import START_WIDTH_M, start_q
from kinebench_drake.track import InitialState

if TYPE_CHECKING:  # loads torch and Open3D
    from kinebench_drake.grounding.video import Grounder, GroundingResult

BENCHMARK_PERIOD_S = 0.2
"""Task time between two frames of a benchmark video (4 control steps at 20 Hz) [s]."""


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
        sample: labels of the video.
        video: as decoded.
        option_s: task time between two frames from the command line [s].
        duration_s: task time over which its frames lie evenly [s]; None: they are one period apart.
    """
    count = len(video.frames)
    if duration_s is None:
        t_s, period_s, source = _times(sample, video, option_s)
        rows, timing = np.arange(count), ClipTiming.NATIVE
    else:
        rows, t_s = sample_uniformly(count, duration_s, option_s or BENCHMARK_PERIOD_S)
        period_s, source, timing = duration_s / (len(t_s) - 1), PeriodSource.TASK_DURATION, ClipTiming.UNIFORM
    return TimedFrames(rows=rows, t_s=t_s, period_s=period_s, source=source, timing=timing)


def ground_sample(
    video: Video,
    sample: VideoSample,
    overrides: Overrides,
    grounder: "Grounder",
    period_s: float | None = None,
    gripper: GripperKind = GripperKind.AUTO,
    *,
    duration_s: float | None = None,
) -> "tuple[TimedFrames, GroundingResult]":
    """Ground a video with the camera, the times and the priors that its sample and the options state.

    Args:
        video: as decoded.
        sample: labels and camera of the video.
        overrides: stages of the grounding that are replaced; poses leave a camera unchecked.
        grounder: the grounding.
        period_s: task time between two frames from the command line [s].
        gripper: gripper of the robot.
        duration_s: task time over which its frames lie evenly [s]; None: they are one period apart.

    Raises:
        InputError: an override is missing, broken or does not fit the video.
        UnmeasurableError: the video is too small or too short, does not fit its camera, or shows no gripper.
        SetupError: weights, libraries or a plug-in are missing.
    """
    video.require_measurable()
    timed = time_frames(sample, video, period_s, duration_s)
    if sample.mirrored:
        video = video.mirrored()

    def priors(camera: Camera) -> Priors:
        """Read the overrides, which are of all frames of the video."""
        return overrides.priors(override_names(sample), video.frames, camera, sample.initial_state).at(timed.rows)

    image = _conditioning_image(sample)
    clip = Clip(frames=video.frames[timed.rows], t_s=timed.t_s, conditioning=image)
    named = sample.camera_source.is_named
    setting = CameraSetting(camera=sample.camera, table_height_m=sample.table_height_m)
    result = grounder.ground(
        clip,
        setting if named else None,
        priors,
        source=sample.camera_source,
        gripper=gripper,
        trusts_camera=overrides.poses is not None,
    )
    return timed, result


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


def _conditioning_image(sample: VideoSample) -> NDArray[np.uint8] | None:
    """Return the image from which the video was generated; None without a usable one."""
    try:
        image = None if sample.first_frame is None else read_image(sample.first_frame)
    except InputError:
        return None  # an image with the name of the video need not be its conditioning image
    return np.ascontiguousarray(image[:, ::-1]) if image is not None and sample.mirrored else image


def check_framing(sample: VideoSample, video: Video) -> None:
    """Check that the named camera's image lies in the video.

    Raises:
        UnmeasurableError: the shapes differ, and nothing explains it.
    """
    from kinebench_drake.grounding.framing.search import find_framing  # loads OpenCV

    try:
        find_framing(video.frames, sample.camera, _conditioning_image(sample))
    except UnmeasurableError as error:
        raise UnmeasurableError(f"{sample.camera_source.value} {error}") from None
