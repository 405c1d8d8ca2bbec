"""npz files: what goes in comes out, and each broken file is one line."""

import zipfile

import numpy as np
import pytest

from kinebench_drake.errors import InputError, UnmeasurableError
from kinebench_drake.formats.trajectories.reading import Reading, TrajectoryOptions
from kinebench_drake.formats.trajectories.source import find_trajectories, read_trajectory
from kinebench_drake.results.trackfile import write_track
from kinebench_drake.track import GripperTrack


def read(path, rate_hz=None, **keys):
    chosen = TrajectoryOptions(rate_hz=rate_hz, reading=Reading(**keys) if keys else None)
    (sample,) = find_trajectories(path, chosen)
    return read_trajectory(sample, chosen)


def test_poses_round_trip_through_an_npz_file(archive, t_s, X_BG):
    found = read(archive(t_s=t_s, base_from_tcp=X_BG, finger_width_m=np.full(len(t_s), 0.03)))
    np.testing.assert_array_equal(found.t_s, t_s)
    np.testing.assert_allclose(found.X_BG, X_BG, atol=1e-15)
    assert (found.q, found.columns, found.warnings) == (None, "base_from_tcp: matrix_rows", ())
    assert found.tracked.all()
    assert set(found.finger_width_m) == {0.03}


def test_joint_angles_round_trip_through_an_npz_file(archive, t_s, q):
    found = read(archive(t_s=t_s, q=q))
    np.testing.assert_array_equal(found.q, q)
    assert (found.X_BG, found.columns, found.warnings) == (None, "q: joints", ())
    assert np.isnan(found.finger_width_m).all()


def test_joint_angles_have_precedence_over_poses_unless_a_reading_names_the_array(archive, t_s, q, X_BG):
    path = archive(t_s=t_s, q=q, base_from_tcp=X_BG, other=X_BG + 0.0)
    assert read(path).columns == "q: joints"
    assert read(path, columns="other").X_BG is not None
    with pytest.raises(InputError, match=r"'nope' is no column and no number; found t_s; q \(7\)"):
        read(path, columns="nope", layout="joints")


def test_a_track_of_an_output_folder_is_judged_by_its_poses(tmp_path, t_s, X_BG):
    tracked = np.arange(len(t_s)) % 3 != 1
    X = np.where(tracked[:, None, None], X_BG, np.nan)
    track = GripperTrack(
        t_s=t_s,
        X_CH=X,
        X_BG=X,
        tracked=tracked,
        confidence=tracked * 0.9,
        finger_width_m=np.where(tracked, 0.04, np.nan),
    )
    write_track(tmp_path / "a.npz", track, None, {})
    found = read(tmp_path / "a.npz")
    assert found.q is None
    np.testing.assert_array_equal(found.tracked, tracked)
    np.testing.assert_array_equal(found.t_s, t_s)
    np.testing.assert_allclose(found.X_BG, X, atol=1e-15)
    np.testing.assert_array_equal(found.finger_width_m, track.finger_width_m)


def test_the_rate_option_replaces_the_times_of_the_file(archive, q):
    np.testing.assert_array_equal(read(archive(q=q), rate_hz=10.0).t_s, np.arange(len(q)) / 10.0)
    with pytest.raises(InputError, match=r"no times t_s; add them, or give .rate_hz HZ"):
        read(archive(q=q))


@pytest.mark.parametrize(("rate_hz", "decimals"), [(240, 3), (30, 3), (3000, 6)])
def test_rounded_even_times_are_made_even(archive, q, rate_hz, decimals):
    times = np.arange(len(q)) / rate_hz
    found = read(archive(t_s=times.round(decimals), q=q)).t_s
    assert np.ptp(np.diff(found)) < 1e-12
    gap = np.delete(np.arange(len(q) + 1), 3) / rate_hz
    np.testing.assert_array_equal(read(archive(t_s=gap.round(decimals), q=q)).t_s, gap.round(decimals))
    single = (100 + times).astype(np.float32).astype(float)
    assert rate_hz > 1000 or np.ptp(np.diff(read(archive(t_s=single, q=q)).t_s)) < 1e-12


def test_even_times_in_single_precision_are_made_even(archive, q):
    times = np.arange(len(q)) / 30.0 + 200.0
    steps = np.diff(read(archive(t_s=times.astype(np.float32), q=q)).t_s)
    assert np.ptp(np.diff(times.astype(np.float32))) > 1e-6
    assert np.ptp(steps) < 1e-12
    np.testing.assert_allclose(steps, 1 / 30.0, rtol=1e-5)


def test_unix_times_are_shifted_to_start_at_0_with_a_warning(archive, t_s, q):
    found = read(archive(t_s=1.7e9 + t_s, q=q))
    assert found.t_s[0] == 0.0
    assert "shifted" in found.warnings[0]


def damaged(tmp_path, archive, t_s, q, kind):
    path = archive(t_s=t_s, q=q)
    if kind == "empty":
        path.write_bytes(b"")
    elif kind == "text":
        path.write_text("not a zip")
    elif kind == "cut":
        path.write_bytes(path.read_bytes()[:-200])
    elif kind == "npy":
        with path.open("wb") as file:
            np.save(file, q)
    elif kind == "pickled":
        np.savez(path, t_s=t_s, q=np.array([{"a": 1}] * len(t_s), dtype=object), allow_pickle=True)
    elif kind == "flipped":
        data = bytearray(path.read_bytes())
        data[len(data) // 3] ^= 0xFF
        path.write_bytes(data)
    elif kind == "no header":
        with zipfile.ZipFile(path, "w") as raw:
            raw.writestr("t_s.npy", b"garbage")
            raw.writestr("q.npy", b"garbage")
    return path


@pytest.mark.parametrize(
    ("kind", "told"),
    [
        ("empty", r"empty \(0 bytes\)"),
        ("text", "not a complete zip archive"),
        ("cut", "not a complete zip archive"),
        ("npy", "not a complete zip archive"),
        ("pickled", "pickled Python objects, which are never loaded"),
        ("flipped", "not a readable npz archive"),
        ("no header", "not a readable npz archive"),
    ],
)
def test_damaged_files_are_refused_in_one_line(tmp_path, archive, t_s, q, kind, told):
    with pytest.raises(InputError, match=told) as caught:
        read(damaged(tmp_path, archive, t_s, q, kind))
    assert "\n" not in str(caught.value)
    assert str(tmp_path) not in str(caught.value)


def test_an_archive_of_images_is_refused(archive):
    with pytest.raises(InputError, match="no column is known to hold seven joint angles or a pose; found no column"):
        read(archive(frames=np.zeros((3, 8, 8, 3), dtype=np.uint8)))


def test_a_trajectory_of_a_single_frame_is_unmeasurable(archive):
    with pytest.raises(UnmeasurableError, match="1 frame, a path needs at least 2"):
        read(archive(t_s=np.zeros(1), q=np.zeros((1, 7))))
