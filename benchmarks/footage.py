"""Grounding of videos that other programs and cameras made, each with its camera and a reference to compare with.

The reference is a file of poses (`benchmarks.perception.clip.TRUTHS`), or points labelled by eye
(`benchmarks.footage_labels`), or nothing.
"""

import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Annotated

import numpy as np

from benchmarks.perception.clip import TruthClipFile, find_clips
from benchmarks.perception.store import Confidences, Flags, MeasurementStore, Milli, Stored, fingerprint
from kinebench_drake.anomaly import Anomaly
from kinebench_drake.camera import Camera
from kinebench_drake.errors import UsageError
from kinebench_drake.formats.manifest import NAME
from kinebench_drake.geometry import Array, transform_points
from kinebench_drake.grounding.anomaly.detect import AnomalyEvidence
from kinebench_drake.grounding.overlay import draw_overlay
from kinebench_drake.grounding.pipeline import GroundingPipeline
from kinebench_drake.grounding.priors import NO_PRIORS, Priors
from kinebench_drake.grounding.tracking.tracker import Tracking
from kinebench_drake.grounding.tracking.view import GRIPPER_CENTRE_H, GRIPPER_RADIUS_M
from kinebench_drake.io.container import write_video
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.reader import read_video
from kinebench_drake.models.panda.description import GripperKind
from kinebench_drake.track import GripperTrack

_Micro = Annotated[Array, Stored(".6f")]
_OVERLAY_FPS = 5.0
_WINDOW_MARGIN = 2.5  # distance of the window's border from the gripper's centre, over the gripper's radius


class ReferenceKind(Enum):
    """Source of the reference, and thus the figures that can be measured."""

    SIMULATOR = "other simulator, exact poses"
    JOINTS = "real arm, joint angles"
    EDGES = "other simulation, edge fit"
    LABELS = "labelled by eye"
    NONE = "no reference"


def find_footage(folder: Path) -> list[TruthClipFile]:
    """Return the videos of the manifest in a folder, or of those in its subfolders, with or without references.

    Raises:
        UsageError: there is no manifest, or a line has no usable video or camera.
    """
    folders = [folder] if (folder / NAME).is_file() else sorted(path.parent for path in folder.glob(f"*/{NAME}"))
    if not folders:
        raise UsageError(f"{folder.name}: neither it nor a subfolder has a {NAME}")
    return [clip for each in folders for clip in find_clips(each, required=False)]


def reference_of(video: TruthClipFile, labelled: Collection[str]) -> ReferenceKind:
    """Return the source of a video's reference; `labelled`: ids of the videos that are labelled by eye."""
    if not video.truth.is_file():
        return ReferenceKind.LABELS if video.id in labelled else ReferenceKind.NONE
    if video.truth.name.endswith(".edge.npz"):
        return ReferenceKind.EDGES
    return ReferenceKind.JOINTS if video.truth.parent.name == "gt" else ReferenceKind.SIMULATOR


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackRecord:
    """Output of the grounding for one video."""

    id: str
    X_CH: _Micro
    """(T, 4, 4) pose of panda_hand in the camera frame [m]; NaN where not tracked."""
    X_CH_frame: _Micro
    """(T, 4, 4) pose of each frame by itself, before confidence and smoothing; NaN where no gripper is detected."""
    tracked: Flags
    confidence: Confidences
    """(T,) 0..1."""
    finger_width_m: _Micro
    """(T,) gap between the finger pads [m]; NaN where unknown."""
    arm_agrees: Flags
    """(T,) frames in which one posture explains hand and links."""
    anomalies: tuple[Anomaly, ...]
    cpu_s: Milli
    """Processor time [s]."""


class ObservedPipeline(GroundingPipeline):
    """Pipeline that keeps the measurements of single frames of its last video."""

    tracking: Tracking

    def observe(
        self, frames: Frames, camera: Camera, t_s: Array, priors: Priors = NO_PRIORS
    ) -> tuple[Tracking, AnomalyEvidence]:
        """Measure each frame, as `GroundingPipeline.observe`."""
        self.tracking, evidence = super().observe(frames, camera, t_s, priors)
        return self.tracking, evidence


