"""Evidence for a video's camera: how well the arm of the reported track agrees with it, and what agrees better."""

from dataclasses import dataclass, replace

from kinebench_drake.camera import CONFIRMED, Camera, CameraSource, CameraState
from kinebench_drake.errors import name_options
from kinebench_drake.formats.camerafile import NamedCamera
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.camera.camera_estimate import CameraEstimate
from kinebench_drake.grounding.camera.check import CameraChecker, CameraContradiction
from kinebench_drake.grounding.camera.picture_reading import BetterReading, PictureReading
from kinebench_drake.grounding.pipeline import PipelineResult
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.jsonl import Json
from kinebench_drake.track import Domain

_LIKELY = (PictureReading.MIRRORED, PictureReading.CROPPED)


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraChoice:
    """Camera of a video, and the evidence for it."""

    camera: Camera
    """Camera before it is fitted to the shape of the video; without a base frame only its lens counts."""
    source: CameraSource
    agreement: float | None = None
    """Share of the contours of hand and arm on image edges in the postures of the track; None if none was fitted."""
    table_height_m: float | None = None
    """Height of the table top in the robot base frame that is stated with the camera [m]; None if none is."""
    named: NamedCamera | None = None
    """Camera by name, where the arm is to confirm it."""
    shown: PictureReading | None = None
    """How its picture is turned before it is measured; None: not at all."""
    estimate: CameraEstimate | None = None
    """Estimated camera; None if none was estimated."""
    contradiction: CameraContradiction | None = None
    """Camera that explains the arm better than the named one; None if none was found."""
    reading: BetterReading | None = None
    """PictureReading of picture or matrix that explains the arm better; None if none was found."""
    reason: str | None = None
    """Why there is no base frame; None if there is one."""

    @property
    def state(self) -> CameraState:
        """How the camera is known."""
        if self.reason is not None:
            return CameraState.NONE
        if self.source.is_named:
            return CameraState.NAMED
        return CameraState.ESTIMATED if self.source is CameraSource.ESTIMATED else CameraState.CONFIRMED

    def to_json(self) -> dict[str, Json]:
        """Serialize into keys of the row."""
        source = self.source if self.source.is_named or self.reason is None else CameraSource.NONE
        data: dict[str, Json] = {"camera_source": source.value, "camera_state": self.state.value}
        if self.named is not None:
            data["camera_name"] = self.named.name
        if self.shown is not None:
            data["camera_shown"] = self.shown.value
        if self.agreement is not None:
            data["camera_agreement"] = round(self.agreement, 4)
        for key, part in (
            ("camera_estimate", self.estimate),
            ("camera_contradiction", self.contradiction),
            ("camera_reading", self.reading),
        ):
            if part is not None:
                data[key] = part.to_json()
        if self.reason is not None:
            data["base_frame_reason"] = name_options(self.reason)
        return data


def find_reading(
    frames: Frames, camera: Camera, agreement: float | None, checker: CameraChecker
) -> BetterReading | None:
    """Return a reading of picture or matrix that agrees clearly better than the track does; None if there is none.

    Where the arm confirms the camera only those are tried that a camera in the plane of symmetry, or a narrow margin,
    hides. `agreement` is that of the track with `camera` in frames (T, H, W, 3); None if it has no posture.
    """
    if agreement is not None and agreement >= bounds.SURE_AGREEMENT:
        return None
    confirmed = agreement is not None and agreement >= CONFIRMED
    readings = _LIKELY if confirmed else tuple(PictureReading)
    return checker.find_reading(frames, camera, max(CONFIRMED, agreement or 0.0), readings)


def check_named(
    choice: CameraChoice, frames: Frames, camera: Camera, result: PipelineResult, checker: CameraChecker
) -> CameraChoice:
    """Check a named camera, and the track with it in frames (T, H, W, 3), against the arm.

    If the contours of hand and arm, in the postures of the track, lie on edges of the image, the camera stays, unless
    the mirrored picture agrees clearly better. Otherwise other readings and other cameras are tried. One that explains
    the arm clearly better and puts the gripper elsewhere leaves the base frame unknown, and so does a low agreement.
    """
    agreement = checker.track_agreement(frames, camera, result)
    choice = replace(choice, agreement=agreement)
    if result.camera_path is not None:  # other readings and cameras are sought in pictures of one camera alone
        return choice if agreement is None else replace(choice, reason=_explain_disagreement(agreement, result))
    reading = find_reading(frames, camera, agreement, checker)
    if reading is not None:
        return replace(choice, reading=reading, reason=f"the base frame is unknown: {reading.describe()}")
    if agreement is not None and agreement >= CONFIRMED:
        return choice
    other = None if result.domain is Domain.ARM else checker.find_contradiction(frames, camera)
    reason = None
    if other is not None and other.is_large:
        reason = f"the base frame is unknown: {other.describe()}"
    elif other is None:
        reason = _explain_disagreement(agreement, result)
    return replace(choice, contradiction=other, reason=reason)


def _explain_disagreement(agreement: float | None, result: PipelineResult) -> str | None:
    """Return why a camera that no other explains better gives no base frame; None if it does."""
    if agreement is None:
        if result.arm_consistency_px is None or not result.has_pose.any():  # nothing could agree or disagree
            return None
        return (
            "the base frame is unknown: the arm contradicts the camera of the input: it is seen, but agrees with the "
            "hand in no tracked frame"
        )
    if agreement >= bounds.AGREEMENT:
        return None
    return (
        f"the base frame is unknown: the arm contradicts the camera of the input: {agreement:.0%} of its contours lie "
        f"on image edges, at least {bounds.AGREEMENT:.0%} are needed"
    )
