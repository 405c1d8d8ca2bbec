"""Grounding of a video: choose its camera, track the gripper or the flange, confirm the camera by the arm."""

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.formats.videos.sample import CameraSource, VideoSample
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.overrides.overrides import Overrides
from kinebench_drake.io.video import Video
from kinebench_drake.runs.analyzer import Analyzer
from kinebench_drake.runs.camera import (
    AGREEMENT,
    CONFIRMED,
    CameraChoice,
    check_named,
    find_reading,
    track_agreement,
    usual_camera,
)
from kinebench_drake.runs.evaluator import MIN_TRACKED
from kinebench_drake.runs.preparation import PreparedVideo, prepare_video
from kinebench_drake.types import Domain, GripperKind, GripperTrack, Priors

if TYPE_CHECKING:  # torch and Open3D take seconds to load
    from kinebench_drake.grounding.camera.camera_estimate import CameraEstimate
    from kinebench_drake.grounding.pipeline import GroundingResult

HAND_SHARE, ARM_SHARE = 0.1, 0.5
"""Share of tracked frames below which a hand counts as not seen, and from which on an arm does."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundedVideo:
    """Track of a video with the camera behind it."""

    choice: CameraChoice
    prepared: PreparedVideo
    grounding: "GroundingResult"

    @property
    def track(self) -> GripperTrack:
        """The track; of an unmeasurable video with the poses that are seen, but not trusted."""
        track = self.choice.without_base(self.grounding.track)
        if self.unmeasurable is None:
            return track
        return replace(track, X_CH=np.where(track.tracked[:, None, None], track.X_CH, self.grounding.X_CH_raw))

    @property
    def unmeasurable(self) -> str | None:
        """Why the track cannot be measured although a gripper is seen; None if it can."""
        track, tracked = self.grounding.track, int(self.grounding.track.tracked.sum())
        if tracked >= MIN_TRACKED:
            return None
        flange, count = self.grounding.domain is Domain.ARM, int(self.grounding.has_pose.sum())
        reason = "" if self.choice.reason is None else f"; {self.choice.reason}"
        return (
            f"{'the flange' if flange else 'a gripper'} is seen in {count} of {len(track.t_s)} frames, but trusted in "
            f"{tracked}, a path needs {MIN_TRACKED}: its confidence is {track.confidence.max():.2f} at most{reason}"
        )

    def require_pose(self) -> None:
        """Check that a gripper is seen.

        Raises:
            UnmeasurableError: it is found in no frame.
        """
        if self.grounding.has_pose.any():
            return
        frames = len(self.grounding.track.t_s)
        reason = "" if self.choice.reason is None else f"; {self.choice.reason}"
        if self.grounding.domain is Domain.ARM:
            raise UnmeasurableError(
                f"the flange is found in none of {frames} frames: are wrist and forearm in view, and is this the "
                f"video's camera?{reason}"
            )
        raise UnmeasurableError(
            f"no Franka hand is found in any of {frames} frames: is the robot in view, and is this the video's camera? "
            f"With another gripper take --gripper none{reason}"
        )


class VideoGrounder:
    """Grounding of one video with the cameras that come into question."""

    def __init__(
        self,
        video: Video,
        sample: VideoSample,
        overrides: Overrides,
        analyzer: Analyzer,
        period_s: float | None = None,
        gripper: GripperKind = GripperKind.AUTO,
        *,
        duration_s: float | None = None,
    ) -> None:
        """Set the input; see `ground_with_camera`."""
        self._video, self._sample, self._overrides, self._analyzer = video, sample, overrides, analyzer
        self._period_s, self._duration_s, self._gripper = period_s, duration_s, gripper

    def ground_named(self) -> GroundedVideo:
        """Ground with the named camera, and check it."""
        prepared = self._prepare(self._sample)
        if self._overrides.poses is not None:
            grounding = self._analyzer.ground(*_inputs(prepared))
            return GroundedVideo(choice=CameraChoice(sample=self._sample), prepared=prepared, grounding=grounding)
        hand = None if self._seeks_other else self._analyzer.ground(*_inputs(prepared))
        if hand is not None:
            choice = self._check(prepared, hand)
            if choice.reading is not None:  # then the arm alone would agree with the wrong reading, too
                return GroundedVideo(choice=choice, prepared=prepared, grounding=hand)
            if not self._is_lost(hand):
                return GroundedVideo(choice=choice, prepared=prepared, grounding=hand)
        arm = self._ground_arm(prepared)
        if arm is not None:
            return GroundedVideo(choice=self._check(prepared, arm), prepared=prepared, grounding=arm)
        assert hand is not None  # without a hand to measure there is an arm
        return GroundedVideo(choice=choice, prepared=prepared, grounding=hand)

    def ground_unnamed(self) -> GroundedVideo:
        """Ground with the benchmark camera if the arm confirms it, else with an estimated one, else without any."""
        if self._seeks_other:
            arm = self._confirmed_arm(self._prepare(self._sample))
            if arm is None:
                raise UnmeasurableError(
                    "no camera is named, and the arm does not confirm the benchmark camera; with another gripper than "
                    "Franka's no camera is estimated: name it (camera.json)"
                )
            return arm
        assumed: GroundedVideo | None = None
        with suppress(UnmeasurableError):  # the shape of the video is not that of the benchmark camera's image
            assumed = self._ground_as_assumed()
        if assumed is not None and (assumed.choice.reason is None or assumed.choice.reading is not None):
            return assumed
        against = (
            "no camera is named, and the shape of the video is not that of the benchmark camera"
            if assumed is None
            else f"no camera is named, and {_contradiction_of_benchmark(assumed.choice.agreement)}"
        )
        hands, searched = self._analyzer.count_hands(self._video.frames)
        if not hands and assumed is not None and (arm := self._confirmed_arm(assumed.prepared)) is not None:
            return arm
        if not hands:
            raise UnmeasurableError(
                f"no Franka hand is found in any of {searched} frames searched, whatever the camera; is the robot in "
                "view? With another gripper name the camera (camera.json)"
            )
        estimate: CameraEstimate | None = None
        try:
            estimate = self._analyzer.estimate_camera(self._video.frames)
            doubt = estimate.doubt
        except UnmeasurableError as error:
            doubt = str(error)
        camera = usual_camera(self._video.frames) if estimate is None else estimate.camera
        source = CameraSource.ESTIMATED if doubt is None else CameraSource.NONE
        sample = replace(self._sample, camera=camera, camera_source=source)
        prepared = self._prepare(sample)
        grounding = self._analyzer.ground(*_inputs(prepared))
        agreement = track_agreement(prepared.frames, prepared.camera, grounding, self._analyzer)
        reading = None
        if doubt is None:
            reading = find_reading(prepared.frames, prepared.camera, agreement, self._analyzer)
            if reading is not None:
                doubt = reading.describe()
            elif agreement is None or agreement < AGREEMENT:
                doubt = f"the track does not confirm the estimated camera ({_share(agreement)})"
        choice = CameraChoice(
            sample=sample,
            agreement=agreement,
            estimate=estimate,
            reading=reading,
            reason=None if doubt is None else f"the base frame is unknown: {against}, and {doubt}",
        )
        return GroundedVideo(choice=choice, prepared=prepared, grounding=grounding)

    @property
    def _seeks_other(self) -> bool:
        """Whether another gripper than Franka's is sought from the start."""
        return self._gripper in (GripperKind.NONE, GripperKind.ROBOTIQ_2F85)

    def _prepare(self, sample: VideoSample) -> PreparedVideo:
        return prepare_video(self._video, sample, self._period_s, self._overrides, duration_s=self._duration_s)

    def _check(self, prepared: PreparedVideo, grounding: "GroundingResult") -> CameraChoice:
        return check_named(self._sample, prepared.frames, prepared.camera, grounding, self._analyzer)

    def _is_lost(self, hand: "GroundingResult") -> bool:
        """Return whether a hand is tracked in so few frames that it may be another gripper."""
        least = max(MIN_TRACKED, HAND_SHARE * len(hand.track.t_s))
        return self._gripper is GripperKind.AUTO and int(hand.track.tracked.sum()) < least

    def _ground_arm(self, prepared: PreparedVideo) -> "GroundingResult | None":
        """Track the flange: by the links alone, else with the contours of a Robotiq 2F-85; None if it is not seen.

        A gripper that is named is measured in any case.
        """
        if self._seeks_other:
            return self._analyzer.ground_arm(*_inputs(prepared), self._gripper)
        for gripper in (GripperKind.NONE, GripperKind.ROBOTIQ_2F85):
            arm = self._analyzer.ground_arm(*_inputs(prepared), gripper)
            if arm.track.tracked.mean() >= ARM_SHARE:
                return arm
            if not arm.track.confidence.any():  # contours of a gripper are sought where there is an arm
                break
        return None

    def _ground_as_assumed(self) -> GroundedVideo:
        """Track with the benchmark camera; without a base frame unless the arm confirms the camera.

        Where edges contradict the camera poses are not refined, since another one is likely.
        """
        prepared = self._prepare(self._sample)
        frames, camera = prepared.frames, prepared.camera
        priors = replace(prepared.priors, camera_is_assumed=True)
        grounding = self._analyzer.ground(frames, camera, prepared.t_s, priors)
        agreement = track_agreement(frames, camera, grounding, self._analyzer)
        if grounding.domain is not Domain.FAMILIAR:
            agreement = self._analyzer.camera_agreement(frames, camera)
            if agreement is not None and agreement >= CONFIRMED:
                grounding = self._analyzer.ground(*_inputs(prepared))
                agreement = track_agreement(frames, camera, grounding, self._analyzer)
        reading = find_reading(frames, camera, agreement, self._analyzer)
        reason = None
        if reading is not None:
            reason = (
                f"the base frame is unknown: no camera is named, and with the benchmark camera {reading.describe()}"
            )
        elif agreement is None or agreement < CONFIRMED:
            reason = _contradiction_of_benchmark(agreement)
        choice = CameraChoice(sample=self._sample, agreement=agreement, reading=reading, reason=reason)
        return GroundedVideo(choice=choice, prepared=prepared, grounding=grounding)

    def _confirmed_arm(self, prepared: PreparedVideo) -> GroundedVideo | None:
        """Track the flange with the benchmark camera; None if its arm does not confirm the camera."""
        if self._gripper is GripperKind.FRANKA:
            return None
        arm = self._ground_arm(prepared)
        if arm is None:
            return None
        agreement = track_agreement(prepared.frames, prepared.camera, arm, self._analyzer)
        if agreement is None or agreement < CONFIRMED:
            return None
        choice = CameraChoice(sample=self._sample, agreement=agreement)
        return GroundedVideo(choice=choice, prepared=prepared, grounding=arm)


