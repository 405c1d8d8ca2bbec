"""csv files."""

import numpy as np
import pytest

from kinebench_drake.errors import InputError, UnmeasurableError
from kinebench_drake.formats.trajectories.reading import Reading, TrajectoryOptions
from kinebench_drake.formats.trajectories.source import find_trajectories, read_trajectory

POSE = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
JOINTS = tuple(f"q{j}_rad" for j in range(1, 8))


def read(path, rate_hz=None, **keys):
    options = TrajectoryOptions(rate_hz=rate_hz, reading=Reading(**keys) if keys else None)
    [sample] = find_trajectories(path, options)
    return read_trajectory(sample, options)


@pytest.fixture
def poses(t_s, X_BG, quaternion):
    return np.column_stack([t_s, X_BG[:, :3, 3], quaternion])


def test_poses_are_read_in_any_order_of_columns(csv_file, t_s, X_BG, poses):
    order = np.random.default_rng(0).permutation(8)
    header = np.array(["t_s", *POSE])
    found = read(csv_file(header[order], poses[:, order]))
    np.testing.assert_array_equal(found.t_s, t_s)
    np.testing.assert_allclose(found.X_BG, X_BG, atol=1e-12)
    assert (found.warnings, found.columns) == ((), "x_m, y_m, z_m, qw, qx, qy, qz: quaternion_wxyz")


def test_joint_angles_are_read_among_columns_of_text(csv_file, t_s, q):
    rows = [[*row, f"note {k}", 0.02] for k, row in enumerate(np.column_stack([t_s, q]))]
    found = read(csv_file(["t_s", *JOINTS, "comment", "finger_width_m"], rows))
    np.testing.assert_array_equal(found.q, q)
    assert set(found.finger_width_m) == {0.02}
    assert found.warnings == ()


def test_joint_angles_have_precedence_over_poses(csv_file, poses, q):
    path = csv_file(["t_s", *POSE, *JOINTS], np.hstack([poses, q]))
    assert read(path).q is not None
    assert read(path, layout="quaternion_wxyz").X_BG is not None


def test_quaternions_are_normalized_near_norm_1_and_refused_beyond(csv_file, X_BG, poses):
    near = poses.copy()
    far = poses.copy()
    flipped = poses.copy()
    near[4, 4:] *= 1.0005
    found = read(csv_file(["t_s", *POSE], near))
    np.testing.assert_allclose(found.X_BG, X_BG, atol=1e-12)
    assert "1 quaternions, off by up to 5.0e-04" in found.warnings[0]
    far[4, 4:] *= 1.01
    with pytest.raises(InputError, match=r"quaternion of frame 4 has norm 1\.01, expected 1"):
        read(csv_file(["t_s", *POSE], far))
    far[4, 4:] = 0.0
    with pytest.raises(InputError, match="quaternion of frame 4 has norm 0"):
        read(csv_file(["t_s", *POSE], far))
    flipped[::2, 4:] *= -1.0
    np.testing.assert_allclose(read(csv_file(["t_s", *POSE], flipped)).X_BG, X_BG, atol=1e-12)


def test_positions_in_millimetres_are_refused(csv_file, poses):
    poses[:, 1:4] *= 1000.0
    with pytest.raises(InputError, match="look like millimetres"):
        read(csv_file(["t_s", *POSE], poses))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", r"empty \(0 bytes\)"),
        ("\n\n", "found no column of numbers"),
        ("a,b\n1,2\n", "no column is known .*; found a; b"),
        ("t_s,q1_rad,q2_rad\n", "found t_s; q1_rad; q2_rad"),
        (",".join(["t_s", "t_s", *JOINTS]) + "\n", "names t_s more than once"),
        (",".join(["t_s", *JOINTS]) + "\n0,1,2,3\n", "line 2 has 4 fields, the header 8"),
        (
            ",".join(["t_s", *JOINTS]) + "\n0,1,2,3,4,5,6,7\n1,1,2,x,4,5,6,7\n",
            "line 3: q3_rad is 'x', expected a number",
        ),
        (",".join(["t_s", *JOINTS]) + "\n0,1,2,,4,5,6,7\n", "line 2: q3_rad is '', expected a number"),
        (",".join(["t_s", *JOINTS]) + "\n0,1,2,nan,4,5,6,7\n1,1,2,3,4,5,6,7\n", "joint angles of frame 0 hold NaN"),
    ],
)
def test_malformed_tables_are_refused_in_one_line(tmp_path, text, told):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(InputError, match=told) as caught:
        read(tmp_path / "a.csv")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("names", [JOINTS, POSE])
def test_a_table_of_a_header_only_is_unmeasurable(csv_file, names):
    with pytest.raises(UnmeasurableError, match="holds no frame"):
        read(csv_file(["t_s", *names], []))


@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
def test_any_separator_is_read(tmp_path, t_s, q, separator):
    lines = [separator.join(map(str, row)) for row in (["t_s", *JOINTS], *np.column_stack([t_s, q]))]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    np.testing.assert_array_equal(read(tmp_path / "a.csv").q, q)


def test_a_text_without_names_is_read_by_numbered_columns(tmp_path, poses, X_BG):
    np.savetxt(tmp_path / "a.txt", poses[:, [0, 1, 2, 3, 5, 6, 7, 4]])  # as TUM's trajectories: x y z w
    columns = [f"column_{k}" for k in range(1, 8)]
    found = read(tmp_path / "a.txt", columns=columns, layout="quaternion_xyzw", time="column_0")
    np.testing.assert_allclose(found.X_BG, X_BG, atol=1e-9)


def test_a_binary_file_is_refused_as_a_table(tmp_path):
    (tmp_path / "a.csv").write_bytes(b"t_s,x_m\n\xff\xfe\x00\n")
    with pytest.raises(InputError, match="comma-separated"):
        read(tmp_path / "a.csv")
