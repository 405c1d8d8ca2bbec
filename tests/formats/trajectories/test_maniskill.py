"""ManiSkill's .h5 files and the .json beside them."""

import h5py
import numpy as np
import pytest

from kinebench_drake.errors import InputError
from kinebench_drake.formats.trajectories.reading import TrajectoryOptions
from kinebench_drake.formats.trajectories.source import find_trajectories, read_trajectory
from tests.formats.trajectories.conftest import read_all


def qpos(q):
    return np.hstack([q, np.full((len(q), 2), 0.015)])


def state(q):
    full = qpos(q)
    return np.hstack([np.full((len(q), 13), 9.0), full, np.full_like(full, 5.0)])


def about(episodes=(), **arguments):
    return {"env_info": {"env_id": "StackCube-v1", "env_kwargs": arguments}, "episodes": list(episodes)}


def test_a_link_to_another_file_is_not_followed(maniskill, q, tmp_path):
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["secret"] = qpos(q)
    path = maniskill({"traj_0": {"obs/agent/extra": q}}, about())
    with h5py.File(path, "a") as file:
        file["traj_0/obs/agent/qpos"] = h5py.ExternalLink("other.h5", "/secret")
    with pytest.raises(InputError, match="no column is known"):
        read_all(path)


def test_trajectories_of_a_file_are_samples_in_numeric_order_with_their_labels(maniskill, q):
    episodes = [{"episode_id": k, "episode_seed": 100 + k, "success": k == 2} for k in (2, 10)]
    path = maniskill(
        {f"traj_{k}": {"obs/agent/qpos": qpos(q + 0.01 * k), "actions": np.zeros((11, 8))} for k in (0, 10, 2)},
        about(episodes, sim_config={"control_freq": 50}),
    )
    samples, found = read_all(path)
    assert [s.id for s in samples] == ["demo-traj_0", "demo-traj_2", "demo-traj_10"]
    assert [s.video for s in samples] == ["demo.h5#traj_0", "demo.h5#traj_2", "demo.h5#traj_10"]
    assert [(s.task, s.seed, s.success) for s in samples] == [
        ("StackCube-v1", None, None),
        ("StackCube-v1", 102, True),
        ("StackCube-v1", 110, False),
    ]
    np.testing.assert_array_equal(found[1].q, q + 0.02)
    np.testing.assert_allclose(found[0].finger_width_m, 0.03)
    np.testing.assert_allclose(found[0].t_s, np.arange(len(q)) / 50.0)
    assert found[0].columns == "obs/agent/qpos: joints"


def test_without_observations_joints_come_from_the_articulation_state(maniskill, q):
    cabinet = {"env_states/articulations/cabinet": np.zeros((12, 13 + 2))}
    path = maniskill({"traj_0": {"env_states/articulations/panda_wristcam": state(q), **cabinet}}, about())
    _, (found,) = read_all(path)
    np.testing.assert_array_equal(found.q, q)
    assert found.columns == "env_states/articulations/panda_wristcam[13:20]: joints"
    np.testing.assert_allclose(found.finger_width_m, 0.03)
    assert found.warnings == ()


def test_flat_observations_are_ignored(maniskill, q):
    sets = {"obs": np.zeros((12, 40)), "env_states/articulations/panda": state(q)}
    _, (found,) = read_all(maniskill({"traj_0": sets}, about()))
    np.testing.assert_array_equal(found.q, q)


def test_a_control_frequency_that_is_not_stated_is_20_hz_with_a_warning_only_without_metadata(maniskill, q):
    path = maniskill({"traj_0": {"obs/agent/qpos": q}}, about())
    _, (found,) = read_all(path)
    np.testing.assert_allclose(found.t_s, np.arange(12) / 20.0)
    assert found.warnings == ()  # ManiSkill's metadata state a frequency that is not its default
    _, (found,) = read_all(path, rate_hz=10.0)
    np.testing.assert_allclose(found.t_s, np.arange(12) / 10.0)
    path.with_suffix(".json").unlink()
    assert any("20 Hz is assumed; $rate_hz HZ" in w for w in read_all(path)[1][0].warnings)


@pytest.mark.parametrize(("text", "told"), [(None, "is not there"), ("{", "cannot be read as JSON")])
def test_without_a_readable_json_file_labels_are_null_with_a_warning(maniskill, q, text, told):
    path = maniskill({"traj_0": {"obs/agent/qpos": q}})
    if text is not None:
        path.with_suffix(".json").write_text(text)
    (sample,), (found,) = read_all(path)
    assert (sample.task, sample.seed, sample.success) == (None, None, None)
    assert any(told in w for w in found.warnings)


def test_one_of_two_robots_is_read_only_if_a_reading_names_it(maniskill, q):
    robots = {f"env_states/articulations/panda-{k}": state(q + k) for k in (0, 1)}
    path = maniskill({"traj_0": {**robots, "mine": q + 2}}, about())
    with pytest.raises(InputError, match=r"no column is known .*; found env_states/articulations/panda-0"):
        read_all(path)
    second = "env_states/articulations/panda-1[13:20]"
    np.testing.assert_array_equal(read_all(path, columns=second, layout="joints")[1][0].q, q + 1)
    np.testing.assert_array_equal(read_all(path, columns="mine", layout="joints")[1][0].q, q + 2)


@pytest.mark.parametrize(
    ("sets", "told"),
    [
        ({"actions": np.zeros((5, 7))}, r"no column is known .*; found actions \(7\)"),
        ({"obs/agent/qpos": np.zeros(5)}, "no column is known"),
        ({"obs/agent/qpos": np.zeros((5, 6))}, "no column is known"),
        ({"env_states/articulations/panda": np.zeros((5, 14))}, "no column is known"),
        ({"obs/agent/qpos": np.full((5, 9), 100.0)}, "look like degrees"),
    ],
)
def test_a_bad_trajectory_is_one_bad_sample(maniskill, q, sets, told):
    path = maniskill({"traj_0": sets, "traj_1": {"obs/agent/qpos": q}}, about())
    bad, good = find_trajectories(path, TrajectoryOptions())
    with pytest.raises(InputError, match=told):
        read_trajectory(bad, TrajectoryOptions())
    np.testing.assert_array_equal(read_trajectory(good, TrajectoryOptions()).q, q)


@pytest.mark.parametrize("data", [b"", b"no hdf5 at all" * 40])
def test_files_that_are_no_hdf5_are_refused(tmp_path, data):
    (tmp_path / "a.h5").write_bytes(data)
    (sample,) = find_trajectories(tmp_path / "a.h5", TrajectoryOptions())
    with pytest.raises(InputError, match="empty" if not data else "not a readable HDF5 file") as caught:
        read_trajectory(sample, TrajectoryOptions())
    assert str(tmp_path) not in str(caught.value)


def test_a_file_without_trajectories_is_one_bad_sample(maniskill):
    (sample,) = find_trajectories(maniskill({"other": {"a": np.zeros(3)}}), TrajectoryOptions())
    with pytest.raises(InputError, match="no column is known"):
        read_trajectory(sample, TrajectoryOptions())
