"""Each kind of invalid number is refused in one line that names the frame, or repaired with a warning."""

import re

import numpy as np
import pytest

from kinebench_drake.errors import InputError, UnmeasurableError
from kinebench_drake.formats.trajectories.check import MAX_FRAMES, check
from kinebench_drake.formats.trajectories.trajectory import RawTrajectory
from kinebench_drake.geometry import pose_difference, rotation_exp


def recording(**arrays):
    return RawTrajectory(**{"t_s": None, "columns": "test", **arrays})


def told(error, **arrays):
    with pytest.raises(error) as caught:
        check(recording(**arrays))
    message = str(caught.value)
    assert "\n" not in message
    return message


def changed(array, index, value):
    array = np.array(array, dtype=np.float64)
    array[index] = value
    return array


@pytest.mark.parametrize("shape", [(12,), (12, 6), (12, 10), (7, 12), (12, 7, 1), ()])
def test_joint_angles_of_a_wrong_shape_are_refused(t_s, shape):
    message = told(InputError, t_s=t_s, q=np.zeros(shape))
    assert f"q has shape {shape}, expected (T, 7)" in message
    assert ("transposed?" in message) is (shape[:1] == (7,))


@pytest.mark.parametrize("shape", [(12, 3, 4), (12, 16), (4, 4), (4, 4, 12)])
def test_poses_of_a_wrong_shape_are_refused(t_s, shape):
    assert f"base_from_tcp has shape {shape}, expected (T, 4, 4)" in told(InputError, t_s=t_s, X_BG=np.zeros(shape))


def test_arrays_of_different_lengths_are_refused(t_s, q, X_BG):
    assert "t_s has shape (11,), but there are 12 frames" in told(InputError, t_s=t_s[1:], q=q)
    assert "t_s has shape (12, 1)" in told(InputError, t_s=t_s[:, None], X_BG=X_BG)
    assert "finger_width_m has shape (3,)" in told(InputError, t_s=t_s, q=q, finger_width_m=np.zeros(3))
    assert "tracked has shape (3,)" in told(InputError, t_s=t_s, q=q, tracked=np.ones(3, dtype=bool))


@pytest.mark.parametrize("dtype", [complex, "U3", bool])
def test_arrays_of_complex_text_or_boolean_values_are_refused(t_s, dtype):
    assert "expected real numbers" in told(InputError, t_s=t_s, q=np.zeros((12, 7)).astype(dtype))


def test_too_few_frames_are_unmeasurable_and_too_many_are_refused(t_s):
    for nothing in ({"q": np.zeros((0, 7))}, {"q": np.zeros(0)}, {"X_BG": np.zeros((0, 4, 4))}):
        assert "holds no frame" in told(UnmeasurableError, t_s=np.zeros(0), **nothing)
    assert "1 frame" in told(UnmeasurableError, t_s=t_s[:1], q=np.zeros((1, 7)))
    n = MAX_FRAMES + 1
    assert f"has {n} frames, at most {MAX_FRAMES}" in told(InputError, t_s=0.01 * np.arange(n), q=np.zeros((n, 7)))
    only = np.arange(12) == 5
    for given in ({"q": np.zeros((12, 7))}, {"X_BG": np.tile(np.eye(4), (12, 1, 1))}):
        assert "1 of 12 frames are tracked" in told(UnmeasurableError, t_s=t_s, tracked=only, **given)
        assert "0 of 12 frames are tracked" in told(UnmeasurableError, t_s=t_s, tracked=np.zeros(12, bool), **given)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_nan_and_infinity_are_refused_with_their_frame(t_s, q, X_BG, value):
    kind = "NaN" if np.isnan(value) else "infinity"
    assert re.search(f"joint angles of frame 4 hold {kind}", told(InputError, t_s=t_s, q=changed(q, (4, 2), value)))
    poses = changed(X_BG, (7, 0, 3), value)
    assert re.search(f"the pose of frame 7 holds {kind}", told(InputError, t_s=t_s, X_BG=poses))
    assert "the time of frame 3 is" in told(InputError, t_s=changed(t_s, 3, value), q=q)


def test_values_of_untracked_frames_are_ignored(t_s, X_BG, q):
    tracked = np.arange(12) != 7
    X = changed(X_BG, 7, np.nan)
    found = check(recording(t_s=t_s, X_BG=X, tracked=tracked))
    assert np.isnan(found.X_BG[7]).all()
    np.testing.assert_allclose(found.X_BG[tracked], X_BG[tracked], atol=1e-15)
    found = check(recording(t_s=t_s, q=changed(q, 7, 1e9), tracked=tracked.astype(np.uint8)))
    assert np.isnan(found.q[7]).all()
    np.testing.assert_array_equal(found.q[tracked], q[tracked])


def test_times_that_do_not_increase_are_refused_with_their_frame(t_s, q):
    assert "the time of frame 5 (0.1 s) is before that of frame 4 (0.2 s)" in told(
        InputError, t_s=changed(t_s, 5, 0.1), q=q
    )
    assert "the time of frame 5 (0.2 s) is the same as that of frame 4" in told(
        InputError, t_s=changed(t_s, 5, t_s[4]), q=q
    )
    assert "(and at 10 more places)" in told(InputError, t_s=t_s[::-1], q=q)


@pytest.mark.parametrize("scale", [1e300, 1e-300, 1e6, 1e-6])
def test_frame_periods_out_of_range_are_refused(t_s, q, scale):
    assert "expected 0.0001 to 1000 s" in told(InputError, t_s=t_s * scale, q=q)


