import numpy as np

from kinebench_drake.geometry import Array, make_pose, pose_difference, rotation_exp
from kinebench_drake.grounding.smoothing import smooth_track

FRAMES = 40
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


def test_noise_shrinks_and_the_motion_stays() -> None:
    X = motion()
    Y = noisy(X, 0.004)
    Z = smooth_track(Y, EQUAL, np.ones(len(X)))
    for before, after in zip(pose_difference(X, Y), pose_difference(X, Z), strict=True):
        assert np.sqrt((after**2).mean()) < 0.75 * np.sqrt((before**2).mean())
    assert pose_difference(X, smooth_track(X, EQUAL, np.ones(len(X))))[0].max() < 1e-3


def test_one_wild_frame_is_pulled_back() -> None:
    X = motion()
    Y = noisy(X, 0.001)
    Y[20, :3, 3] += 0.08
    assert pose_difference(X, smooth_track(Y, EQUAL, np.ones(len(X))))[0][20] < 0.01


def test_jumps_are_kept_and_gaps_stay_open() -> None:
    X = motion()
    X[25:, :3, 3] += 0.15
    X[10] = np.nan
    Z = smooth_track(X, EQUAL, np.ones(len(X)), [25])
    assert np.isnan(Z[10]).all()
    assert np.isfinite(np.delete(Z, 10, axis=0)).all()
    assert np.linalg.norm(Z[25, :3, 3] - Z[24, :3, 3]) > 0.14
    assert np.nanmax(pose_difference(X, Z)[0]) < 2e-3


def test_neighbours_alone_tell_a_wild_frame_from_a_good_one() -> None:
    X = motion()
    Y = noisy(X, 0.001)
    Y[20, :3, 3] += 0.08
    told = smooth_track(Y, EQUAL, np.ones(len(X)), leave_out=True)
    distance = pose_difference(Y, told)[0]
    assert distance[20] > 0.06
    assert np.nanmedian(distance) < 0.005
    assert np.isnan(smooth_track(X[:4], EQUAL[:4], np.ones(4), leave_out=True)).all()


def test_what_a_frame_knows_well_is_listened_to() -> None:
    X = motion()
    rng = np.random.default_rng(0)
    far = np.where(rng.random(FRAMES) < 0.5, 0.012, 0.0005)  # some frames see badly how far away the hand is
    Y = X.copy()
    Y[:, 2, 3] += far * rng.normal(size=FRAMES)
    covariance = np.zeros((FRAMES, 6, 6))
    covariance[:, 5, 5] = far**2
    told, untold = (smooth_track(Y, c, np.ones(FRAMES)) for c in (covariance, EQUAL))
    error = [np.sqrt((pose_difference(X, Z)[0] ** 2).mean()) for Z in (told, untold)]
    assert error[0] < 0.6 * error[1]
