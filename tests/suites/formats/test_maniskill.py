"""ManiSkill's trajectories, read back and replayed."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from kinebench_drake.executors.base import ExecutorKind, create_executor
from kinebench_drake.formats.trajectories.check import check
from kinebench_drake.formats.trajectories.maniskill import list_maniskill, read_maniskill
from kinebench_drake.formats.trajectories.trajectory import TrajectoryOptions
from kinebench_drake.suites.demos import make_demos
from kinebench_drake.suites.formats.demo import FormatKind
from kinebench_drake.suites.simulator import Simulator
from tests.suites.orders import FIRST, TASK, Recorder, an_order


@pytest.mark.sapien
def test_maniskill_trajectories_hold_states_and_lead_to_success(tmp_path: Path) -> None:
    order = an_order(tmp_path, FormatKind.MANISKILL, 1)
    make_demos(order, create_executor(ExecutorKind.LOCAL, 1), Recorder())
    path = tmp_path / f"{TASK}.h5"
    assert not (tmp_path / ".parts").exists()
    [sample] = list_maniskill(path, path.name)
    assert (sample.task, sample.seed, sample.success, sample.rate_hz) == (f"KineBench/{TASK}", FIRST, True, 20.0)
    track = check(read_maniskill(path, "traj_0", sample.rate_hz, TrajectoryOptions()))
    assert len(track.t_s) == 193
    with h5py.File(path) as file:
        group = file["traj_0"]
        assert group["actions"].shape == (192, 8)
        assert group["success"][-1]
        assert group["env_states/actors/green"].shape == (193, 13)
        actions = np.asarray(group["actions"])
    with Simulator(TASK, renders=False) as stage:  # the commands alone lead to the same end
        [draw] = order.specs(TASK, 1)
        stage.reset(draw.episode())
        for action in actions:
            stage._env.step(action)
        assert stage.outcome().success
        assert track.q is not None
        assert np.allclose(stage.snapshot().q, track.q[-1], atol=1e-6)
