"""Cameras of a run: the option that names them, warnings about them, metrics of tracks without a base frame."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from kinebench_drake.camera import CONFIRMED, CameraSource, CameraState
from kinebench_drake.errors import count_noun, name_options
from kinebench_drake.formats.camerafile import load_camera
from kinebench_drake.formats.videos.sample import VideoSample
from kinebench_drake.geometry import Array
from kinebench_drake.io.jsonl import Json
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.track import GripperTrack

AUTO, BENCHMARK = "auto", "benchmark"
"""Values of `--camera` besides the path of a camera.json."""


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

    reason = name_options(reason)
    X_CG: Array = track.X_CH @ hand_from_tcp()
    smoothness = measure_smoothness(replace(track, X_BG=X_CG))
    reasons = {name: smoothness.reasons.get(name, reason) for name in smoothness.metrics}
    return dict(smoothness.metrics), {**reasons, "feasible": reason, "": reason}
