"""Measuring the grounding against ground truth: pose errors, tracking, flips, anomalies, time."""

import json
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import UsageError
from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.grounding.estimator import NetworkEstimator, TrueDepthEstimator
from kinebench_drake.grounding.pipeline import Grounding, GroundingPipeline
from kinebench_drake.grounding.tracker import CadTracker
from kinebench_drake.grounding.video import read_video
from kinebench_drake.models.panda.cad import GripperCad
from kinebench_drake.products import Anomaly, AnomalyKind

FLIP_RAD = np.pi / 2
"""A rotation error beyond this is the other reading of the gripper."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Clip:
    """A video with its truth."""

    id: str
    path: Path
    camera: Camera
    t_s: Array
    """(T,) task time [s]."""
    X_CH: Array
    """(T, 4, 4) true pose of panda_hand in the camera frame; NaN where the gripper is not in the picture."""
    finger_width_m: Array
    """(T,) true gap between the pads [m]."""
    depth_m: Array | None
    """(T, H, W) true depth [m], if stored."""
    mask: NDArray[np.bool_] | None
    """(T, H, W) true gripper mask, if stored."""
    faults: tuple[Anomaly, ...]
    """Planted faults."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClipErrors:
    """How the grounding of one clip differs from its truth."""

    id: str
    position_m: Array
    """(T,) position error of panda_hand [m]; NaN where not tracked or not there."""
    rotation_rad: Array
    """(T,) rotation error [rad]; NaN likewise."""
    finger_m: Array
    """(T,) error of the finger opening [m]; NaN likewise."""
    tracked: NDArray[np.bool_]
    """(T,)."""
    confidence: Array
    """(T,) 0..1."""
    visible: NDArray[np.bool_]
    """(T,) frames in which the gripper is there."""
    found: tuple[Anomaly, ...]
    planted: tuple[Anomaly, ...]
    wall_s: float
    """Time of the grounding, video decoding included [s]."""

    @property
    def tracked_fraction(self) -> float:
        """Tracked frames over frames with a gripper."""
        return float(self.tracked[self.visible].mean()) if self.visible.any() else float("nan")

    @property
    def longest_flip(self) -> int:
        """Longest run of frames in the other reading."""
        longest = run = 0
        for flipped in self.rotation_rad > FLIP_RAD:
            run = run + 1 if flipped else 0
            longest = max(longest, run)
        return longest


def load_clips(folder: Path, *, with_depth: bool = False) -> list[Clip]:
    """The clips of a folder written by `python -m kinebench_drake.suites.samples`, with their true depth if asked for.

    Raises:
        UsageError: there is no manifest or no truth.
    """
    manifest = folder / "manifest.jsonl"
    if not manifest.is_file():
        raise UsageError(
            f"{folder.name}: has no manifest.jsonl; make one with `python -m kinebench_drake.suites.samples`"
        )
    camera = Camera.load(folder / "camera.json")
    faults_path = folder / "truth" / "faults.json"
    planted = json.loads(faults_path.read_text()) if faults_path.is_file() else {}
    clips = []
    for number, line in enumerate(manifest.read_text().splitlines(), 1):
        try:
            video = str(json.loads(line)["video"])
        except (ValueError, KeyError, TypeError):
            raise UsageError(f"{manifest.name} line {number}: expected a JSON object with the key video") from None
        name = Path(video).stem
        truth_path = folder / "truth" / f"{name}.npz"
        if not truth_path.is_file():
            raise UsageError(f"{folder.name}: truth/{truth_path.name} is missing, so errors cannot be measured")
        with np.load(truth_path, allow_pickle=False) as truth:
            depth = (truth["depth_mm"] + 0.5) / 1000.0 if with_depth and "depth_mm" in truth else None
            mask = truth["mask"] if with_depth and "mask" in truth else None
            clips.append(
                Clip(
                    id=name,
                    path=folder / video,
                    camera=camera,
                    t_s=truth["t_s"],
                    X_CH=truth["camera_from_hand"],
                    finger_width_m=truth["finger_width_m"],
                    depth_m=depth,
                    mask=None if mask is None else np.unpackbits(mask, axis=-1, count=camera.width).astype(bool),
                    faults=tuple(_fault(f) for f in _as_list(planted.get(name))),
                )
            )
    if not clips:
        raise UsageError(f"{folder.name}: its manifest lists no video")
    return clips


def _as_list(value: object) -> list[dict[str, object]]:
    if value is None:
        return []
    return value if isinstance(value, list) else [value]  # type: ignore[list-item]


def _fault(data: dict[str, object]) -> Anomaly:
    return Anomaly(
        kind=AnomalyKind(data["kind"]),
        frame_start=int(str(data["frame_start"])),
        frame_end=int(str(data["frame_end"])),
        severity=float(str(data["size"])),
    )


def compare(clip: Clip, grounding: Grounding, wall_s: float) -> ClipErrors:
    """Hold a grounding against the truth."""
    position, rotation = pose_difference(clip.X_CH, grounding.track.X_CH)
    return ClipErrors(
        id=clip.id,
        position_m=position,
        rotation_rad=rotation,
        finger_m=np.abs(grounding.track.finger_width_m - clip.finger_width_m),
        tracked=grounding.track.tracked,
        confidence=grounding.track.confidence,
        visible=np.asarray(np.isfinite(clip.X_CH).all(axis=(1, 2))),
        found=grounding.anomalies,
        planted=clip.faults,
        wall_s=wall_s,
    )


def evaluate(clip: Clip, pipeline: GroundingPipeline) -> ClipErrors:
    """Ground one clip and measure its errors."""
    began = time.perf_counter()
    grounding = pipeline.ground(read_video(clip.path).frames, clip.camera, clip.t_s)
    return compare(clip, grounding, time.perf_counter() - began)


def true_depth_pipeline(
    base: GroundingPipeline, estimator: NetworkEstimator, clip: Clip, cad: GripperCad
) -> GroundingPipeline:
    """The pipeline with mask and depth of `clip` given.

    Raises:
        UsageError: the clip's truth holds no depth.
    """
    if clip.depth_m is None or clip.mask is None:
        raise UsageError(f"{clip.id}: its truth holds no depth; render the samples with --with-depth")
    tracker = CadTracker(TrueDepthEstimator(estimator, clip.depth_m, clip.mask), cad, trust_depth=True)
    return GroundingPipeline(tracker, base.confidence)
