"""Smoothing of poses, and which poses it starts from."""

from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.anomaly import Anomaly, AnomalyKind
from kinebench_drake.geometry import Array, make_pose, pose_difference, rotation_exp
from kinebench_drake.grounding.tracking.pose import FramePose
from kinebench_drake.grounding.tracking.smoothing import RawTrack, smooth_track
from kinebench_drake.models.panda.cad import GripperCad
from kinebench_drake.segments import frame_periods
from tests.grounding.conftest import fitted_pose, hand_pose, perfect_view

FRAMES = 40
N_RAW = 12
EQUAL = np.zeros((FRAMES, 6, 6))


def motion(n: int = FRAMES) -> Array:
    s = np.linspace(0, 1, n)
    p = np.stack([0.3 * s**2, 0.1 * np.sin(2 * s), 0.6 - 0.2 * s], axis=1)
    return make_pose(rotation_exp(np.stack([0.5 * s, 0.2 * s**2, np.pi + 0.8 * s], axis=1)), p)


def noisy(X: Array, sigma_m: float, seed: int = 0) -> Array:
    rng = np.random.default_rng(seed)
    step = make_pose(rotation_exp(rng.normal(0, 10 * sigma_m, (len(X), 3))), np.zeros((len(X), 3)))
    Y = X @ step
    Y[:, :3, 3] += rng.normal(0, sigma_m, (len(X), 3))
    return Y


def test_smoothing_reduces_noise_and_keeps_a_clean_motion() -> None:
    X = motion()
    Y = noisy(X, 0.004)
    Z = smooth_track(Y, EQUAL, np.ones(len(X)))
    for before, after in zip(pose_difference(X, Y), pose_difference(X, Z), strict=True):
        assert np.sqrt((after**2).mean()) < 0.75 * np.sqrt((before**2).mean())
    assert pose_difference(X, smooth_track(X, EQUAL, np.ones(len(X))))[0].max() < 1e-3


@pytest.mark.parametrize("dropped", [1, 3, 5])
def test_dropped_frames_of_a_video_with_time_stamps_do_not_bend_the_path(dropped: int) -> None:
    kept = np.delete(np.arange(FRAMES), np.arange(20, 20 + dropped))
    X = motion()[kept]
    place = frame_periods(0.1 * kept)
    smoothed = smooth_track(X, EQUAL[kept], np.ones(len(X)), place=place)
    assert pose_difference(X, smoothed)[0].max() < 1e-3
    even = smooth_track(X, EQUAL[kept], np.ones(len(X)), place=frame_periods(0.1 * np.arange(len(X))))
    np.testing.assert_array_equal(even, smooth_track(X, EQUAL[kept], np.ones(len(X))))


def test_a_single_outlier_frame_is_pulled_back_to_the_path() -> None:
    X = motion()
    Y = noisy(X, 0.001)
    Y[20, :3, 3] += 0.08
    assert pose_difference(X, smooth_track(Y, EQUAL, np.ones(len(X))))[0][20] < 0.01


def test_smoothing_keeps_jumps_and_leaves_gaps_open() -> None:
    X = motion()
    X[25:, :3, 3] += 0.15
    X[10] = np.nan
    Z = smooth_track(X, EQUAL, np.ones(len(X)), [25])
    assert np.isnan(Z[10]).all()
    assert np.isfinite(np.delete(Z, 10, axis=0)).all()
    assert np.linalg.norm(Z[25, :3, 3] - Z[24, :3, 3]) > 0.14
    assert np.nanmax(pose_difference(X, Z)[0]) < 2e-3


def test_predictions_from_neighbours_expose_outliers() -> None:
    X = motion()
    Y = noisy(X, 0.001)
    Y[20, :3, 3] += 0.08
    predicted = smooth_track(Y, EQUAL, np.ones(len(X)), leave_out=True)
    distance = pose_difference(Y, predicted)[0]
    assert distance[20] > 0.06
    assert np.nanmedian(distance) < 0.005
    assert np.isnan(smooth_track(X[:4], EQUAL[:4], np.ones(4), leave_out=True)).all()


