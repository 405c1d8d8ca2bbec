"""Choice and check of a video's camera: the input's, the benchmark's where the arm agrees, else an estimated one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.datasets.videos.sample import CameraSource, VideoSample
from kinebench_drake.errors import UnmeasurableError, count_noun
from kinebench_drake.geometry import Array
from kinebench_drake.io.camerafile import load_camera
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.types import GripperTrack, Json

if TYPE_CHECKING:  # loads torch and Open3D
    from kinebench_drake.calibration.camera_estimate import CameraEstimate
    from kinebench_drake.calibration.contradiction import CameraContradiction
    from kinebench_drake.grounding.pipeline import GroundingResult

AUTO, BENCHMARK = "auto", "benchmark"
"""Values of `--camera` besides the path of a camera.json."""
AGREEMENT = 0.45
"""Least share of the contours on image edges at which the arm agrees with a camera of the benchmark or the input."""
CONFIRMED = 0.6
"""Share from which on no camera is searched that explains the arm better than that of the input. On eight unseen
demonstrations right cameras have 0.69 or more, cameras with 0.7 or 1.4 times the focal length 0.51 or less."""
_INPUT_SOURCES = (CameraSource.GIVEN, CameraSource.MANIFEST, CameraSource.FOLDER, CameraSource.OPTION)
_USUAL_WIDTH_M = 0.04  # gap between the pads where none is measured
_CHECKED = 5  # frames whose postures check a camera of the input


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

    def posture_agreement(self, frames: NDArray[np.uint8], camera: Camera, q: Array, finger_m: Array) -> float:
        """Return the share of the arm's contours on image edges at postures (T, 7) [rad], openings (T,) [m]."""
        ...

    def camera_contradiction(self, frames: NDArray[np.uint8], camera: Camera) -> "CameraContradiction | None":
        """Return another camera under which the arm agrees clearly better with the images; None if there is none."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraChoice:
    """Camera of a video."""

    sample: VideoSample
    """The sample with this camera and its source."""
    agreement: float | None = None
    """Share of the arm's contours on image edges with the benchmark's or the input's camera; None if not measured."""
    estimate: "CameraEstimate | None" = None
    """Estimated camera; None if none was estimated."""
    contradiction: "CameraContradiction | None" = None
    """Camera that explains the arm better than that of the input; None if none was found."""
    reason: str | None = None
    """Why there is no base frame; None if there is one."""

    def to_json(self) -> dict[str, Json]:
        """Serialize into keys of the row."""
        data: dict[str, Json] = {}
        if self.agreement is not None:
            data["camera_agreement"] = round(self.agreement, 4)
        if self.sample.camera_source is CameraSource.ESTIMATED:
            data["camera_source"] = self.sample.camera_source.value
        if self.estimate is not None:
            data["camera_estimate"] = self.estimate.to_json()
        if self.contradiction is not None:
            data["camera_contradiction"] = self.contradiction.to_json()
        if self.reason is not None:
            data["base_frame_reason"] = self.reason
        return data

    def without_base(self, track: GripperTrack) -> GripperTrack:
        """Return a track without poses in the base frame where there is none."""
        return track if self.reason is None else replace(track, X_BG=np.full_like(track.X_BG, np.nan))


def with_camera_option(samples: Sequence[VideoSample], option: str) -> Sequence[VideoSample]:
    """Return the samples with the camera of `--camera FILE`, if it names a file.

    Raises:
        UsageError: the file is no camera.json.
    """
    if option in (AUTO, BENCHMARK):
        return samples
    camera = load_camera(Path(option))
    return [replace(sample, camera=camera, camera_source=CameraSource.OPTION) for sample in samples]


def is_assumed(sample: VideoSample, option: str) -> bool:
    """Return whether the camera is an assumption that the arm may contradict."""
    return option == AUTO and sample.camera_source is CameraSource.BENCHMARK


