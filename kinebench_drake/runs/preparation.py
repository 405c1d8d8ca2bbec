"""Preparation of videos for the grounding: their frames, cameras and priors; warnings about them."""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from enum import Enum
from math import inf
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import CONFIRMED, Camera, CameraSource, CameraState
from kinebench_drake.clip_timing import ClipTiming
from kinebench_drake.errors import InputError, count_noun, name_options
from kinebench_drake.formats.camerafile import read_camera
from kinebench_drake.formats.videos.sample import VideoSample
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.overrides.overrides import Overrides
from kinebench_drake.grounding.panels.panel import PanelChoice, choose_panel
from kinebench_drake.grounding.priors import Clip, InitialStateUse, Priors
from kinebench_drake.io.images import read_image
from kinebench_drake.io.reader import read_video
from kinebench_drake.io.video import WHOLE, Video
from kinebench_drake.models.panda.description import GripperKind
from kinebench_drake.named_cameras import find_camera
from kinebench_drake.results.inputs import BENCHMARK_PERIOD_S, PeriodSource
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.runs.benchmark_registry import load_benchmark
from kinebench_drake.runs.config import AUTO
from kinebench_drake.runs.frame_period import TimedFrames, time_frames
from kinebench_drake.track import Domain, GripperTrack, InitialState
from kinebench_drake.view_name import AUTO_VIEW

if TYPE_CHECKING:  # loads torch and Open3D
    from kinebench_drake.grounding.camera.watch import CameraWatch
    from kinebench_drake.grounding.video import Grounder
    from kinebench_drake.grounding.video_result import GroundingResult

_SEVERAL_VIEWS = 2.0
"""Ratio of width to height from which on a frame may show several views."""


def ground_sample(
    video: Video,
    sample: VideoSample,
    overrides: Overrides,
    grounder: "Grounder",
    period_s: float | None = None,
    gripper: GripperKind = GripperKind.AUTO,
    *,
    duration_s: float | None = None,
    view: str = AUTO_VIEW,
    stride: int = 1,
    watch: "CameraWatch | None" = None,
) -> "tuple[TimedFrames, GroundingResult]":
    """Ground a video with the camera, the times and the priors that its sample and the options state.

    Args:
        video: as decoded.
        overrides: stages of the grounding that are replaced; poses leave a camera unchecked.
        period_s: task time between two frames from the command line [s].
        duration_s: task time over which its frames lie evenly [s]; None: they are one period apart.
        view: panel of tiled frames, where the sample names none.
        stride: every how many frames are measured in full.
        watch: spot checks of a named camera; None: it is checked.
    """
    video.require_measurable()
    timed = time_frames(sample, video, period_s, duration_s)
    panels = choose_view(video, sample.view or view, grounder)
    video, image = filmed_pictures(sample, video, panels)
    video.require_measurable()

    def priors(camera: Camera) -> Priors:
        """Read the overrides, which are of all frames of the video."""
        return overrides.priors(override_names(sample), video.frames, camera, sample.initial_state).at(timed.rows)

    frames = video.frames if timed.timing is ClipTiming.NATIVE else video.frames[timed.rows]
    clip = Clip(frames=frames, t_s=timed.t_s, conditioning=image)
    named = sample.camera_source.is_named
    result = grounder.ground(
        clip,
        sample.camera if named else None,
        priors,
        source=sample.camera_source,
        table_height_m=sample.table_height_m if named else None,
        gripper=gripper,
        trusts_camera=overrides.poses is not None,
        stride=stride,
        watch=watch,
    )
    return timed, result if panels is None else replace(result, panels=panels)


def choose_view(video: Video, view: str, grounder: "Grounder") -> PanelChoice | None:
    """Return the panels of the frames of a video and the one that `view` names; None for a single view.

    Raises:
        InputError: no panel has this name.
        UnmeasurableError: no panel shows a robot from outside.
    """
    from kinebench_drake.grounding.panels.split import split_frames  # loads OpenCV

    tiles = split_frames(video.frames)
    if len(tiles) > 1:
        panels = grounder.list_panels(video.frames, tiles)
        return PanelChoice(panels=panels, panel=choose_panel(panels, view))
    if view not in (AUTO_VIEW, "1"):
        raise InputError(f"$view {view}: no seam divides the frames, they show a single view: expected 1 or auto")
    return None


def with_initial_states(samples: Iterable[VideoSample]) -> list[VideoSample]:
    """Return the samples with the initial state of their task and seed, where the manifest names none.

    A video that begins elsewhere, such as the second clip of an episode, is detected by its first frame.
    """
    from kinebench_drake.kinematics.plant import ArmPlant

    plant: ArmPlant | None = None
    completed = []
    for sample in samples:
        task = sample.task
        seed = sample.seed
        if sample.initial_state is None and seed is not None and task is not None:
            q = load_benchmark().start_q(task, seed)
            if q is not None:
                plant = plant or ArmPlant()
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


def read_sample(sample: VideoSample) -> Video:
    """Decode the video of a sample.

    Raises:
        InputError: it cannot be read.
    """
    if sample.problem is not None:
        raise InputError(sample.problem)
    return read_video(sample.path, sample.part)