def test_directions_with_smaller_covariance_have_more_weight() -> None:
    X = motion()
    rng = np.random.default_rng(0)
    far = np.where(rng.random(FRAMES) < 0.5, 0.012, 0.0005)  # some frames see badly how far away the hand is
    Y = X.copy()
    Y[:, 2, 3] += far * rng.normal(size=FRAMES)
    covariance = np.zeros((FRAMES, 6, 6))
    covariance[:, 5, 5] = far**2
    weighted, unweighted = (smooth_track(Y, c, np.ones(FRAMES)) for c in (covariance, EQUAL))
    error = [np.sqrt((pose_difference(X, Z)[0] ** 2).mean()) for Z in (weighted, unweighted)]
    assert error[0] < 0.6 * error[1]


@pytest.fixture(scope="module")
def pose(cad: GripperCad) -> FramePose:
    return fitted_pose(perfect_view(cad, hand_pose(1)))


def made(pose: FramePose, confidence: np.ndarray, anomalies: tuple[Anomaly, ...] = (), **known: np.ndarray) -> RawTrack:
    return RawTrack.from_poses(
        [None if c == 0.0 else pose for c in confidence],
        confidence,
        anomalies,
        known.get("lost", np.zeros(N_RAW, dtype=bool)),
        known.get("X_prior", np.full((N_RAW, 4, 4), np.nan)),
        0.2 * np.arange(N_RAW),
    )


def test_doubtful_vanished_and_lost_frames_have_no_pose(pose: FramePose) -> None:
    confidence = np.full(N_RAW, 0.9)
    confidence[[0, 1]] = 0.0, 0.01
    gone = Anomaly(kind=AnomalyKind.VANISH, frame_start=4, frame_end=6, severity=3.0)
    lost = np.arange(N_RAW) == 9
    assert np.flatnonzero(made(pose, confidence, (gone,), lost=lost).has_pose).tolist() == [2, 3, 7, 8, 10, 11]


def test_nothing_is_smoothed_across_a_jump(pose: FramePose) -> None:
    jump = Anomaly(kind=AnomalyKind.TELEPORT, frame_start=6, frame_end=6, severity=0.1)
    raw = made(pose, np.full(N_RAW, 0.9), (jump,))
    X_AH = raw.X_AH.copy()
    X_AH[6:, 0, 3] += 0.1
    smooth = replace(raw, X_AH=X_AH).smooth(np.ones(N_RAW, dtype=bool), raw.confidence)
    np.testing.assert_allclose(smooth, X_AH, atol=1e-9)


def test_poses_from_priors_are_certain_and_kept_exactly(pose: FramePose) -> None:
    X_prior = np.full((N_RAW, 4, 4), np.nan)
    X_prior[3] = pose.X_CH
    X_prior[3, :3, 3] += 0.05
    confidence = np.full(N_RAW, 0.9)
    confidence[3] = 0.0
    raw = made(pose, confidence, X_prior=X_prior)
    assert raw.from_prior.nonzero()[0].tolist() == [3]
    assert raw.confidence[3] == 1.0
    np.testing.assert_array_equal(raw.smooth(raw.has_pose, raw.confidence)[3], X_prior[3])


def test_the_distance_feature_is_largest_at_a_frame_that_deviates_from_its_neighbours(pose: FramePose) -> None:
    raw = made(pose, np.full(N_RAW, 0.9))
    X_AH = raw.X_AH.copy()
    X_AH[6, :3, 3] += 0.1
    distance = replace(raw, X_AH=X_AH).features()[:, 1]
    assert distance.argmax() == 6
    assert distance[6] == pytest.approx(np.log(np.sqrt(3) * 0.1 / 0.01), abs=0.1)


def test_a_doubtful_pose_counts_only_on_the_path_of_tracked_frames_on_both_sides() -> None:
    X = motion()
    X[20, :3, 3] += 0.01  # near the path
    X[30, :3, 3] += 0.05  # off it
    tracked = np.ones(FRAMES, dtype=bool)
    tracked[[1, 20, 30]] = False
    raw = RawTrack(
        X_AH=X,
        covariance=EQUAL + 1e-6 * np.eye(6),
        confidence=np.where(tracked, 0.9, 0.2),
        from_prior=np.zeros(FRAMES, dtype=bool),
        breaks=(),
        place=np.arange(FRAMES, dtype=np.float64),
    )
    assert np.flatnonzero(raw.on_path(tracked)).tolist() == [20]
    assert not replace(raw, breaks=(20,)).on_path(tracked).any()
    tracked[17:20] = False
    assert not raw.on_path(tracked)[20]
