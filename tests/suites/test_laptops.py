"""Laptops and the tasks with them."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.suites.composition import asset_ids, compose, model
from kinebench_drake.suites.families.laptops import assets
from kinebench_drake.suites.families.laptops.assets import GREATEST_RAD
from kinebench_drake.suites.families.laptops.task import OPEN_RAD, SHUT_RAD, TASKS
from kinebench_drake.suites.families.registry import find_task
from kinebench_drake.suites.scene.model import AssetModel
from kinebench_drake.suites.scene.state import ARM, State
from tests.suites.bodies import initial_state, solid_points

TASK_IDS = [task.card.id for task in TASKS]


def _lid_at(laptop: AssetModel, angle_rad: float) -> Array:
    """Return the lid's collider points in the base."""
    joint = laptop.bodies[1].joint
    assert joint is not None
    c = np.cos(angle_rad)
    s = np.sin(angle_rad)
    turn = make_pose([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]], np.zeros(3))
    X = joint.X_ParentJ @ turn @ np.linalg.inv(joint.X_BodyJ)
    return np.asarray(solid_points(laptop.bodies[1]) @ X[:3, :3].T + X[:3, 3])


@pytest.mark.parametrize("asset_id", asset_ids("laptop"))
def test_laptop_sizes_are_within_bounds(asset_id: str) -> None:
    laptop = model(asset_id)
    base = solid_points(laptop.bodies[0])
    lid = _lid_at(laptop, 0.0)
    for (low, high), extent in ((assets.DEPTH_M, np.ptp(base[:, 0])), (assets.WIDTH_M, np.ptp(base[:, 1]))):
        assert low - 1e-9 <= extent <= high + 1e-9
    assert base[:, 2].min() > 0.0
    assert base[:, 2].max() == pytest.approx(laptop.size["top_m"])
    assert lid[:, 0].max() - base[:, 0].max() == pytest.approx(laptop.size["lip_m"])


@pytest.mark.parametrize("asset_id", asset_ids("laptop"))
def test_lid_stays_above_the_base_at_all_angles(asset_id: str) -> None:
    laptop = model(asset_id)
    top = laptop.size["top_m"]
    back = -laptop.size["depth_m"] / 2.0
    for angle in np.linspace(0.0, GREATEST_RAD, 40):
        lid = _lid_at(laptop, float(angle))
        assert lid[lid[:, 0] > back, 2].min() > top
        assert lid[:, 2].max() < 0.2


def test_laptops_differ_in_size_and_come_in_all_colours() -> None:
    laptops = [model(name) for name in asset_ids("laptop")]
    assert len({laptop.words for laptop in laptops}) == len(assets.COLORS)
    assert len({tuple(laptop.size.values()) for laptop in laptops}) == len(laptops)


def _states(task: str, angles: tuple[float, float], clear_m: float) -> State:
    """Return two scenes with lids at rest at two angles, the gripper above the lid's axis."""
    state = initial_state([compose(task, seed) for seed in range(2)])
    X_lid = state.site("laptop", "hinge")
    X_BG = X_lid.clone()
    X_BG[:, 2, 3] += state.size("laptop", "outside_m") + clear_m
    return replace(
        state,
        X_BG=X_BG,
        poses={**state.poses, "laptop/lid": X_lid},
        joints={"laptop": torch.tensor(angles, dtype=torch.float32)},
    )


@pytest.mark.parametrize("task_id", TASK_IDS)
def test_laptop_conditions_flip_at_the_goal_angle(task_id: str) -> None:
    task = find_task(task_id)
    name, goal, sign = ("open", OPEN_RAD, 1.0) if "Open" in task_id else ("shut", SHUT_RAD, -1.0)
    state = _states(task_id, (goal + 0.01 * sign, goal - 0.01 * sign), 0.1)
    verdict = task.conditions(state)
    assert verdict[name].tolist() == [True, False]
    assert verdict["still"].all()
    assert verdict["released"].all()
    assert torch.allclose(task.progress(state), torch.ones(2), atol=0.05)
    hurried = task.conditions(replace(state, speeds={"laptop": torch.ones(2), ARM: torch.ones(2)}))
    assert not hurried["still"].any()
    assert not hurried["calm"].any()
    assert not task.conditions(_states(task_id, (0.0, 0.0), 0.02))["released"].any()


@pytest.mark.parametrize("task_id", TASK_IDS)
def test_the_goal_is_over_a_quarter_of_the_range_from_the_start(task_id: str) -> None:
    for seed in range(20):
        start = compose(task_id, seed).layout().placements["laptop"].joint
        way = OPEN_RAD - start if "Open" in task_id else start - SHUT_RAD
        assert way > 0.25 * GREATEST_RAD
