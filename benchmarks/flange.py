"""Tracking of the flange with the hand left out, and with boxes in its place; its confidence."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from pydrake.geometry import Box
from typing_extensions import override

from benchmarks.markdown import table
from benchmarks.perception.clip import TruthClipFile, find_clips
from benchmarks.perception.store import MeasurementStore, fingerprint
from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert, make_pose, pose_difference
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.pipeline import GroundingPipeline
from kinebench_drake.grounding.tracking.pose import CALIBRATION, load_confidence, save_confidence
from kinebench_drake.io.atomic import make_folder, write_atomically
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.reader import read_video
from kinebench_drake.models.panda.description import GRIPPER, LINK_OF, GripperKind
from kinebench_drake.models.perception.network import ARM_WEIGHTS
from kinebench_drake.track import Domain
from training.augment import degrade
from training.calibration import MeasuredPoses, fit_confidence
from training.layout import random_surface
from training.vtk import VtkScene

_Video = tuple[Frames, Camera, Array]
"""Frames (T, H, W, 3), camera and true poses (T, 4, 4) of panda_hand in its frame [m]."""
FRAMES = 16
"""Frames of a video that are measured, from its middle."""
_HALVES = ((0.05, 0.08, 0.05), (0.012, 0.02, 0.06), (0.012, 0.02, 0.06))
"""Half sides of palm and fingers [m]."""
_CENTRES = ((0.0, 0.0, 0.05), (0.0, 0.06, 0.15), (0.0, -0.06, 0.15))


class _HandlessScene(VtkScene):
    """Random scene of a Panda without the hand."""

    @override
    def _add_robot(self) -> None:
        super()._add_robot()
        for part in GRIPPER:
            geometries = self._graph.model_inspector().GetGeometries(self._frames[LINK_OF[part]])
            self._graph.RemoveGeometry(self._source, geometries[0])


class BoxGripperScene(_HandlessScene):
    """Random scene of a Panda with a gripper of boxes."""

    @override
    def _add_robot(self) -> None:
        super()._add_robot()
        for k, (half, centre) in enumerate(zip(_HALVES, _CENTRES, strict=True)):
            size = np.array(half) * self._rng.uniform(0.7, 1.3)
            self._add(f"box{k}", Box(*(2 * size)), random_surface(self._rng), X=make_pose(np.eye(3), centre))

    @override
    def _move(self, X_BL: Mapping[str, Array], X_BO: Sequence[Array], X_BP: Array) -> None:
        super()._move({**X_BL, **{f"box{k}": X_BL[LINK_OF[GRIPPER[0]]] for k in range(len(GRIPPER))}}, X_BO, X_BP)


def measure(demos: Path, out: Path, *, count: int, log: Callable[[str], None]) -> Mapping[str, MeasuredPoses]:
    """Track the flange in demonstrations and in random scenes with a gripper of boxes.

    Args:
        demos: folder of `suite demos`; of its Franka hand nothing is used.
        out: output folder; finished videos are kept.
        count: demonstrations, and videos with boxes. Each video is measured as it is, and degraded.
        log: receives a line per video.
    """
    make_folder(out)
    base = fingerprint(modules=["kinebench_drake.grounding.tracking.flange_tracker"], files=[ARM_WEIGHTS])
    store = MeasurementStore(out / "flange.jsonl", MeasuredPoses)
    pipeline = GroundingPipeline.create(gripper=GripperKind.NONE)
    videos: list[tuple[str, Callable[[], _Video]]] = []
    clips = find_clips(demos)
    for file in clips[:: max(1, len(clips) // count)][:count]:

        def of_demo(file: TruthClipFile = file) -> _Video:
            clip = file.load()
            return read_video(file.video).frames, clip.camera, clip.X_CH

        videos.append((f"demos/{file.id}", of_demo))
    for seed in range(count):

        def of_scene(seed: int = seed) -> _Video:
            video = BoxGripperScene(np.random.default_rng([88, seed])).video()
            return video.frames, video.camera, invert(video.camera.X_BC) @ video.X_BH

        videos.append((f"boxes/{seed:03d}", of_scene))
    measured = {}
    for noise, (name, load) in enumerate(videos):
        for degraded in (False, True):
            id = f"degraded {name}" if degraded else name
            key = f"{base}-{id}"
            if key not in store:
                store.put(key, _measure(pipeline, *load(), seed=noise if degraded else None))
            measured[id] = store[key]
            distance, angle = pose_difference(store[key].X_true, store[key].X_AH)
            log(
                f"{id}: {store[key].detected.mean():.2f} detected, {1e3 * np.nanmedian(distance):.1f} mm, "
                f"{np.rad2deg(np.nanmedian(angle)):.1f} degrees"
            )
    return measured


def summarize(measured: Mapping[str, MeasuredPoses], out: Path) -> str:
    """Write flange.md into a folder, a table of errors with the shipped confidence, and return it."""
    kinds = [f"{look}{name}" for name in ("demos", "boxes") for look in ("", "degraded ")]
    rows = [_row(kind, [m for id, m in measured.items() if id.startswith(f"{kind}/")]) for kind in kinds]
    head = ("videos", "frames", "tracked", "right among tracked", "median [mm]", "95 % [mm]", "median [degrees]")
    text = "\n".join(table(head, rows)) + "\n"
    write_atomically(out / "flange.md", text.encode())
    return text


def write_confidence(measured: Mapping[str, MeasuredPoses]) -> None:
    """Fit the confidence of the arm alone, and write it into the shipped calibration."""
    save_confidence({**load_confidence(), Domain.ARM: fit_confidence(list(measured.values()))}, CALIBRATION)


def _measure(
    pipeline: GroundingPipeline, frames: Frames, camera: Camera, X_CH: Array, *, seed: int | None
) -> MeasuredPoses:
    """Track the flange in the middle of a video; with a seed, in frames degraded as in training."""
    first = max(0, (len(frames) - FRAMES) // 2)
    chosen = np.arange(first, min(first + FRAMES, len(frames)))
    camera = camera.resized(frames.shape[2], frames.shape[1])
    video = frames[chosen]
    if seed is not None:
        video = np.stack([degrade(frame, np.random.default_rng(seed)) for frame in video])
    t_s = 0.2 * chosen.astype(np.float64)
    return MeasuredPoses.from_tracking(*pipeline.observe(video, camera, np.asarray(t_s, np.float64)), X_CH[chosen])


def _row(kind: str, measured: Sequence[MeasuredPoses]) -> list[str]:
    confidence = load_confidence()[Domain.ARM]
    distances = list[float]()
    angles = list[float]()
    frames = 0
    for m in measured:
        raw = m.track(confidence.frame)
        probability = np.where(raw.has_pose, confidence.track.probability(raw.features()), 0.0)
        tracked = probability >= bounds.TRACKED_CONFIDENCE
        distance, angle = pose_difference(m.X_true, raw.smooth(tracked, probability))
        distances += distance[tracked].tolist()
        angles += angle[tracked].tolist()
        frames += len(tracked)
    d = np.array(distances)
    a = np.array(angles)
    right = (d <= 0.01) & (a <= np.deg2rad(5.0))
    return [
        kind,
        str(frames),
        f"{len(d) / frames:.2f}",
        f"{right.mean():.2f}",
        f"{1e3 * np.median(d):.1f}",
        f"{1e3 * np.quantile(d, 0.95):.1f}",
        f"{np.rad2deg(np.median(a)):.1f}",
    ]