def filmed_pictures(
    sample: VideoSample, video: Video, panels: PanelChoice | None = None
) -> tuple[Video, NDArray[np.uint8] | None]:
    """Return a decoded video and the image that it was generated from as the camera sees the scene, not mirrored.

    Of tiled frames it is the panel that was chosen; so it is of an image of the size of these frames, another one is
    that of the panel. The image is None where there is none that can be read: one with the name of the video need not
    be its own.
    """
    image = None
    if sample.first_frame is not None:
        with suppress(InputError):
            image = read_image(sample.first_frame)
    if panels is not None:
        part = panels.panel.rectangle
        if image is not None and image.shape[:2] == (video.height, video.width):
            image = np.asarray(part.crop(image[None])[0])
        video = replace(video, frames=part.crop(video.frames))
    if not sample.mirrored:
        return video, image
    return video.mirrored(), None if image is None else np.ascontiguousarray(image[:, ::-1])


def with_camera_option(samples: Sequence[VideoSample], option: str, *, mirrored: bool = False) -> Sequence[VideoSample]:
    """Return the samples with the camera on which the option `camera` insists, and mirrored by `mirrored`.

    A camera by name is that of the samples without one, a camera.json that of all.
    """
    setting = None if option == AUTO else read_camera(option)
    replaces = find_camera(option) is None

    def filmed(sample: VideoSample) -> VideoSample:
        sample = replace(sample, mirrored=sample.mirrored or mirrored)
        is_free = replaces or sample.camera_source is CameraSource.BENCHMARK
        return sample.filmed_by(setting if is_free else None, CameraSource.OPTION)

    return [filmed(sample) for sample in samples]


def row_warnings(rows: Sequence[SampleRow]) -> list[str]:
    """Return warnings about first frames, cameras, clocks and looks, each with its number of samples."""
    measured = [row for row in rows if row.status is Status.OK]

    def count(key: str, value: Enum) -> int:
        return sum(getattr(row, key) == value.value for row in (measured if key == "camera_state" else rows))

    warnings = (
        (
            count("first_frame", InitialStateUse.CONTRADICTED),
            "the first frame contradicts the pose of the manifest, or of the episode of task and seed, in {}: the pose "
            "was not used",
        ),
        (
            sum(row.surplus_frames is not None for row in rows),
            "the video is longer than the table of its dataset in {}: of its frames the first were used, one a row",
        ),
        (
            count("camera_state", CameraState.CONFIRMED),
            "no camera is named for {}: the arm confirms one that is known by name",
        ),
        (
            count("camera_state", CameraState.ESTIMATED),
            "no camera is named for {}: it was estimated from the arm; a camera.json beside the videos, or `calibrate` "
            "with joint angles, is more accurate",
        ),
        (
            sum(row.camera_contradiction is not None for row in measured),
            "the arm contradicts the camera of {}: see camera_contradiction in the rows; check width, height and focal "
            "length of camera.json, leave it out to have the camera estimated, or fit it with `calibrate --joints`",
        ),
        (
            sum(map(_is_unconfirmed, measured)),
            "the arm confirms the camera in all but {}, where its contours are not on image edges: look at the "
            "overlays",
        ),
        (
            sum(row.base_frame_reason is not None for row in measured),
            "no base frame (coordinates of the robot's foot) in {}: reach, limits and verdicts are undecided there, "
            "with the reason",
        ),
        (
            sum(row.panels is not None for row in rows),
            "the frames are tiles of several views in {}: one of them was read, see view and panels in the rows; "
            "$view names another",
        ),
        (
            sum((row.width or 0) >= _SEVERAL_VIEWS * (row.height or inf) for row in rows),
            "{} at least twice as wide as high, in which no seam between views is visible: where a frame shows several "
            "views side by side, cut out the one that shows the arm (docs/faq.md)",
        ),
        (
            count("frame_period_source", PeriodSource.BENCHMARK),
            f"no frame rate in {{}}: {BENCHMARK_PERIOD_S} s between frames was assumed, as in the benchmark; set "
            "$frame_period_s SECONDS if it differs",
        ),
        (
            count("domain", Domain.UNFAMILIAR),
            "{} of unfamiliar look or viewpoint, or with an estimated camera: poses are fitted to edges, with a "
            "confidence of their own, and anomalies of the gripper's shape and number are not looked for",
        ),
    )
    return [text.format(count_noun(n, "sample")) for n, text in warnings if n]


def _is_unconfirmed(row: SampleRow) -> bool:
    """Return whether the arm neither confirms nor contradicts a named camera."""
    is_low = row.camera_agreement is not None and row.camera_agreement < CONFIRMED
    return is_low and row.camera_state == CameraState.NAMED.value and row.camera_contradiction is None


def camera_frame_metrics(track: GripperTrack, reason: str) -> tuple[Mapping[str, float | None], Mapping[str, str]]:
    """Return the smoothness of a track in the camera frame, and the reasons of metrics and verdicts that it lacks."""
    from kinebench_drake.metrics.smoothness import measure_smoothness
    from kinebench_drake.models.panda.description import hand_from_tcp

    reason = name_options(reason)
    X_CG: Array = track.X_CH @ hand_from_tcp()
    smoothness = measure_smoothness(replace(track, X_BG=X_CG))
    reasons = {name: smoothness.reasons.get(name, reason) for name in smoothness.metrics}
    return dict(smoothness.metrics), {**reasons, "feasible": reason, "": reason}