def ground_video(
    pipeline: ObservedPipeline, video: TruthClipFile, overlay: Path | None, *, window: bool
) -> TrackRecord:
    """Ground a video with its camera, and draw the tracked gripper on it into the file `overlay`.

    With `window` the frames are cut to the square that the gripper moves in by the reference, which does not enter
    otherwise: the difference that a perfect detection would make.
    """
    frames = read_video(video.video).frames
    camera = video.camera
    camera = camera.resized(frames.shape[2], frames.shape[1])
    if window:
        frames, camera = cut_window(frames, camera, video.load().X_CH)
    start = time.process_time()
    result = pipeline.ground(frames, camera, np.arange(len(frames), dtype=np.float64) * video.frame_period_s)
    cpu_s = time.process_time() - start
    if overlay is not None:
        write_overlay(overlay, frames, camera, result.track)
    poses = pipeline.tracking.poses
    return TrackRecord(
        id=video.id,
        X_CH=result.track.X_CH,
        X_CH_frame=np.stack([np.full((4, 4), np.nan) if p is None else p.X_CH for p in poses]),
        tracked=result.track.tracked,
        confidence=result.track.confidence,
        finger_width_m=result.track.finger_width_m,
        arm_agrees=np.array([p is not None and p.arm is not None and p.arm.agrees for p in poses]),
        anomalies=result.anomalies,
        cpu_s=cpu_s,
    )


def cut_window(frames: Frames, camera: Camera, X_CH: Array) -> tuple[Frames, Camera]:
    """Return the square window of the frames (T, H, W, 3) that the gripper at `X_CH` (T, 4, 4) moves in, its camera."""
    centre = transform_points(X_CH, GRIPPER_CENTRE_H[None])[:, 0]
    pixel = camera.project(centre)
    reach = (_WINDOW_MARGIN * GRIPPER_RADIUS_M * camera.fx / centre[:, 2])[:, None]
    low = (pixel - reach).min(axis=0)
    high = (pixel + reach).max(axis=0)
    size = min(int(np.ceil((high - low).max())), camera.width, camera.height)
    left, top = (
        int(np.clip(round(middle - size / 2), 0, side - size))
        for middle, side in zip((low + high) / 2, (camera.width, camera.height), strict=True)
    )
    cut = np.ascontiguousarray(frames[:, top : top + size, left : left + size])
    return cut, replace(camera, width=size, height=size, cx=camera.cx - left, cy=camera.cy - top)


def write_overlay(path: Path, frames: Frames, camera: Camera, track: GripperTrack) -> None:
    """Write the tracked gripper drawn on the video, slow enough to look at."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_video(path, draw_overlay(frames, camera, track), _OVERLAY_FPS)


def ground_videos(
    videos: Sequence[TruthClipFile],
    out: Path,
    *,
    weights: Path | None,
    calibration: Path | None,
    gripper: GripperKind,
    window: bool,
    log: Callable[[str], None],
) -> list[TrackRecord]:
    """Ground the videos that `out`/tracks.jsonl does not hold yet, and write their overlays.

    Measurements of other code, weights or options are ignored.
    """
    files = [path for path in (weights, calibration) if path is not None]
    base = fingerprint(window, gripper.value, modules=["kinebench_drake.grounding.pipeline"], files=files)
    store = MeasurementStore(out / "tracks.jsonl", TrackRecord)
    pipeline: ObservedPipeline | None = None
    records = []
    for video in videos:
        key = f"{base}-{video.digest()}-{video.id}"
        if key not in store:
            pipeline = pipeline or ObservedPipeline.create(weights=weights, gripper=gripper, calibration=calibration)
            store.put(key, ground_video(pipeline, video, out / "overlays" / f"{video.id}.mp4", window=window))
            log(f"{video.id}: {store[key].cpu_s:.0f} s of processor time")
        records.append(store[key])
    return records
