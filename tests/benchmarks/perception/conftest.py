"""Small synthetic clips: a dark square moves over noise, and a hand; nothing is rendered, nothing learned."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.perception.clip import TruthClip
from benchmarks.perception.errors import ClipErrors, compare
from kinebench_drake.anomaly import Anomaly, AnomalyKind
from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.formats.camerafile import save_camera
from kinebench_drake.geometry import Array, make_pose, rotation_exp
from kinebench_drake.grounding.anomaly.detection import AnomalyDetections, Detection
from kinebench_drake.grounding.pipeline import PipelineResult
from kinebench_drake.grounding.priors import InitialStateUse
from kinebench_drake.io.container import write_video
from kinebench_drake.track import Domain, GripperTrack

FRAMES = 12
SIDE = 96


@pytest.fixture(scope="session")
def camera() -> Camera:
    return benchmark_camera().resized(SIDE, SIDE)


@pytest.fixture
def truth() -> Array:
    """Poses (12, 4, 4) of a hand that moves sideways."""
    R = rotation_exp(np.linspace(0, 0.3, FRAMES)[:, None] * [0.0, 0.0, 1.0]) @ np.diag([1.0, -1.0, -1.0])
    return make_pose(R, np.stack([np.linspace(-0.1, 0.1, FRAMES), np.zeros(FRAMES), np.full(FRAMES, 0.7)], axis=1))


@pytest.fixture
def clip(camera: Camera, truth: Array) -> TruthClip:
    return TruthClip(
        id="Some-v1_s0",
        task="Some-v1",
        path=Path("none.mp4"),
        camera=camera,
        t_s=0.2 * np.arange(FRAMES),
        X_CH=truth,
        finger_width_m=np.where(np.arange(FRAMES) < 6, 0.08, 0.04),
        depth_m=None,
        mask=None,
        faults=(),
    )


@pytest.fixture
def grounded() -> Callable[..., PipelineResult]:
    """A grounding that says so much."""

    def make(clip: TruthClip, X_CH: Array, tracked: Array | None = None, confidence: float = 0.9) -> PipelineResult:
        n = len(clip.t_s)
        tracked = np.ones(n, dtype=bool) if tracked is None else tracked.astype(bool)
        X_CH = np.where(tracked[:, None, None], X_CH, np.nan)
        track = GripperTrack(
            t_s=clip.t_s,
            X_CH=X_CH,
            X_BG=X_CH,
            tracked=tracked,
            confidence=np.full(n, confidence),
            finger_width_m=np.where(tracked, clip.finger_width_m, np.nan),
        )
        return PipelineResult(
            track=track,
            from_prior=np.zeros(n, dtype=bool),
            first_frame=InitialStateUse.UNKNOWN,
            domain=Domain.FAMILIAR,
            detections=AnomalyDetections(by_kind={k: Detection(kind=k, score=np.zeros(n)) for k in AnomalyKind}),
            camera_motion_px=None,
            arm_consistency_px=None,
            wide=(),
        )

    return make


@pytest.fixture
def errors(clip: TruthClip, grounded: Callable[..., PipelineResult]) -> Callable[..., ClipErrors]:
    """The errors of a track that is off by an offset [m], tracked where told."""

    def make(
        offset_m: float = 0.0,
        *,
        tracked: Array | None = None,
        confidence: float = 0.9,
        faults: tuple[Anomaly, ...] = (),
        gone: slice | None = None,
        share: float = 1.0,
        id: str = "Some-v1_s0",
    ) -> ClipErrors:
        X_CH = clip.X_CH.copy()
        true = clip.X_CH.copy()
        X_CH[:, 1, 3] += offset_m
        if gone is not None:
            true[gone] = np.nan
        planted = replace(clip, X_CH=true, faults=faults, id=id)
        return compare(planted, grounded(clip, X_CH, tracked, confidence), 0.5, np.full(FRAMES, share))

    return make


@pytest.fixture
def square() -> tuple[np.ndarray, np.ndarray]:
    """Frames (12, 96, 96, 3) with a dark square of 30 px that moves 2 px a frame, and its masks."""
    rng = np.random.default_rng(0)
    background = np.kron(rng.integers(90, 200, (12, 12, 3)), np.ones((8, 8, 1)))
    frames = np.empty((FRAMES, SIDE, SIDE, 3), np.uint8)
    masks = np.zeros((FRAMES, SIDE, SIDE), dtype=bool)
    for i in range(FRAMES):
        masks[i, 30:60, 20 + 2 * i : 50 + 2 * i] = True
        frames[i] = np.where(masks[i][..., None], 40 + 30 * (np.arange(SIDE) % 7 < 3)[None, :, None], background)
    return frames, masks


@pytest.fixture
def folder(tmp_path: Path, clip: TruthClip, square: tuple[np.ndarray, np.ndarray]) -> Path:
    """A folder of three clips of two tasks as the commands read it."""
    frames, masks = square
    (tmp_path / "truth").mkdir()
    save_camera(clip.camera, tmp_path / "camera.json")
    lines = []
    for id, task in (("A-v1_s0", "A-v1"), ("A-v1_s1", "A-v1"), ("B-v1_s0", "B-v1")):
        write_video(tmp_path / f"{id}.mp4", frames, 17.0)
        np.savez_compressed(
            tmp_path / "truth" / f"{id}.npz",
            t_s=clip.t_s,
            camera_from_hand=clip.X_CH,
            finger_width_m=clip.finger_width_m,
            depth_mm=np.where(masks, 700, 0).astype(np.uint16),
            mask=np.packbits(masks, axis=-1),
        )
        lines.append(json.dumps({"video": f"{id}.mp4", "id": id, "task": task}))
    (tmp_path / "manifest.jsonl").write_text("\n".join(lines) + "\n")
    return tmp_path
