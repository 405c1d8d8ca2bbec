import numpy as np

from kinebench_drake.geometry import Array, make_pose, pose_difference, rotation_exp
from kinebench_drake.metrics.noise import TrackNoise, smooth_poses
from kinebench_drake.track import GripperTrack
from tests.metrics.motions import gripper


def _track(X_BG: Array) -> GripperTrack:
    return gripper(0.05 * np.arange(len(X_BG)), X_BG)


def _swing(n: int = 80) -> Array:
    """A wide swing, the gripper turning by more than half a turn, so that quaternions change their sign."""
    s = np.linspace(0.0, 1.0, n)
    turn = rotation_exp(np.outer(4.0 * s, [0.2, 0.3, 0.9]))
    return make_pose(turn, np.stack([0.5 + 0.1 * np.sin(3 * s), 0.2 * s, 0.3 - 0.1 * s], axis=-1))


def test_smoothing_brings_a_noisy_track_closer_to_the_true_one() -> None:
    X = _swing()
    rng = np.random.default_rng(0)
    noisy = X.copy()
    noisy[:, :3, 3] += rng.normal(0.0, 0.003, size=(80, 3))
    noisy[:, :3, :3] = X[:, :3, :3] @ rotation_exp(rng.normal(0.0, 0.026, size=(80, 3)))
    smooth = smooth_poses(_track(noisy), TrackNoise(position_m=0.003, rotation_rad=0.026))
    for before, after in zip(pose_difference(noisy, X), pose_difference(smooth, X), strict=True):
        assert np.median(after) < 0.6 * np.median(before)
        assert after.max() < before.max()


def test_smoothing_changes_no_track_without_noise_and_leaves_gaps() -> None:
    X = _swing()
    X[20:25] = np.nan
    smooth = smooth_poses(_track(X), TrackNoise(position_m=0.0, rotation_rad=0.0))
    np.testing.assert_allclose(smooth, X, atol=1e-12)
    assert np.isnan(smooth[20:25]).all()
