"""Grounding of videos that other programs and cameras made, each with its camera and a reference to compare with.

The reference is a file of poses (`benchmarks.perception.clip.TRUTHS`), or points labelled by eye
(`benchmarks.footage_labels`), or nothing.
"""

import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.perception.clip import TruthClipFile, find_clips
from benchmarks.perception.store import Confidences, Flags, MeasurementStore, Micro, Milli, fingerprint
from kinebench_drake.anomaly import Anomaly
from kinebench_drake.camera import Camera
from kinebench_drake.errors import UsageError
from kinebench_drake.executors.base import Observer
from kinebench_drake.executors.local import LocalExecutor
from kinebench_drake.formats.manifest import NAME
from kinebench_drake.grounding.overlay import draw_overlay
from kinebench_drake.grounding.pipeline import GroundingPipeline
from kinebench_drake.io.container import write_video
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.reader import read_video
from kinebench_drake.models.gripper import GripperModel
from kinebench_drake.models.panda.description import GripperKind
from kinebench_drake.track import GripperTrack

OVERLAY_FPS = 5.0
"""Frame rate of overlays [1/s]: slow enough to look at."""


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
    X_CH: Micro
    """(T, 4, 4) pose of panda_hand in the camera frame [m]; NaN where not tracked."""
    tracked: Flags
    confidence: Confidences
    """(T,) 0..1."""
    finger_width_m: Micro
    """(T,) gap between the finger pads [m]; NaN where unknown."""
    anomalies: tuple[Anomaly, ...]
    cpu_s: Milli
    """Processor time [s]."""


class FootageWorker:
    """Grounds videos with their cameras, and draws the tracked gripper on them."""

    def __init__(self, gripper: GripperKind, overlays: Path) -> None:
        """Load the pipeline of a gripper; overlays are written into a folder."""
        self._pipeline = GroundingPipeline.create(gripper=gripper)
        self._overlays = overlays

    def __call__(self, video: TruthClipFile) -> TrackRecord:
        """Ground one video."""
        frames = read_video(video.video).frames
        camera = video.camera.resized(frames.shape[2], frames.shape[1])
        start = time.process_time()
        result = self._pipeline.ground(frames, camera, np.arange(len(frames), dtype=np.float64) * video.frame_period_s)
        cpu_s = time.process_time() - start
        write_overlay(self._overlays / f"{video.id}.mp4", frames, camera, result.track, result.gripper_model)
        return TrackRecord(
            id=video.id,
            X_CH=result.track.X_CH,
            tracked=result.track.tracked,
            confidence=result.track.confidence,
            finger_width_m=result.track.finger_width_m,
            anomalies=result.anomalies,
            cpu_s=cpu_s,
        )


def write_overlay(
    path: Path, frames: Frames, camera: Camera, track: GripperTrack, gripper: GripperModel | None
) -> None:
    """Write the tracked gripper drawn on the video, or without a model its axes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_video(path, draw_overlay(frames, camera, track, gripper=gripper), OVERLAY_FPS)


def ground_videos(
    videos: Sequence[TruthClipFile], out: Path, gripper: GripperKind, observer: Observer
) -> list[TrackRecord]:
    """Ground the videos that `out`/tracks.jsonl does not hold yet, and write their overlays.

    Measurements of other code or of another gripper are ignored.
    """
    base = fingerprint(gripper.value, modules=["kinebench_drake.grounding.pipeline"])
    store = MeasurementStore(out / "tracks.jsonl", TrackRecord)
    make_worker = partial(FootageWorker, gripper, out / "overlays")
    return store.complete(
        videos,
        lambda video: f"{base}-{video.digest()}-{video.id}",
        LocalExecutor(jobs=1),
        make_worker,
        observer,
        lambda video: video.id,
    )
