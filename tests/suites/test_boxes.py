"""Boxes with hinged lids: geometry, behaviour of the lids, and conditions for open and shut."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from kinebench_drake.geometry import make_pose, rotation_exp, transform_points
from kinebench_drake.suites.composition import asset_ids, compose, model
from kinebench_drake.suites.families.boxes.assets import FLUSH, OPEN_RAD, OVERHANG_M, RIMMED, with_tight_hinge
from kinebench_drake.suites.families.registry import find_task
from kinebench_drake.suites.scene.model import AssetModel
from kinebench_drake.suites.scene.state import ARM, State
from tests.suites.bodies import initial_state, solid_points

TASKS = ("CloseBox-v1", "OpenBoxEasy-v1", "OpenBoxEasy-v2", "OpenBoxHard-v1", "OpenBoxHard-v2")
BOXES = [*asset_ids(RIMMED), *asset_ids(FLUSH)]


def _lid_pose(box: AssetModel, angle: float) -> np.ndarray:
    """Return the pose (4, 4) of the lid in the base."""
    joint = box.bodies[1].joint
    assert joint is not None
    turn = make_pose(rotation_exp([angle, 0.0, 0.0]), np.zeros(3))
    return joint.X_ParentJ @ turn @ np.linalg.inv(joint.X_BodyJ)


@pytest.mark.parametrize("asset_id", BOXES)
def test_lid_lies_on_the_walls_and_never_enters_the_box(asset_id: str) -> None:
    box = model(asset_id)
    base, lid = box.bodies
    low = solid_points(base).min(axis=0)
    high = solid_points(base).max(axis=0)
    shut = transform_points(_lid_pose(box, 0.0), solid_points(lid))
    assert shut[:, 2].min() == pytest.approx(high[2])
    assert high[2] == pytest.approx(box.size["height_m"])
    overhang = shut[:, 0].max() - high[0]
    assert overhang == pytest.approx(box.size["overhang_m"])
    assert overhang == 0.0 or OVERHANG_M[0] <= overhang <= OVERHANG_M[1]
    assert OPEN_RAD[0] <= box.size["open_rad"] <= OPEN_RAD[1]
    for angle in np.linspace(0.0, box.size["open_rad"], 7):
        lid_points = transform_points(_lid_pose(box, float(angle)), solid_points(lid))
        inside = (lid_points[:, 0] > low[0] + 1e-9) & (lid_points[:, 2] < high[2] - 1e-9)
        assert not inside.any()


def test_flush_lid_clears_the_table_when_the_box_lies() -> None:
    for asset_id in asset_ids(FLUSH):
        base, lid = model(asset_id).bodies
        assert np.abs(solid_points(lid)[:, 1]).max() < np.abs(solid_points(base)[:, 1]).max()


def test_a_tight_hinge_differs_only_in_damping() -> None:
    box = model(f"{RIMMED}/03")
    hinge = box.bodies[1].joint
    tighter = with_tight_hinge(box).bodies[1].joint
    assert hinge is not None
    assert tighter is not None
    assert tighter.damping > hinge.damping
    assert replace(tighter, damping=hinge.damping) == hinge


def _state(task: str, angles: list[float], p_HG: list[list[float]], speed: float = 0.0, arm: float = 0.0) -> State:
    """Return scenes of seed 3 with these lid angles and TCP positions in the hinge's frame."""
    state = initial_state([compose(task, 3)] * len(angles))
    n = len(angles)
    X_BG = state.X_BG.clone()
    X_BG[:, :3, 3] = (
        state.site("box", "hinge") @ torch.tensor([[*p, 1.0] for p in p_HG], dtype=torch.float32)[..., None]
    )[:, :3, 0]
    return replace(
        state,
        X_BG=X_BG,
        joints={"box": torch.tensor(angles, dtype=torch.float32)},
        speeds={"box": torch.full((n,), speed), ARM: torch.full((n,), arm)},
    )


@pytest.mark.parametrize("task", TASKS[1:])
def test_open_requires_the_goal_angle_at_rest_and_released(task: str) -> None:
    stop = compose(task, 3).layout().placements["box"].model.size["open_rad"]
    clear = [0.07, 0.0, 0.1]
    touching = [0.1 * np.cos(stop), 0.0, 0.1 * np.sin(stop) + 0.01]
    behind = [-0.2, 0.0, 0.15]
    state = _state(task, [stop, 0.85 * stop, stop, stop], [clear, clear, touching, behind])
    conditions = find_task(task).conditions(state)
    assert conditions["open"].tolist() == [True, False, True, True]
    assert conditions["released"].tolist() == [True, True, False, True]
    assert conditions["still"].all()
    assert conditions["calm"].all()
    assert not find_task(task).conditions(_state(task, [stop], [clear], arm=0.5))["calm"].any()
    assert find_task(task).progress(state)[0] >= 1.0
    assert not find_task(task).conditions(_state(task, [stop], [clear], speed=0.2))["still"].any()


def test_shut_requires_the_goal_angle_and_release() -> None:
    up = -1.0 if compose("CloseBox-v1", 3).layout().placements["box"].X_BM[2, 1] < 0.0 else 1.0
    clear = [0.1, 0.12 * up, 0.06]
    touching = [0.1, 0.04 * up, 0.015]
    state = _state("CloseBox-v1", [0.02, 0.2, 0.02], [clear, clear, touching])
    conditions = find_task("CloseBox-v1").conditions(state)
    assert conditions["shut"].tolist() == [True, False, True]
    assert conditions["released"].tolist() == [True, True, False]
    assert find_task("CloseBox-v1").progress(state)[1] < 1.0


@pytest.mark.parametrize("task", TASKS)
def test_lids_start_half_their_range_from_the_goal_and_boxes_stand_on_the_table(task: str) -> None:
    for seed in range(8):
        placement = compose(task, seed).layout().placements["box"]
        box = placement.model
        lowest = transform_points(placement.X_BM, solid_points(box.bodies[0]))[:, 2].min()
        assert lowest == pytest.approx(0.0, abs=1e-9)
        goal = 0.0 if task == "CloseBox-v1" else box.size["open_rad"]
        assert abs(goal - placement.joint) > 0.5 * box.size["open_rad"]