def choose_camera(
    sample: VideoSample,
    frames: NDArray[np.uint8],
    whole: tuple[NDArray[np.uint8], Camera] | None,
    judge: CameraJudge,
) -> CameraChoice:
    """Choose the camera of a video whose input names none.

    Args:
        sample: the sample, with the benchmark camera.
        frames: (T, H, W, 3) whole frames.
        whole: the part of the frames that shows the image of the benchmark camera, and its camera; None if the shapes
            do not fit.
        judge: checks and estimates cameras.
    """
    agreement = None if whole is None else judge.camera_agreement(*whole)
    if whole is not None and (agreement is None or agreement >= AGREEMENT):
        return CameraChoice(sample=sample, agreement=agreement)
    against = (
        "the shape of the video is not that of the benchmark camera"
        if agreement is None
        else f"the arm contradicts the benchmark camera ({agreement:.0%} of its contours on image edges)"
    )
    try:
        estimate = judge.estimate_camera(frames)
    except UnmeasurableError as error:
        reason = f"the base frame is unknown: {against}, and {error}"
        if whole is not None:
            return CameraChoice(sample=sample, agreement=agreement, reason=reason)
        usual = _usual_camera(frames)
        assumed = replace(sample, camera=usual, camera_source=CameraSource.ESTIMATED)
        return CameraChoice(sample=assumed, agreement=agreement, reason=reason)
    chosen = replace(sample, camera=estimate.camera, camera_source=CameraSource.ESTIMATED)
    unknown = None if estimate.doubt is None else f"the base frame is unknown: {against}, and {estimate.doubt}"
    return CameraChoice(sample=chosen, agreement=agreement, estimate=estimate, reason=unknown)


def check_camera(
    choice: CameraChoice,
    frames: NDArray[np.uint8],
    camera: Camera,
    grounding: "GroundingResult",
    judge: CameraJudge,
) -> CameraChoice:
    """Check a camera of the input against the arm.

    If the contours of hand and arm, in the postures of the track, lie on edges of the image, the camera is confirmed
    and nothing else is computed. Otherwise a camera that explains the arm clearly better is returned as contradiction;
    if it moves the gripper far, or if no camera is better and the agreement is low, the base frame is unknown.

    Args:
        choice: the camera.
        frames: (T, H, W, 3) as grounded.
        camera: the camera of these frames.
        grounding: track with this camera.
        judge: checks cameras.
    """
    if choice.sample.camera_source not in _INPUT_SOURCES:
        return choice
    agreement = track_agreement(frames, camera, grounding, judge)
    choice = replace(choice, agreement=agreement)
    if agreement is not None and agreement >= CONFIRMED:
        return choice
    other = judge.camera_contradiction(frames, camera)
    reason = None
    if other is not None and other.is_large:
        reason = f"the base frame is unknown: {describe_contradiction(other)}"
    elif other is None and len(grounding.arm_q):
        reason = _explain_disagreement(agreement, arm_is_seen=grounding.arm_consistency_px is not None)
    return replace(choice, contradiction=other, reason=reason)


def track_agreement(
    frames: NDArray[np.uint8], camera: Camera, grounding: "GroundingResult", judge: CameraJudge
) -> float | None:
    """Return the share of the contours of hand and arm on image edges in the postures of a track; None without any.

    Args:
        frames: (T, H, W, 3) as grounded.
        camera: the camera of these frames.
        grounding: track with this camera.
        judge: checks cameras.
    """
    q, track = grounding.arm_q, grounding.track
    fitted = np.flatnonzero(np.isfinite(q).all(axis=1) & track.tracked) if len(q) else np.zeros(0, dtype=np.intp)
    if not len(fitted):
        return None
    chosen = fitted[np.unique(np.linspace(0, len(fitted) - 1, _CHECKED).round().astype(int))]
    finger_m = np.nan_to_num(track.finger_width_m[chosen], nan=_USUAL_WIDTH_M) / 2
    return judge.posture_agreement(frames[chosen], camera, q[chosen], finger_m)


