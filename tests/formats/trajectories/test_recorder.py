"""What recorders do to rows: held states, rows of zeros, wrapped angles, clocks of two columns, several episodes."""

import h5py
import numpy as np
import pyarrow
import pyarrow.parquet as parquet
import pytest

from kinebench_drake.formats.trajectories.columns import complete
from kinebench_drake.formats.trajectories.reading import Reading, TrajectoryOptions
from kinebench_drake.formats.trajectories.recorder import find_held
from kinebench_drake.formats.trajectories.source import find_trajectories, read_trajectory
from kinebench_drake.formats.trajectories.trajectory import ColumnTable, NumberColumn

ARM = [f"joint_{k}" for k in range(1, 8)]


def motion(rate_hz, seconds=3.0, speed=1.0):
    """Seven joints that never rest together."""
    t_s = np.arange(int(rate_hz * seconds)) / rate_hz
    phases = np.linspace(0.0, 2.0, 7)
    return t_s, 0.4 * np.sin(speed * t_s[:, None] * np.linspace(1.0, 1.7, 7) + phases) - 0.5


def read(path):
    choice = TrajectoryOptions()
    return [read_trajectory(sample, choice) for sample in find_trajectories(path, choice)]


@pytest.mark.parametrize("times", [2, 3, 20])
def test_rows_of_a_held_state_are_one_row(archive, times):
    t_s, q = motion(20)
    log_s = np.arange(len(t_s) * times) / (20 * times)
    (trajectory,) = read(archive(t_s=log_s, q=np.repeat(q, times, axis=0)))
    np.testing.assert_array_equal(trajectory.q, q)
    np.testing.assert_allclose(trajectory.t_s, t_s, atol=1e-9)
    assert f"{len(t_s) * (times - 1)} rows of {len(t_s) * times} repeat a state" in trajectory.warnings[0]


def test_a_state_that_comes_late_leaves_its_own_time(archive):
    """Every fifth update comes too late for its row, which repeats the state before."""
    t_s, q = motion(20)
    late = np.arange(len(q)) % 5 == 3
    logged = q.copy()
    logged[late] = q[np.flatnonzero(late) - 1]
    (trajectory,) = read(archive(t_s=t_s, q=logged))
    np.testing.assert_array_equal(trajectory.q, q[~late])
    np.testing.assert_allclose(trajectory.t_s, t_s[~late], atol=1e-9)


@pytest.mark.parametrize("speed", [0.02, 0.3, 1.0])
@pytest.mark.parametrize("decimals", [2, 3, 4, None])
def test_slow_motions_of_rounded_numbers_are_not_held(speed, decimals):
    _, q = motion(100, speed=speed)
    stored = q.astype(np.float16).astype(np.float64) if decimals is None else q.round(decimals)
    assert not find_held(stored).any()


def test_an_arm_that_stops_is_not_held():
    _, q = motion(20)
    stops = [q[:20], np.repeat(q[20:21], 30, axis=0), q[20:40], np.repeat(q[40:41], 2, axis=0), q[41:]]
    assert not find_held(np.vstack(stops)).any()


@pytest.mark.parametrize("place", [0, 5])
def test_rows_of_zeros_are_not_measured(csv_file, t_s, q, X_BG, quaternion, place):
    header = ["x", "y", "z", "qw", "qx", "qy", "qz"]
    for names, values in ((ARM, q), (header, np.hstack([X_BG[:, :3, 3], quaternion]))):
        empty = values.copy()
        empty[place : place + 2] = 0.0
        (trajectory,) = read(csv_file(["t_s", *names], np.column_stack([t_s, empty])))
        assert np.flatnonzero(~trajectory.tracked).tolist() == [place, place + 1]
        assert "2 rows of zeros" in trajectory.warnings[0]


def test_an_arm_that_starts_at_zero_is_measured(archive):
    t_s, q = motion(20)
    (trajectory,) = read(archive(t_s=t_s, q=q - q[0]))
    assert trajectory.tracked.all()


def test_wrapped_angles_are_continuous(archive):
    t_s, q = motion(20)
    q[:, 5] += 3.6
    q[:, 6] -= 2.5
    (trajectory,) = read(archive(t_s=t_s, q=(q + np.pi) % (2 * np.pi) - np.pi))
    turns = (trajectory.q - q) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.tile(turns[0].round(), (len(q), 1)), atol=1e-12)
    assert ["joint 6" in text or "joint 7" in text for text in trajectory.warnings] == [True, True]


