"""Grounding of a video: choose its camera, track the gripper or the flange, check the camera against the arm."""

from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

from kinebench_drake.datasets.videos.sample import VideoSample
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.evaluation.analyzer import Analyzer
from kinebench_drake.evaluation.camera import (
    AUTO,
    CONFIRMED,
    CameraChoice,
    check_camera,
    choose_camera,
    explain_loss,
    is_assumed,
    track_agreement,
)
from kinebench_drake.evaluation.evaluator import MIN_TRACKED
from kinebench_drake.evaluation.preparation import PreparedVideo, find_video_framing, prepare_video
from kinebench_drake.grounding.overrides.overrides import Overrides
from kinebench_drake.io.video import Video
from kinebench_drake.types import Domain, GripperKind

if TYPE_CHECKING:  # torch and Open3D take seconds to load
    from kinebench_drake.grounding.pipeline import GroundingResult

HAND_SHARE, ARM_SHARE = 0.1, 0.5
"""Share of tracked frames below which a hand counts as not seen, and from which on an arm does."""


def ground_with_camera(
    video: Video,
    sample: VideoSample,
    overrides: Overrides,
    analyzer: Analyzer,
    option: str = AUTO,
    period_s: float | None = None,
    gripper: GripperKind = GripperKind.AUTO,
    *,
    duration_s: float | None = None,
) -> tuple[CameraChoice, PreparedVideo, "GroundingResult"]:
    """Choose the camera of a video, ground the video, and check a camera of the input against the arm.

    Args:
        video: as decoded.
        sample: labels and camera of the video.
        overrides: stages of the grounding that are replaced; poses leave a camera unchecked.
        analyzer: checks and estimates cameras, grounds.
        option: value of `--camera`.
        period_s: task time between two frames [s]; None: the video's own.
        gripper: value of `--gripper`.
        duration_s: task time over which the frames lie evenly [s]; None: they are one period apart.

    Raises:
        InputError: an override does not fit the video.
        UnmeasurableError: the video is too small or too short, or the gripper was found in too few frames.
        SetupError: weights or libraries are missing.
    """
    measured = None
    if is_assumed(sample, option) and overrides.poses is None and gripper in (GripperKind.AUTO, GripperKind.FRANKA):
        with suppress(UnmeasurableError):  # the shape of the video is not that of the benchmark camera's image
            prepared = prepare_video(video, sample, period_s, overrides, duration_s=duration_s)
            measured, agreement = _ground_as_assumed(prepared, analyzer)
            if agreement >= CONFIRMED:
                return CameraChoice(sample=sample, agreement=agreement), prepared, measured
    if measured is not None and _is_empty(measured):  # nothing that could agree with another camera
        choice = CameraChoice(sample=sample)
    else:
        choice = choose_video_camera(video, sample, option, overrides, analyzer)
    if choice.sample is not sample or (measured is not None and not _is_complete(measured)):
        measured = None
    prepared = prepare_video(video, choice.sample, period_s, overrides, duration_s=duration_s)
    try:
        grounding = ground_prepared(prepared, analyzer, gripper, measured=measured)
    except UnmeasurableError as error:
        if overrides.poses is not None:
            raise
        raise UnmeasurableError(f"{error}{explain_loss(choice, prepared.frames, prepared.camera, analyzer)}") from None
    if overrides.poses is None and grounding.camera_path is None and grounding.domain is not Domain.ARM:
        choice = check_camera(choice, prepared.frames, prepared.camera, grounding, analyzer)
    return choice, prepared, grounding


def choose_video_camera(
    video: Video, sample: VideoSample, option: str, overrides: Overrides, analyzer: Analyzer
) -> CameraChoice:
    """Choose the camera of a video: that of the input, or as `--camera` says.

    Args:
        video: as decoded.
        sample: labels and camera of the video.
        option: value of `--camera`.
        overrides: stages of the grounding that are replaced; poses need no camera to be found.
        analyzer: checks and estimates cameras.

    Raises:
        UnmeasurableError: the video is too small or too short.
    """
    video.require_measurable()
    if not is_assumed(sample, option) or overrides.poses is not None:
        return CameraChoice(sample=sample)
    try:
        framing = find_video_framing(sample, video)
    except UnmeasurableError:
        return choose_camera(sample, video.frames, None, analyzer)
    return choose_camera(sample, video.frames, (framing.crop(video.frames), framing.camera(sample.camera)), analyzer)


def ground_prepared(
    video: PreparedVideo,
    analyzer: Analyzer,
    gripper: GripperKind = GripperKind.AUTO,
    *,
    measured: "GroundingResult | None" = None,
) -> "GroundingResult":
    """Track the hand through a prepared video, or the flange.

    Automatically the flange is measured where the hand is found in next to no frame, and the flange in most: by the
    links alone, else with the contours of a Robotiq 2F-85.

    Args:
        video: the video.
        analyzer: grounds.
        gripper: gripper of the video.
        measured: track of the gripper, if it is measured already.

    Raises:
        InputError: the priors do not fit the video.
        UnmeasurableError: the gripper was found in too few frames.
        SetupError: weights or libraries are missing.
    """
    inputs = video.frames, video.camera, video.t_s, video.priors
    measures_hand = gripper in (GripperKind.FRANKA, GripperKind.AUTO)
    grounding = measured or (analyzer.ground(*inputs) if measures_hand else analyzer.ground_arm(*inputs, gripper))
    tracked = int(grounding.track.tracked.sum())
    if gripper is GripperKind.AUTO and tracked < max(MIN_TRACKED, HAND_SHARE * len(video.t_s)):
        for other in (GripperKind.NONE, GripperKind.ROBOTIQ_2F85):
            arm = analyzer.ground_arm(*inputs, other)
            if arm.track.tracked.mean() >= ARM_SHARE:
                return arm
            if _is_empty(arm):  # contours of a gripper are sought where there is an arm
                break
    if tracked < MIN_TRACKED:
        share = f"in {tracked} of {len(video.t_s)} frames, a path needs {MIN_TRACKED}"
        if not measures_hand:
            raise UnmeasurableError(
                f"the flange was tracked {share}: its confidence is {grounding.track.confidence.max():.2f} at most; "
                "are wrist and forearm in view, and is this the video's camera?"
            )
        raise UnmeasurableError(
            f"the gripper was found {share}: is the robot in view, and is this the video's camera?"
            + (" With another gripper than Franka's take --gripper none." if gripper is GripperKind.FRANKA else "")
        )
    return grounding


def _ground_as_assumed(video: PreparedVideo, analyzer: Analyzer) -> "tuple[GroundingResult, float]":
    """Track the gripper with the benchmark camera; return also how well the arm confirms that camera, 0 to 1.

    Where edges contradict the camera poses are not refined, since another one is likely.
    """
    priors = replace(video.priors, camera_is_assumed=True)
    grounding = analyzer.ground(video.frames, video.camera, video.t_s, priors)
    if grounding.domain is not Domain.FAMILIAR or grounding.camera_path is not None:
        return grounding, 0.0
    return grounding, track_agreement(video.frames, video.camera, grounding, analyzer) or 0.0


def _is_complete(grounding: "GroundingResult") -> bool:
    """Return whether a track with an assumed camera is the same as with a certain one: refined, or there is nothing."""
    return grounding.domain is Domain.FAMILIAR or _is_empty(grounding)


def _is_empty(grounding: "GroundingResult") -> bool:
    """Return whether no frame has a pose."""
    return not grounding.track.confidence.any()
