"""Evidence for a video's camera: how well the arm of the reported track agrees with it, and what agrees better."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import count_noun
from kinebench_drake.formats.videos.sample import CameraSource, VideoSample
from kinebench_drake.geometry import Array
from kinebench_drake.io.camerafile import load_camera
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.types import Domain, GripperTrack, Json

if TYPE_CHECKING:  # loads torch and Open3D
    from kinebench_drake.grounding.camera.camera_estimate import CameraEstimate
    from kinebench_drake.grounding.camera.contradiction import CameraContradiction
    from kinebench_drake.grounding.camera.reading import BetterReading
    from kinebench_drake.grounding.pipeline import GroundingResult

AUTO, BENCHMARK = "auto", "benchmark"
"""Values of `--camera` besides the path of a camera.json."""
AGREEMENT = 0.45
"""Least share of the contours on image edges at which the arm agrees with a named camera that no other explains better,
or with an estimated one."""
CONFIRMED = 0.6
"""Share from which on the arm confirms a camera: of 30 demonstrations of unseen looks right cameras have 0.65 or more
with the postures of the track, mirrored pictures 0.59 or less, cameras with 0.7 or 1.4 times the focal length 0.51."""
SURE = 0.68
"""Share from which on not even a mirrored or a slightly cropped picture is tried."""
_USUAL_WIDTH_M = 0.04  # gap between the pads where none is measured
_CHECKED = 5  # frames whose postures check a camera


class CameraJudge(Protocol):
    """Checks and estimates of cameras, as `Analyzer` does."""

    def camera_agreement(self, frames: NDArray[np.uint8], camera: Camera) -> float | None:
        """Return the share of the arm's contours on image edges with this camera; None if no arm is seen."""
        ...

    def estimate_camera(self, frames: NDArray[np.uint8]) -> "CameraEstimate":
        """Estimate the camera of frames (T, H, W, 3).

        Raises:
            UnmeasurableError: hand and arm are seen in too few frames.
        """
        ...

    def posture_agreement(
        self, frames: NDArray[np.uint8], camera: Camera, q: Array, finger_m: Array, *, hand: bool
    ) -> float:
        """Return the share of the arm's contours on image edges at postures (T, 7) [rad], openings (T,) [m]."""
        ...

    def camera_contradiction(self, frames: NDArray[np.uint8], camera: Camera) -> "CameraContradiction | None":
        """Return another camera under which the arm agrees clearly better with the images; None if there is none."""
        ...

    def camera_reading(
        self, frames: NDArray[np.uint8], camera: Camera, least: float, *, likely_only: bool
    ) -> "BetterReading | None":
        """Return a reading of picture or camera with which the arm agrees clearly better; None if there is none."""
        ...

    def count_hands(self, frames: NDArray[np.uint8]) -> tuple[int, int]:
        """Return in how many of some frames a hand is seen, whatever the camera, and how many were searched."""
        ...


