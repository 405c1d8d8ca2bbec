"""Degradation of held-out videos, and the confidence fitted to them."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.perception.clip import find_clips
from benchmarks.perception.store import MeasurementStore
from kinebench_drake.geometry import make_pose
from kinebench_drake.grounding.tracking.pose import FRAME_FEATURES
from kinebench_drake.io.reader import read_video
from kinebench_drake.models.panda.cad import GripperCad
from kinebench_drake.track import Domain
from training.calibration import (
    MeasuredPoses,
    VideoDegradation,
    degrade_video,
    fit_confidence,
    wrong_camera,
)

WHOLE = find_clips(Path(__file__).parents[2] / "examples" / "videos")[0].load()
CLIP = replace(WHOLE, t_s=WHOLE.t_s[:6], X_CH=WHOLE.X_CH[:6], finger_width_m=WHOLE.finger_width_m[:6], mask=None)
FRAMES = read_video(CLIP.path).frames[:6]


@pytest.mark.parametrize("degradation", list(VideoDegradation))
def test_degraded_frames_repeat_by_seed_and_keep_their_shape(degradation: VideoDegradation) -> None:
    worse = degrade_video(FRAMES, CLIP, degradation, [0, 1])
    np.testing.assert_array_equal(worse, degrade_video(FRAMES, CLIP, degradation, [0, 1]))
    assert worse.shape == FRAMES.shape
    assert (worse == FRAMES).all() == (degradation in (VideoDegradation.NONE, VideoDegradation.CAMERA))
    if degradation in (VideoDegradation.DEGRADED, VideoDegradation.OCCLUDED):
        assert (worse != degrade_video(FRAMES, CLIP, degradation, [0, 2])).any()


def test_removing_the_gripper_changes_only_pixels_of_its_mask(cad: GripperCad) -> None:
    changed = (degrade_video(FRAMES, CLIP, VideoDegradation.ABSENT, [0, 1]) != FRAMES).any(axis=-1)
    for frame, gripper in zip(changed, CLIP.masks(cad), strict=True):
        assert frame[gripper].mean() > 0.9
        near = cv2.dilate(gripper.astype(np.uint8), np.ones((11, 11), np.uint8)) > 0
        assert not frame[~near].any()


def test_a_wrong_camera_differs_in_its_focal_length_alone() -> None:
    for number in range(20):
        camera = wrong_camera(CLIP.camera, [0, number])
        factor = camera.fx / CLIP.camera.fx
        assert camera.fy / CLIP.camera.fy == pytest.approx(factor)
        assert 0.049 < abs(np.log(factor)) < 0.301
        np.testing.assert_array_equal(camera.X_BC, CLIP.camera.X_BC)


def drawn_video(rng: np.random.Generator, frames: int = 30) -> MeasuredPoses:
    """Steady motion in which poses are off by centimetres where the first feature is low."""
    t = np.arange(frames, dtype=np.float64)[:, None]
    p = np.array([0.0, 0.0, 1.0]) + 0.01 * t * rng.normal(size=3)
    X_true = np.stack([make_pose(np.eye(3), row) for row in p])
    features = rng.normal(size=(frames, len(FRAME_FEATURES[Domain.UNFAMILIAR])))
    X_AH = X_true.copy()
    X_AH[features[:, 0] < -0.5, :3, 3] += rng.uniform(0.02, 0.05, 3)
    features[:, 0] *= 4.0
    features[-1] = np.nan
    X_AH[-1] = np.nan
    covariance = np.tile(1e-6 * np.eye(6), (frames, 1, 1))
    return MeasuredPoses(domain=Domain.UNFAMILIAR, features=features, X_AH=X_AH, covariance=covariance, X_true=X_true)


def test_a_fitted_confidence_separates_right_from_wrong_poses() -> None:
    rng = np.random.default_rng(0)
    confidence = fit_confidence([drawn_video(rng) for _ in range(30)])
    for other in (drawn_video(rng) for _ in range(5)):
        frame = other.track(confidence.frame).confidence
        good = other.good(other.X_AH)
        assert frame[good].mean() > 0.85
        assert frame[~good].mean() < 0.25
        assert frame[-1] == 0.0


def test_measured_poses_survive_json(tmp_path: Path) -> None:
    before = drawn_video(np.random.default_rng(1), 7)
    store = MeasurementStore(tmp_path / "kept.jsonl", MeasuredPoses)
    store.put("a", before)
    after = MeasurementStore(tmp_path / "kept.jsonl", MeasuredPoses)["a"]
    assert after.domain is before.domain
    for name in ("features", "X_AH", "covariance", "X_true"):
        np.testing.assert_allclose(getattr(after, name), getattr(before, name), rtol=1e-6)


def test_occluders_are_static() -> None:
    worse = degrade_video(FRAMES, CLIP, VideoDegradation.OCCLUDED, [0, 1])
    changed = (worse != FRAMES).any(axis=(0, 3))
    assert 0.002 < changed.mean() < 0.5
    np.testing.assert_array_equal(worse[0][changed], worse[5][changed])