@pytest.mark.parametrize(
    "names", [("secs", "nsecs"), ("header.stamp.sec", "header.stamp.nanosec"), ("timestamp_seconds", "timestamp_nanos")]
)
def test_nanoseconds_beside_seconds_are_one_time(csv_file, names):
    t_s, q = motion(20)
    nanos = np.round(1e9 * (t_s + 0.7)).astype(int)
    rows = [[1700000000 + n // 10**9, n % 10**9, *row] for n, row in zip(nanos, q, strict=True)]
    (trajectory,) = read(csv_file([*names, *ARM], rows))
    np.testing.assert_allclose(trajectory.t_s - trajectory.t_s[0], t_s, atol=1e-9)


def test_two_clocks_of_one_time_are_not_added(csv_file):
    t_s, q = motion(20)
    rows = [[t, round(1e9 * t), *row] for t, row in zip(t_s, q, strict=True)]
    (trajectory,) = read(csv_file(["time_seconds", "time_nanoseconds", *ARM], rows))
    np.testing.assert_allclose(trajectory.t_s, t_s, atol=1e-9)


def write_episodes(path, columns):
    match path.suffix:
        case ".csv":
            rows = np.column_stack(list(columns.values()))
            np.savetxt(path, rows, delimiter=",", header=",".join(["t_s", "episode_index", *ARM]), comments="")
        case ".npz":
            np.savez(path, **columns)
        case ".parquet":
            parquet.write_table(pyarrow.table({k: v.tolist() for k, v in columns.items()}), path)
        case _:
            with h5py.File(path, "w") as file:
                for name, value in columns.items():
                    file[name] = value


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".parquet", ".h5"])
def test_episodes_of_a_file_are_trajectories_of_their_own(tmp_path, suffix):
    t_s, q = motion(20)
    lengths = [20, 25, 15]
    times = np.concatenate([t_s[:n] for n in lengths])
    path = tmp_path / f"log{suffix}"
    write_episodes(path, {"t_s": times, "episode_index": np.repeat([3, 4, 7], lengths), "q": q})
    samples = find_trajectories(path, TrajectoryOptions())
    assert [sample.id for sample in samples] == ["log-episode_3", "log-episode_4", "log-episode_7"]
    assert [sample.video for sample in samples] == [f"{path.name}#episode_{k}" for k in (3, 4, 7)]
    trajectories = [read_trajectory(sample, TrajectoryOptions()) for sample in samples]
    np.testing.assert_allclose(np.vstack([trajectory.q for trajectory in trajectories]), q)
    assert [len(trajectory.t_s) for trajectory in trajectories] == lengths


def test_ends_of_episodes_divide_a_file(archive):
    t_s, q = motion(20)
    trajectories = read(archive(t_s=t_s, q=q, episode_ends=np.array([20, 60])))
    assert [len(trajectory.t_s) for trajectory in trajectories] == [20, 40]


def test_a_file_of_one_episode_is_one_trajectory(archive):
    t_s, q = motion(20)
    (sample,) = find_trajectories(archive("a.npz", t_s=t_s, q=q, episode_index=np.full(60, 4)), TrajectoryOptions())
    assert sample.id == "a"


def test_episodes_whose_rows_are_mixed_are_refused(archive):
    t_s, q = motion(20)
    path = archive(t_s=t_s, q=q, episode_index=np.arange(60) % 2)
    (sample,) = find_trajectories(path, TrajectoryOptions())
    assert "sort the rows by episode" in sample.problem


def test_joint_angles_are_read_where_torques_and_poses_stand_beside_them():
    """The columns of franka_ros, printed by rostopic."""
    names = [f"O_T_EE{k}" for k in range(16)]
    names += [f"{name}{k}" for name in ("q", "dq", "tau_J", "dtau_J", "theta") for k in range(7)]
    columns = tuple(NumberColumn(name=f"field.{name}", size=1) for name in names)
    reading = complete(ColumnTable(columns=columns, load={}.__getitem__), Reading())
    assert reading.columns == tuple(f"field.q{k}" for k in range(7))