class CameraState(Enum):
    """How the camera behind the base frame of a track is known."""

    NAMED = "named"
    """Named by the user or the input."""
    CONFIRMED = "confirmed"
    """Assumed, and confirmed by the arm."""
    ESTIMATED = "estimated"
    """Estimated from the arm, which confirms it."""
    NONE = "none"
    """Unknown: there is no base frame."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraChoice:
    """Camera of a video, and the evidence for it."""

    sample: VideoSample
    """The sample with this camera and its source."""
    agreement: float | None = None
    """Share of the contours of hand and arm on image edges in the postures of the track; None if none was fitted."""
    estimate: "CameraEstimate | None" = None
    """Estimated camera; None if none was estimated."""
    contradiction: "CameraContradiction | None" = None
    """Camera that explains the arm better than the named one; None if none was found."""
    reading: "BetterReading | None" = None
    """Reading of picture or matrix that explains the arm better; None if none was found."""
    reason: str | None = None
    """Why there is no base frame; None if there is one."""

    @property
    def state(self) -> CameraState:
        """How the camera is known."""
        source = self.sample.camera_source
        if self.reason is not None:
            return CameraState.NONE
        if source.is_named:
            return CameraState.NAMED
        return CameraState.ESTIMATED if source is CameraSource.ESTIMATED else CameraState.CONFIRMED

    def to_json(self) -> dict[str, Json]:
        """Serialize into keys of the row."""
        source = self.sample.camera_source
        data: dict[str, Json] = {
            "camera_source": (source if source.is_named or self.reason is None else CameraSource.NONE).value,
            "camera_state": self.state.value,
        }
        if self.agreement is not None:
            data["camera_agreement"] = round(self.agreement, 4)
        for key, part in (
            ("camera_estimate", self.estimate),
            ("camera_contradiction", self.contradiction),
            ("camera_reading", self.reading),
        ):
            if part is not None:
                data[key] = part.to_json()
        if self.sample.mirrored:
            data["mirrored"] = True
        if self.reason is not None:
            data["base_frame_reason"] = self.reason
        return data

    def without_base(self, track: GripperTrack) -> GripperTrack:
        """Return a track without poses in the base frame where there is none."""
        return track if self.reason is None else replace(track, X_BG=np.full_like(track.X_BG, np.nan))


def with_camera_option(samples: Sequence[VideoSample], option: str, *, mirrored: bool = False) -> Sequence[VideoSample]:
    """Return the samples with the camera on which `--camera` insists, and mirrored by `--mirrored`.

    Raises:
        UsageError: the file of `--camera` is no camera.json.
    """
    samples = [replace(sample, mirrored=sample.mirrored or mirrored) for sample in samples]
    if option == AUTO:
        return samples
    if option == BENCHMARK:
        unnamed = CameraSource.BENCHMARK
        return [replace(s, camera_source=CameraSource.OPTION) if s.camera_source is unnamed else s for s in samples]
    setting = load_camera(Path(option))
    return [sample.filmed_by(setting, CameraSource.OPTION) for sample in samples]


def track_agreement(
    frames: NDArray[np.uint8], camera: Camera, grounding: "GroundingResult", judge: CameraJudge
) -> float | None:
    """Return the share of the contours of hand and arm on image edges in the postures of a track; None without any.

    Of a moving camera the frames before it moves count; of the arm alone its contours without a hand's.

    Args:
        frames: (T, H, W, 3) as grounded.
        camera: the camera of these frames.
        grounding: track with this camera.
        judge: checks cameras.
    """
    q, track, path = grounding.arm_q, grounding.track, grounding.camera_path
    if not len(q):
        return None
    usable = np.isfinite(q).all(axis=1) & track.tracked & (True if path is None else path.at_rest)
    fitted = np.flatnonzero(usable)
    if not len(fitted):
        return None
    chosen = fitted[np.unique(np.linspace(0, len(fitted) - 1, _CHECKED).round().astype(int))]
    finger_m = np.nan_to_num(track.finger_width_m[chosen], nan=_USUAL_WIDTH_M) / 2
    hand = grounding.domain is not Domain.ARM
    return judge.posture_agreement(frames[chosen], camera, q[chosen], finger_m, hand=hand)


def find_reading(
    frames: NDArray[np.uint8], camera: Camera, agreement: float | None, judge: CameraJudge
) -> "BetterReading | None":
    """Return a reading of picture or matrix that agrees clearly better than the track does; None if there is none.

    Args:
        frames: (T, H, W, 3) as grounded.
        camera: the camera of these frames.
        agreement: that of the track; None if it has no posture.
        judge: checks cameras.
    """
    if agreement is not None and agreement >= SURE:
        return None
    confirmed = agreement is not None and agreement >= CONFIRMED
    return judge.camera_reading(frames, camera, max(CONFIRMED, agreement or 0.0), likely_only=confirmed)


def check_named(
    sample: VideoSample, frames: NDArray[np.uint8], camera: Camera, grounding: "GroundingResult", judge: CameraJudge
) -> CameraChoice:
    """Check a named camera against the arm.

    If the contours of hand and arm, in the postures of the track, lie on edges of the image, the camera stays, unless
    the mirrored picture agrees clearly better. Otherwise other readings and other cameras are tried. One that explains
    the arm clearly better and puts the gripper elsewhere leaves the base frame unknown, and so does a low agreement.

    Args:
        sample: the sample.
        frames: (T, H, W, 3) as grounded.
        camera: the camera of these frames.
        grounding: track with this camera.
        judge: checks cameras.
    """
    agreement = track_agreement(frames, camera, grounding, judge)
    choice = CameraChoice(sample=sample, agreement=agreement)
    if grounding.camera_path is not None:  # other readings and cameras are sought in pictures of one camera alone
        return choice if agreement is None else replace(choice, reason=_explain_disagreement(agreement, grounding))
    reading = find_reading(frames, camera, agreement, judge)
    if reading is not None:
        return replace(choice, reading=reading, reason=f"the base frame is unknown: {reading.describe()}")
    if agreement is not None and agreement >= CONFIRMED:
        return choice
    other = None if grounding.domain is Domain.ARM else judge.camera_contradiction(frames, camera)
    reason = None
    if other is not None and other.is_large:
        reason = f"the base frame is unknown: {describe_contradiction(other)}"
    elif other is None:
        reason = _explain_disagreement(agreement, grounding)
    return replace(choice, contradiction=other, reason=reason)


def _explain_disagreement(agreement: float | None, grounding: "GroundingResult") -> str | None:
    """Return why a camera that no other explains better gives no base frame; None if it does."""
    if agreement is None:
        if grounding.arm_consistency_px is None or not grounding.has_pose.any():  # nothing could agree or disagree
            return None
        return (
            "the base frame is unknown: the arm contradicts the camera of the input: it is seen, but agrees with the "
            "hand in no tracked frame"
        )
    if agreement >= AGREEMENT:
        return None
    return (
        f"the base frame is unknown: the arm contradicts the camera of the input: {agreement:.0%} of its contours lie "
        f"on image edges, at least {AGREEMENT:.0%} are needed"
    )


def describe_contradiction(other: "CameraContradiction") -> str:
    """Describe the contradiction between the arm and a named camera: agreements, focal length, displacement."""
    return (
        f"the arm contradicts the camera of the input: {other.agreement:.0%} of its contours lie on image edges, "
        f"{other.better:.0%} with a focal length {1 / other.focal_ratio:.2f} times as long, which moves the gripper by "
        f"{1e3 * other.gripper_m:.0f} mm and {np.rad2deg(other.gripper_rad):.0f} degrees in the base frame"
    )


def usual_camera(frames: NDArray[np.uint8]) -> Camera:
    """Return the lens that is assumed where the camera is unknown."""
    from kinebench_drake.grounding.camera import estimate

    return estimate.usual_camera(frames.shape[2], frames.shape[1])


def camera_warnings(rows: Sequence[SampleRow]) -> list[str]:
    """Return warnings about cameras that the input does not name, or that the arm does not confirm."""
    rows = [row for row in rows if row.status is Status.OK]
    states = [row.extra.get("camera_state") for row in rows]
    confirmed, estimated = (states.count(state.value) for state in (CameraState.CONFIRMED, CameraState.ESTIMATED))
    warnings = []
    if confirmed:
        warnings.append(f"no camera is named for {count_noun(confirmed, 'sample')}: the arm confirms the benchmark's")
    if estimated:
        warnings.append(
            f"no camera is named for {count_noun(estimated, 'sample')}: it was estimated from the arm; a camera.json "
            "beside the videos, or `calibrate` with joint angles, is more accurate"
        )
    contradicted = sum("camera_contradiction" in row.extra for row in rows)
    if contradicted:
        warnings.append(
            f"the arm contradicts the camera of {count_noun(contradicted, 'sample')}: see camera_contradiction in the "
            "rows; check width, height and focal length of camera.json, leave it out to have the camera estimated, or "
            "fit it with `calibrate --joints`"
        )
    doubtful = sum(_is_unconfirmed(row) for row in rows)
    if doubtful:
        warnings.append(
            f"the arm confirms the camera in all but {count_noun(doubtful, 'sample')}, where its contours are not on "
            "image edges: look at the overlays"
        )
    lost = sum("base_frame_reason" in row.extra for row in rows)
    if lost:
        warnings.append(
            f"no base frame in {count_noun(lost, 'sample')}: reach, limits and verdicts are null there, with the reason"
        )
    return warnings


def _is_unconfirmed(row: SampleRow) -> bool:
    """Return whether the arm neither confirms nor contradicts a named camera."""
    agreement = row.extra.get("camera_agreement")
    low = isinstance(agreement, float) and agreement < CONFIRMED
    return low and row.extra.get("camera_state") == CameraState.NAMED.value and "camera_contradiction" not in row.extra


def camera_frame_metrics(track: GripperTrack, reason: str) -> tuple[Mapping[str, Json], Mapping[str, str]]:
    """Return the smoothness of a track in the camera frame, and the reasons of metrics and verdicts that it lacks."""
    from kinebench_drake.metrics.smoothness import measure_smoothness
    from kinebench_drake.models.panda.robot import hand_from_tcp

    X_CG: Array = track.X_CH @ hand_from_tcp()
    smoothness = measure_smoothness(replace(track, X_BG=X_CG))
    reasons = {name: smoothness.reasons.get(name, reason) for name in smoothness.metrics}
    return dict(smoothness.metrics), {**reasons, "feasible": reason, "": reason}
