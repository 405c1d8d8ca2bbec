"""Track files: whatever is found along a track survives, in a fixed order, and older files stay readable."""

import numpy as np
import pytest

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import make_pose
from kinebench_drake.results.trackfile import read_track, write_track
from kinebench_drake.track import GripperTrack, IkStatus, JointTrack

N = 5


@pytest.fixture
def track():
    X = make_pose(np.broadcast_to(np.eye(3), (N, 3, 3)), np.arange(3 * N).reshape(N, 3))
    X[1] = np.nan
    on = np.isfinite(X[:, 0, 0])
    return GripperTrack(
        t_s=np.arange(N) * 0.2, X_CH=X, X_BG=X, tracked=on, confidence=on * 0.9, finger_width_m=np.full(N, 0.04)
    )


@pytest.fixture
def joints(track):
    q = np.arange(7.0 * N).reshape(N, 7)
    q[1] = np.nan
    return JointTrack(
        t_s=track.t_s,
        q=q,
        status=(IkStatus.OK, IkStatus.NOT_TRACKED, IkStatus.UNREACHABLE, IkStatus.JOINT_LIMIT, IkStatus.OK),
        position_error_m=np.array([0.0, np.nan, 0.1, 0.02, 0.0]),
        rotation_error_rad=np.array([0.0, np.nan, 0.2, 0.03, 0.0]),
    )


def test_curves_and_ik_statuses_round_trip_and_bytes_ignore_the_order_of_curves(tmp_path, track, joints):
    curves = {"torque": np.arange(7.0 * N).reshape(N, 7), "manipulability": np.full(N, np.nan)}
    write_track(tmp_path / "a.npz", track, joints, curves)
    write_track(tmp_path / "b.npz", track, joints, dict(reversed(curves.items())))
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    file = read_track(tmp_path / "a.npz")
    assert list(file.curves) == ["ik_position_error_m", "ik_rotation_error_rad", "manipulability", "torque"]
    for name, values in curves.items():
        np.testing.assert_array_equal(file.curves[name], values)
    np.testing.assert_array_equal(file.curves["ik_position_error_m"], joints.position_error_m)
    np.testing.assert_array_equal(file.q, joints.q)
    assert file.status == joints.status
    np.testing.assert_array_equal(file.ik_ok, joints.ok)


def test_a_track_file_without_joints_has_neither_ik_status_nor_curves(tmp_path, track):
    write_track(tmp_path / "a.npz", track, None, {})
    file = read_track(tmp_path / "a.npz")
    assert file.status is None
    assert file.curves == {}
    assert np.isnan(file.q).all()
    assert not file.ik_ok.any()
    with np.load(tmp_path / "a.npz", allow_pickle=False) as archive:
        assert {"t_s", "camera_from_hand", "base_from_tcp", "tracked", "q", "ik_ok"} <= set(archive.files)


def test_damaged_or_absent_track_files_are_refused(tmp_path, track):
    write_track(tmp_path / "a.npz", track, None, {})
    (tmp_path / "b.npz").write_bytes((tmp_path / "a.npz").read_bytes()[:200])
    for name in ("b.npz", "absent.npz"):
        with pytest.raises(InputError, match="not a track file"):
            read_track(tmp_path / name)


def test_curves_named_like_track_arrays_do_not_replace_them(tmp_path, track, joints):
    write_track(tmp_path / "a.npz", track, joints, {"q": np.zeros((N, 7)), "t_s": np.zeros(N)})
    file = read_track(tmp_path / "a.npz")
    np.testing.assert_array_equal(file.q, joints.q)
    np.testing.assert_array_equal(file.track.t_s, track.t_s)


@pytest.mark.parametrize("shape", [(), (N + 1,), (N, 6), (7, N)])
def test_curves_of_a_wrong_shape_are_refused_and_nothing_is_written(tmp_path, track, shape):
    with pytest.raises(InputError, match="torque"):
        write_track(tmp_path / "a.npz", track, None, {"torque": np.zeros(shape)})
    assert not (tmp_path / "a.npz").exists()


def test_track_files_without_ik_statuses_can_be_read(tmp_path, track):
    write_track(tmp_path / "new.npz", track, None, {"manipulability": np.ones(N)})
    with np.load(tmp_path / "new.npz") as new:
        np.savez(tmp_path / "old.npz", **{**new, "joint_margin": np.zeros(N)})
    file = read_track(tmp_path / "old.npz")
    assert file.status is None
    assert list(file.curves) == ["joint_margin", "manipulability"]
