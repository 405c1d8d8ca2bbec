"""Labelled frames of rollouts: what a shard holds, and that finished ones are kept."""

from pathlib import Path

import numpy as np
import pytest

from kinebench_drake.models.panda.description import GRIPPER
from kinebench_drake.suites.catalog import load_suite
from training.frame import DEPTH_UNIT_M, FILES
from training.stills import STILLS, render_rollouts


@pytest.mark.sapien
@pytest.mark.slow
def test_a_shard_has_labelled_frames_of_a_successful_rollout_and_is_kept(tmp_path: Path) -> None:
    specs = load_suite(2).specs("train", 1, tasks=["PullCube-v1"])
    lines = []
    render_rollouts(tmp_path, specs, 1, lines.append)
    assert lines == [f"[1/1] {specs[0].id}"]
    shard = tmp_path / specs[0].id
    assert {file.name for file in shard.iterdir()} == set(FILES)
    part = np.load(shard / "part.npy")
    depth = np.load(shard / "depth.npy")
    truth = np.load(shard / "truth.npz")
    assert len(part) == STILLS
    gripper = np.isin(part, GRIPPER)
    assert gripper.any(axis=(1, 2)).mean() > 0.8
    for k in np.flatnonzero(gripper.sum(axis=(1, 2)) > 500)[:4]:
        distance_m = truth["camera_from_hand"][k][2, 3]
        assert abs(distance_m - np.median(depth[k][gripper[k]]) * DEPTH_UNIT_M) < 0.15
    lines.clear()
    render_rollouts(tmp_path, specs, 1, lines.append)
    assert lines == []