def test_frames_many_seconds_apart_warn_of_milliseconds(t_s, q):
    """What 20 Hz look like in milliseconds; unless the user says that it is so."""
    (warning,) = check(recording(t_s=1000.0 * t_s, q=q)).warnings
    assert "50 s apart" in warning
    assert "milliseconds?" in warning
    assert check(recording(t_s=90.0 * t_s, q=q)).warnings == ()
    assert check(recording(t_s=1000.0 * t_s, q=q), rate_hz=0.1).warnings == ()


def test_joint_angles_beyond_one_turn_warn_of_degrees(t_s, q):
    (warning,) = check(recording(t_s=t_s, q=changed(q, (3, 4), -7.0))).warnings
    assert "joint 5 goes up to 7 rad" in warning
    assert "degrees?" in warning
    assert check(recording(t_s=t_s, q=changed(q, (3, 4), -5.5))).warnings == ()


def test_joint_angles_in_degrees_are_refused(t_s, q):
    message = told(InputError, t_s=t_s, q=np.rad2deg(q))
    assert "look like degrees" in message
    assert "pi / 180" in message
    assert "no joint angles" in told(InputError, t_s=t_s, q=1e4 * q)
    past_a_limit = changed(q, (3, 0), 3.4)
    np.testing.assert_array_equal(check(recording(t_s=t_s, q=past_a_limit)).q, past_a_limit)  # judged, not refused


def test_positions_in_millimetres_are_refused(t_s, X_BG):
    X = X_BG.copy()
    X[:, :3, 3] *= 1000.0
    message = told(InputError, t_s=t_s, X_BG=X)
    assert "look like millimetres" in message
    assert "frame 11" in message


@pytest.mark.parametrize("columns", [8, 9])
def test_finger_joints_after_the_arm_joints_become_the_finger_width(t_s, q, columns):
    found = check(recording(t_s=t_s, q=np.hstack([q, np.full((12, columns - 7), 0.02)])))
    np.testing.assert_array_equal(found.q, q)
    assert f"q has {columns} columns: the first 7" in found.warnings[0]
    np.testing.assert_allclose(found.finger_width_m, 0.04 if columns == 9 else np.nan)


def test_nearly_orthonormal_rotations_are_orthonormalized_with_a_warning(t_s, X_BG):
    X = X_BG.copy()
    X[3, :3, :3] *= 1.0 + 2e-4
    found = check(recording(t_s=t_s, X_BG=X))
    assert max(d.max() for d in pose_difference(found.X_BG, X_BG)) < 1e-6
    assert re.search(r"1 rotations, off by up to 4\.0e-04, were made orthonormal", found.warnings[0])
    single = check(recording(t_s=t_s, X_BG=X_BG.astype(np.float32)))
    assert single.warnings == ()
    R = single.X_BG[:, :3, :3]
    assert np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max() < 1e-14


def test_poses_that_are_not_rigid_are_refused_with_their_frame(t_s, X_BG):
    X = X_BG.copy()
    X[3, :3, :3] *= 1.001
    assert "rotation of frame 3 is not orthonormal: R^T R is off the identity by 0.002" in told(
        InputError, t_s=t_s, X_BG=X
    )
    X = X_BG.copy()
    X[5, :3, 0] *= -1.0
    assert "rotation of frame 5 is left-handed (determinant -1.000)" in told(InputError, t_s=t_s, X_BG=X)
    assert "frame 0 is not orthonormal" in told(InputError, t_s=t_s, X_BG=np.zeros_like(X_BG) + np.diag([0, 0, 0, 1]))
    assert "transposed" in told(InputError, t_s=t_s, X_BG=np.swapaxes(X_BG, 1, 2))
    assert "last row of the pose of frame 2 is 0, 0, 0, 2" in told(
        InputError, t_s=t_s, X_BG=changed(X_BG, (2, 3, 3), 2)
    )


@pytest.mark.parametrize("value", [1e300, -1e308])
def test_values_near_overflow_are_refused_without_numpy_warnings(t_s, X_BG, q, value, recwarn):
    assert "frame 3 is not orthonormal" in told(InputError, t_s=t_s, X_BG=changed(X_BG, (3, 0), value))
    assert "look like millimetres" in told(InputError, t_s=t_s, X_BG=changed(X_BG, (3, 0, 3), value))
    assert "no joint angles" in told(InputError, t_s=t_s, q=changed(q, (3, 0), value))
    told(InputError, t_s=changed(changed(t_s, 0, -value), 3, value), q=q)
    assert not recwarn.list


def test_orthonormalization_yields_the_nearest_rotation(t_s, X_BG):
    """Of all rotations near the repaired one none is nearer to what was given."""
    rng = np.random.default_rng(3)
    X = X_BG.copy()
    X[0, :3, :3] += 1e-4 * rng.normal(size=(3, 3))
    R = check(recording(t_s=t_s, X_BG=X)).X_BG[0, :3, :3]
    least = np.linalg.norm(R - X[0, :3, :3])
    others = R @ rotation_exp(1e-4 * rng.normal(size=(200, 3)))
    assert (np.linalg.norm(others - X[0, :3, :3], axis=(1, 2)) >= least).all()


def test_finger_widths_are_clipped_near_their_range_and_ignored_beyond(t_s, q):
    def width(value):
        return check(recording(t_s=t_s, q=q, finger_width_m=np.full(12, value)))

    assert set(width(0.05).finger_width_m) == {0.05}
    assert set(width(0.0803).finger_width_m) == {0.08}
    assert set(width(-0.001).finger_width_m) == {0.0}
    assert np.isnan(width(np.nan).finger_width_m).all()
    for wrong in (40.0, -0.5):
        found = width(wrong)
        assert np.isnan(found.finger_width_m).all()
        assert "ignored" in found.warnings[0]
