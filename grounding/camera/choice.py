"""Choice of the camera of one video: which are tried, in which order, and what is reported if none is confirmed."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

from kinebench_drake.camera import CONFIRMED, Camera, CameraSource, benchmark_camera
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.camera.camera_estimate import CameraEstimate
from kinebench_drake.grounding.camera.check import check_named, find_reading
from kinebench_drake.grounding.camera.estimate import usual_camera
from kinebench_drake.grounding.camera.evidence import BASE_UNKNOWN, BetterReading, CameraChoice, PictureReading
from kinebench_drake.grounding.camera.framing import FIRST_FRAME_ADVICE, Framing, apply_framing, find_framing
from kinebench_drake.grounding.camera.lens import pixel_shapes
from kinebench_drake.grounding.camera.recognition import Recognition
from kinebench_drake.grounding.camera.watch import CameraWatch
from kinebench_drake.grounding.components import GroundingComponents
from kinebench_drake.grounding.pipeline import PipelineResult
from kinebench_drake.grounding.priors import Clip, Priors
from kinebench_drake.grounding.video_result import GroundingResult
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.progress import count_steps, tell
from kinebench_drake.models.panda.description import GripperKind
from kinebench_drake.named_cameras import BENCHMARK
from kinebench_drake.segments import evenly
from kinebench_drake.track import Domain, GripperTrack

_HAND_SHARE = 0.1
"""Least share of the frames in which a hand counts as seen."""
_TRACKED_SHARE = 0.5
"""Least share of the frames with a tracked flange, of an arm that is measured without its gripper's name."""
_SURE_SHARE = 0.9
"""Share of the frames with a tracked hand from which on no other gripper is looked for."""
_COMPARED_FRAMES = 8
"""Frames in which two networks are compared."""
_SIGMAS = 2.0
"""Standard deviations of an estimated camera that its poses may be off by."""
_STRETCH = (0.04, 0.15)
"""Range of |fy / fx - 1| of a picture that is tried as stretched: of 16:9 to 3:2 and to 5:3, not to 832x480, where it
hardly matters and the second estimate would cost as much time as the first."""
_MOST_RIVALS = 3
"""Cameras beside the estimated one under which a track is judged: each is another grounding."""
PriorSource = Callable[[Camera], Priors]
"""Function from the camera of the whole frames to quantities that replace estimates."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _View:
    """A clip with a camera that comes into question."""

    choice: CameraChoice
    frames: Frames
    camera: Camera
    framing: Framing
    t_s: Array
    table_height_m: float
    priors: Priors

    def result(
        self,
        measured: PipelineResult,
        choice: CameraChoice | None = None,
        possible: tuple[GripperTrack, ...] = (),
    ) -> GroundingResult:
        """Return the result of a track, with this choice or another one, and the `possible` tracks of the clip."""
        return GroundingResult(
            measured=measured,
            frames=self.frames,
            camera=self.camera,
            framing=self.framing,
            choice=choice or self.choice,
            table_height_m=self.table_height_m,
            possible=possible,
        )


@dataclass(frozen=True, slots=True)
class CameraChooser:
    """Grounding of one video with the cameras that come into question."""

    parts: GroundingComponents
    clip: Clip
    priors: PriorSource | Priors
    gripper: GripperKind
    table_height_m: float
    """Height of the table top in the robot base frame where none is stated with the camera [m]."""
    stride: int = 1
    """Every how many frames are measured in full."""
    watch: CameraWatch | None = None
    """Spot checks of the named camera; None: every clip is checked."""

    def ground_trusted(self, choice: CameraChoice) -> GroundingResult:
        """Ground with a camera that is taken as exact."""
        view = self._view(choice)
        return view.result(self._ground(view))

    def ground_named(self, choice: CameraChoice) -> GroundingResult:
        """Ground with the named camera, and check it."""
        view = self._view(choice)
        hand = self._ground(view)
        if self.watch is not None and not self.watch.is_due(hand):
            return view.result(hand)
        result = self._checked(view, hand)
        if self.watch is not None:
            self.watch.note(passed=result.choice.reason is None)
        # Where another reading explains the hand, the arm alone would agree with the wrong one, too.
        if result.choice.better_reading is not None or not (self._is_lost(hand) or self._may_be_robotiq(view, hand)):
            return result
        other = self._ground_other(view)
        if other is None or other.track.tracked.sum() <= hand.track.tracked.sum():
            return result
        return self._checked(view, other)

    def ground_unnamed(self) -> GroundingResult:
        """Ground with a camera known by name if the arm confirms it, else with an estimated one, else without any.

        The benchmark camera is tried by the track itself, before any other is looked for.
        """
        benchmark = CameraChoice(camera=benchmark_camera(), source=CameraSource.BENCHMARK)
        usual = usual_camera(self.clip.frames.shape[2], self.clip.frames.shape[1])
        view: _View | None = None
        assumed: GroundingResult | None = None
        with suppress(UnmeasurableError):  # the shape of the video is not that of the benchmark camera's image
            view = self._view(benchmark)
        if self.gripper in (GripperKind.NONE, GripperKind.ROBOTIQ_2F85):
            return self._ground_unnamed_other(view, usual)
        if view is not None:
            assumed = self._ground_as_assumed(view)
            if assumed.choice.reason is None or assumed.choice.better_reading is not None:
                return assumed
        tell("the benchmark camera is not confirmed: comparing with the cameras known by name")
        recognition = self.parts.recognize(self.clip.frames if view is None else view.frames)
        if recognition is not None and recognition.is_usual:
            return self._ground_recognized(recognition)
        if assumed is not None and view is not None:
            reading = None if recognition is None else recognition.as_better_reading(assumed.choice.agreement or 0.0)
            least = max(CONFIRMED, assumed.choice.agreement or 0.0)
            reading = reading or self.parts.checker.find_reading(
                view.frames, view.camera, least, (PictureReading.CROPPED,)
            )
            if reading is not None:
                return view.result(assumed.measured, _misread(assumed.choice, reading))
        tell("no camera is known: looking for a hand whatever the camera")
        hands, searched = self.parts.checker.count_hands(self.clip.frames, usual)
        if not hands and view is not None and (arm := self._confirmed_other(view)) is not None:
            return arm
        if not hands and self.gripper is GripperKind.AUTO:
            other = replace(self, gripper=GripperKind.ROBOTIQ_2F85)._ground_unnamed_other(None, usual)
            if other.measured.track.tracked.mean() >= _TRACKED_SHARE:
                return other
        if not hands:
            raise UnmeasurableError(
                f"no Franka hand is found in any of {searched} frames searched, whatever the camera; is the robot in "
                "view? With another gripper than Franka's or a Robotiq 2F-85 name the camera (camera.json)"
                f"{self._advice}"
            )
        against = None if assumed is None else assumed.choice.reason
        return self._ground_estimated(usual, against or "the arm confirms none that is known by name")

    def _ground_unnamed_other(self, view: _View | None, usual: Camera) -> GroundingResult:
        """Ground a gripper that is not Franka's with the benchmark camera of `view` if the arm confirms it.

        Else with one that is estimated, if the shape of the gripper is known.
        """
        confirmed = None if view is None else self._confirmed_other(view)
        if confirmed is not None:
            return confirmed
        against = "the arm does not confirm the benchmark camera"
        if self.gripper is GripperKind.NONE:
            raise UnmeasurableError(
                f"no camera is named, and {against}; by an arm whose gripper is unknown none is estimated: name it "
                "(camera.json)"
            )
        return self._ground_estimated(usual, against)

    def _ground_recognized(self, recognition: Recognition) -> GroundingResult:
        """Ground with a camera that is recognized; without a base frame unless the arm of the track confirms it."""
        named = recognition.named
        source = CameraSource.BENCHMARK if named.name == BENCHMARK else CameraSource.RECOGNIZED
        view = self._view(
            CameraChoice(
                camera=recognition.camera,
                source=source,
                table_height_m=named.setting.table_height_m,
                named=named,
                applied_reading=recognition.reading,
            )
        )
        measured = self._ground(view)
        agreement = self.parts.checker.track_agreement(view.frames, view.camera, measured)
        reason = None
        if agreement is None or agreement < bounds.AGREEMENT:
            reason = f"{BASE_UNKNOWN}: the track does not confirm the camera {named.name} ({_share(agreement)})"
        return view.result(measured, replace(view.choice, agreement=agreement, reason=reason))

    def _ground_estimated(self, usual: Camera, against: str) -> GroundingResult:
        """Ground with a camera estimated from the arm; without a base frame unless it is determined and confirmed.

        Without an estimate the camera is the `usual` one; `against` says what speaks against those known by name.
        """
        estimate: CameraEstimate | None = None
        tell(f"estimating the camera from the arm, which takes minutes{self._advice}")
        try:
            estimate = self._estimate(usual)
            doubt = estimate.misfit
        except UnmeasurableError as error:
            doubt = str(error)
        source = CameraSource.NONE if estimate is None else CameraSource.ESTIMATED
        choice = CameraChoice(camera=usual if estimate is None else estimate.camera, source=source, estimate=estimate)
        view = self._view(choice)
        tell("tracking with the estimated camera")
        measured = self._ground(view)
        agreement = self.parts.checker.track_agreement(view.frames, view.camera, measured)
        reading = None
        if doubt is None:
            reading = find_reading(view.frames, view.camera, agreement, self.parts.checker)
            if reading is not None:
                doubt = reading.describe()
            elif agreement is None or agreement < bounds.AGREEMENT:
                doubt = f"the track does not confirm the estimated camera ({_share(agreement)})"
        possible: tuple[GripperTrack, ...] = ()
        if doubt is None and estimate is not None:
            measured = _with_offset(measured, estimate)
            doubt = estimate.ambiguity
            if doubt is not None and len(estimate.rivals) <= _MOST_RIVALS:
                rivals = [
                    self._ground_rival(choice, rival, estimate)
                    for rival in count_steps(estimate.rivals, "other possible cameras tried", len(estimate.rivals))
                ]
                # One that is not confirmed may still be the right one, not fitted well: then nothing is agreed on.
                tracks = tuple(track for track in rivals if track is not None)
                possible = (measured.track, *tracks) if len(tracks) == len(rivals) else ()
        source = CameraSource.ESTIMATED if doubt is None else CameraSource.NONE
        reason = None if doubt is None else f"{BASE_UNKNOWN}: no camera is named, {against}, and {doubt}"
        choice = replace(choice, source=source, agreement=agreement, better_reading=reading, reason=reason)
        return view.result(measured, choice, possible)

    def _estimate(self, usual: Camera) -> CameraEstimate:
        """Return the estimated camera; of a picture that may have been stretched, that of the better shape of a pixel.

        Raises:
            UnmeasurableError: hand and arm are seen in too few frames.
        """
        estimator = self.parts.of(self._tracked).cameras
        least, most = _STRETCH
        ratios = pixel_shapes(usual.width, usual.height)
        shapes = [ratio for ratio in ratios if ratio == 1.0 or least <= abs(ratio - 1.0) <= most]
        cameras = [replace(usual, fy=usual.fx * ratio) for ratio in shapes]
        estimates = [estimator.estimate(self.clip.frames, camera) for camera in cameras]
        return max(estimates, key=lambda estimate: estimate.support)

    def _ground_rival(self, choice: CameraChoice, camera: Camera, estimate: CameraEstimate) -> GripperTrack | None:
        """Return the track with a camera that may be right instead of the estimate; None if it is not confirmed."""
        view = self._view(replace(choice, camera=camera))
        measured = self._ground(view)
        agreement = self.parts.checker.track_agreement(view.frames, view.camera, measured)
        return None if agreement is None or agreement < bounds.AGREEMENT else _with_offset(measured, estimate).track

    def _ground_as_assumed(self, view: _View) -> GroundingResult:
        """Track with the benchmark camera; without a base frame unless the arm of a familiar look confirms the camera.

        Where edges contradict the camera poses are not refined, since another one is likely.
        """
        measured = self._ground(replace(view, priors=replace(view.priors, camera_is_assumed=True)))
        agreement = self.parts.checker.track_agreement(view.frames, view.camera, measured)
        choice = replace(view.choice, agreement=agreement)
        if measured.domain is not Domain.FAMILIAR or agreement is None or agreement < CONFIRMED:
            bound = f"at least {CONFIRMED:.0%} are needed"
            reason = f"the arm does not confirm the benchmark camera ({_share(agreement)}, {bound})"
            return view.result(measured, replace(choice, reason=reason))
        reading = find_reading(view.frames, view.camera, agreement, self.parts.checker)
        return view.result(measured, choice if reading is None else _misread(choice, reading))

    def _confirmed_other(self, view: _View) -> GroundingResult | None:
        """Track another gripper with the benchmark camera; None if its arm does not confirm the camera."""
        if self.gripper is GripperKind.FRANKA:
            return None
        measured = self._ground_other(view) if self.gripper is GripperKind.AUTO else self._ground(view)
        if measured is None:
            return None
        agreement = self.parts.checker.track_agreement(view.frames, view.camera, measured)
        is_confirmed = agreement is not None and agreement >= CONFIRMED
        return view.result(measured, replace(view.choice, agreement=agreement)) if is_confirmed else None

    @property
    def _advice(self) -> str:
        """What to do if no camera is found, as the end of a sentence; empty for a clip with its conditioning image."""
        return "" if self.clip.conditioning is not None else f"; {FIRST_FRAME_ADVICE}"

    @property
    def _tracked(self) -> GripperKind:
        """Gripper that is tracked first."""
        return GripperKind.FRANKA if self.gripper is GripperKind.AUTO else self.gripper

    def _is_lost(self, hand: PipelineResult) -> bool:
        """Return whether a hand is tracked in so few frames that it may be another gripper."""
        least = max(bounds.MIN_TRACKED, _HAND_SHARE * len(hand.track.t_s))
        return self.gripper is GripperKind.AUTO and int(hand.track.tracked.sum()) < least

    def _may_be_robotiq(self, view: _View, hand: PipelineResult) -> bool:
        """Return whether a hand of unfamiliar look, not tracked throughout, may be a Robotiq 2F-85.

        That is if the network for it sees more of a gripper in whole images.
        """
        is_sure = hand.domain is Domain.FAMILIAR or hand.track.tracked.mean() >= _SURE_SHARE
        if self.gripper is not GripperKind.AUTO or is_sure:
            return False
        chosen = evenly(len(view.frames), _COMPARED_FRAMES).tolist()
        crops = {i: hand.wide[i].crop for i in chosen}
        network = self.parts.of(GripperKind.ROBOTIQ_2F85).estimator
        camera = view.camera.resized(view.frames.shape[2], view.frames.shape[1])
        robotiq = sum(int(own.gripper.sum()) for _, own in network.estimate(view.frames, camera, crops))
        return robotiq > sum(int(hand.wide[i].gripper.sum()) for i in chosen)

    def _view(self, choice: CameraChoice) -> _View:
        """Return the clip as a camera shows it.

        Raises:
            UnmeasurableError: the shape of the video differs from that of the camera's image, and nothing explains it.
        """
        camera = choice.camera
        turn = choice.applied_reading
        clip = self.clip.flipped(rows=turn is PictureReading.ROWS_REVERSED, columns=turn is PictureReading.MIRRORED)
        framing = find_framing(clip.frames, camera, clip.conditioning, choice.source)
        priors = self.priors
        if not isinstance(priors, Priors):
            priors = priors(framing.whole_camera(camera))
        height_m = self.table_height_m if choice.table_height_m is None else choice.table_height_m
        priors = replace(
            priors.crop(*framing.window),
            camera_is_fitted=choice.source in (CameraSource.ESTIMATED, CameraSource.NONE),
            table_height_m=height_m,
        )
        if turn is not None and priors.replaces_stage:
            raise UnmeasurableError(
                f"the pictures are {turn.value.replace('_', ' ')}, as those of the camera are published, but masks, "
                "depth or poses are of the frames as they are: turn all of them first"
            )
        if clip.is_view and clip.conditioning is not None:
            priors = replace(priors, image=apply_framing(framing, clip.conditioning))
        return _View(
            choice=choice,
            frames=framing.crop(clip.frames),
            camera=framing.camera(camera),
            framing=framing,
            t_s=clip.t_s,
            table_height_m=height_m,
            priors=priors,
        )

    def _checked(self, view: _View, measured: PipelineResult) -> GroundingResult:
        """Return the result of a track with the named camera, checked by it."""
        return view.result(measured, check_named(view.choice, view.frames, view.camera, measured, self.parts.checker))

    def _ground(self, view: _View, gripper: GripperKind | None = None) -> PipelineResult:
        """Track a gripper, by default the first one."""
        pipeline = self.parts.of(gripper or self._tracked).pipeline
        return pipeline.ground(view.frames, view.camera, view.t_s, view.priors, self.stride)

    def _ground_other(self, view: _View) -> PipelineResult | None:
        """Track a Robotiq 2F-85, else the flange by the links alone; None if neither is seen."""
        for gripper in (GripperKind.ROBOTIQ_2F85, GripperKind.NONE):
            other = self._ground(view, gripper)
            if other.track.tracked.mean() >= _TRACKED_SHARE:
                return other
        return None


def _with_offset(measured: PipelineResult, estimate: CameraEstimate) -> PipelineResult:
    """Return a result whose track allows for the error of its camera, which all poses in the base frame share."""
    track = measured.track
    offset_m = track.offset_m + _SIGMAS * estimate.gripper_sigma_m
    offset_rad = track.offset_rad + _SIGMAS * estimate.gripper_sigma_rad
    return replace(measured, track=replace(track, offset_m=offset_m, offset_rad=offset_rad))


def _misread(choice: CameraChoice, reading: BetterReading) -> CameraChoice:
    """Return the choice of the benchmark camera for a picture that has to be read in another way."""
    described = reading.describe()
    reason = f"{BASE_UNKNOWN}: no camera is named, and with the benchmark camera {described}"
    return replace(choice, better_reading=reading, reason=reason)


def _share(agreement: float | None) -> str:
    return "no posture fits" if agreement is None else f"{agreement:.0%} of the arm's contours on image edges"