def ground_with_camera(
    video: Video,
    sample: VideoSample,
    overrides: Overrides,
    analyzer: Analyzer,
    period_s: float | None = None,
    gripper: GripperKind = GripperKind.AUTO,
    *,
    duration_s: float | None = None,
) -> GroundedVideo:
    """Choose the camera of a video, ground the video, and confirm the camera by the arm of the track.

    Base-frame poses exist only where the camera is named and not contradicted, or confirmed.

    Args:
        video: as decoded.
        sample: labels and camera of the video.
        overrides: stages of the grounding that are replaced; poses leave a camera unchecked.
        analyzer: checks and estimates cameras, grounds.
        period_s: task time between two frames [s]; None: the video's own.
        gripper: value of `--gripper`.
        duration_s: task time over which the frames lie evenly [s]; None: they are one period apart.

    Raises:
        InputError: an override does not fit the video.
        UnmeasurableError: the video is too small or too short, or shows no gripper.
        SetupError: weights or libraries are missing.
    """
    video.require_measurable()
    if sample.mirrored:
        video = replace(video, frames=np.ascontiguousarray(video.frames[:, :, ::-1]))
    grounder = VideoGrounder(video, sample, overrides, analyzer, period_s, gripper, duration_s=duration_s)
    is_settled = sample.camera_source.is_named or overrides.poses is not None
    grounded = grounder.ground_named() if is_settled else grounder.ground_unnamed()
    grounded.require_pose()
    return grounded


def _inputs(prepared: PreparedVideo) -> tuple[NDArray[np.uint8], Camera, Array, Priors]:
    return prepared.frames, prepared.camera, prepared.t_s, prepared.priors


def _share(agreement: float | None) -> str:
    return "no posture fits" if agreement is None else f"{agreement:.0%} of the arm's contours on image edges"


def _contradiction_of_benchmark(agreement: float | None) -> str:
    return f"the arm does not confirm the benchmark camera ({_share(agreement)}, at least {CONFIRMED:.0%} are needed)"
