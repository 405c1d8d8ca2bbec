import numpy as np

from kinebench_drake.formats.lerobot.writer import make_continuous


def test_quaternions_do_not_change_their_sign_along_an_episode() -> None:
    down = np.array([0.0, 0.995, 0.1, 0.0])
    w = np.array([1e-17, -1e-17, -0.01, 0.01, 0.0])
    q = np.where(w[:, None] < 0, -1.0, 1.0) * (np.outer(np.ones(5), down) + w[:, None] * [1.0, 0.0, 0.0, 0.0])
    smooth = make_continuous(q)
    assert (smooth[:, 1] > 0.9).all()
    np.testing.assert_array_equal(np.abs(smooth), np.abs(q))