def _explain_disagreement(agreement: float | None, *, arm_is_seen: bool) -> str | None:
    """Return why a camera that no other explains better gives no base frame; None if it does."""
    if agreement is None:
        never = "the arm contradicts the camera of the input: it is seen, but agrees with the hand in no tracked frame"
        return f"the base frame is unknown: {never}" if arm_is_seen else None
    if agreement >= AGREEMENT:
        return None
    return (
        f"the base frame is unknown: the arm contradicts the camera of the input: {agreement:.0%} of its contours lie "
        f"on image edges, at least {AGREEMENT:.0%} are needed"
    )


def explain_loss(choice: CameraChoice, frames: NDArray[np.uint8], camera: Camera, judge: CameraJudge) -> str:
    """Return how the arm contradicts a camera of the input with which no gripper is tracked; empty if it does not.

    Args:
        choice: the camera.
        frames: (T, H, W, 3) as grounded.
        camera: the camera of these frames.
        judge: checks cameras.
    """
    other = judge.camera_contradiction(frames, camera) if choice.sample.camera_source in _INPUT_SOURCES else None
    return "" if other is None else f" This is not its camera: {describe_contradiction(other)}."


def describe_contradiction(other: "CameraContradiction") -> str:
    """Describe the contradiction between the arm and a camera of the input: agreements, focal length, displacement."""
    return (
        f"the arm contradicts the camera of the input: {other.agreement:.0%} of its contours lie on image edges, "
        f"{other.better:.0%} with a focal length {1 / other.focal_ratio:.2f} times as long, which moves the gripper by "
        f"{1e3 * other.gripper_m:.0f} mm and {np.rad2deg(other.gripper_rad):.0f} degrees in the base frame"
    )


def _usual_camera(frames: NDArray[np.uint8]) -> Camera:
    from kinebench_drake.calibration.estimate import usual_camera

    return usual_camera(frames.shape[2], frames.shape[1])


def camera_warnings(rows: Sequence[SampleRow]) -> list[str]:
    """Return warnings about cameras that the input does not name."""
    rows = [row for row in rows if row.status is Status.OK]
    sources = [row.extra.get("camera_source") for row in rows]
    assumed, estimated = (sources.count(source.value) for source in (CameraSource.BENCHMARK, CameraSource.ESTIMATED))
    lost = sum("base_frame_reason" in row.extra for row in rows)
    warnings = []
    if assumed:
        checked = sum("camera_agreement" in row.extra for row in rows if row.extra.get("camera_source") == "benchmark")
        agrees = f"the arm agrees with it in {checked}" if checked else "unchecked"
        warnings.append(
            f"no camera is named for {count_noun(assumed, 'sample')}: the benchmark's was assumed ({agrees})"
        )
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
    if lost:
        warnings.append(
            f"no base frame in {count_noun(lost, 'sample')}: reach, limits and verdicts are null there, with the reason"
        )
    return warnings


def _is_unconfirmed(row: SampleRow) -> bool:
    """Return whether the arm neither confirms nor contradicts a camera of the input."""
    agreement = row.extra.get("camera_agreement")
    of_input = row.extra.get("camera_source") in [source.value for source in _INPUT_SOURCES]
    low = isinstance(agreement, float) and agreement < CONFIRMED
    return of_input and low and "camera_contradiction" not in row.extra


def camera_frame_metrics(track: GripperTrack, reason: str) -> tuple[Mapping[str, Json], Mapping[str, str]]:
    """Return the smoothness of a track in the camera frame, and the reasons of metrics and verdicts that it lacks."""
    from kinebench_drake.metrics.smoothness import measure_smoothness
    from kinebench_drake.models.panda.robot import hand_from_tcp

    X_CG: Array = track.X_CH @ hand_from_tcp()
    smoothness = measure_smoothness(replace(track, X_BG=X_CG))
    reasons = {name: smoothness.reasons.get(name, reason) for name in smoothness.metrics}
    return dict(smoothness.metrics), {**reasons, "feasible": reason, "": reason}
