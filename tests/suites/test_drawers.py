"""Drawers: geometry, behaviour of the joint, conditions and experts."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.geometry import Array, to_quaternion
from kinebench_drake.suites.composition import asset_ids, compose, model
from kinebench_drake.suites.families.blocks.assets import EDGE_M
from kinebench_drake.suites.families.drawers import assets as cabinets
from kinebench_drake.suites.families.drawers.task import SHUT_M, TASKS
from kinebench_drake.suites.families.registry import find_expert
from kinebench_drake.suites.rollout import run_expert
from kinebench_drake.suites.scene.model import ColliderKind, RigidBody
from kinebench_drake.suites.simulator import Simulator

IDS = asset_ids("cabinet")
NAMES = [task.card.id for task in TASKS]


def boxes(body: RigidBody, out_m: float = 0.0) -> list[tuple[Array, Array]]:
    """Corners of a body's boards, moved along x."""
    boards = [c for c in body.colliders if c.kind is ColliderKind.BOX]
    middles = [c.X_BodyC[:3, 3] + [out_m, 0.0, 0.0] for c in boards]
    return [(m - c.size, m + c.size) for m, c in zip(middles, boards, strict=True)]


@pytest.mark.parametrize("asset_id", IDS)
def test_the_drawer_slides_without_overlap_and_stays_in_the_cabinet(asset_id: str) -> None:
    cabinet = model(asset_id)
    carcass, drawer = cabinet.bodies
    for out in np.linspace(0.0, cabinet.size["travel_m"], 5):
        for low, high in boxes(carcass):
            for other_low, other_high in boxes(drawer, float(out)):
                overlap = np.minimum(high, other_high) - np.maximum(low, other_low)
                assert overlap.min() <= 0.0
    tray_back = min(low[0] for low, _ in boxes(drawer, cabinet.size["travel_m"]))
    assert tray_back < cabinet.size["depth_m"] / 2.0 - 0.03


@pytest.mark.parametrize("asset_id", IDS)
def test_a_cube_fits_into_the_drawer_at_any_yaw(asset_id: str) -> None:
    cabinet = model(asset_id)
    size = cabinet.size
    diagonal = 2.0**0.5 * EDGE_M[1]
    for name, (low, high) in {
        "width_m": cabinets.WIDTH_M,
        "depth_m": cabinets.DEPTH_M,
        "height_m": cabinets.HEIGHT_M,
        "travel_m": cabinets.TRAVEL_M,
    }.items():
        assert low <= size[name] <= high
    assert min(size["travel_m"], size["tray_width_m"]) > diagonal + 0.04  # and the open fingers beside it
    roof = size["height_m"] - 0.012
    assert cabinet.sites["tray"].X_BodyS[2, 3] + diagonal < roof


def test_every_combination_of_handle_finish_and_foot_exists() -> None:
    assert len(cabinets.HANDLES) * len(cabinets.FINISHES) * len(cabinets.FEET) == len(IDS)
    assert len({model(i).size["reach_m"] for i in IDS}) == len(IDS)
    assert len({model(i).words for i in IDS}) > 8


@pytest.fixture(scope="module", params=NAMES)
def simulator(request: pytest.FixtureRequest) -> Iterator[Simulator]:
    with Simulator(request.param, renders=False) as simulator:
        yield simulator


@pytest.mark.sapien
def test_drawer_conditions_hold_only_at_the_goal(simulator: Simulator) -> None:
    simulator.reset(compose(simulator.task.card.id, 4))
    start = simulator.snapshot()
    scene = simulator.scene()
    assert not simulator.outcome().success
    assert simulator.outcome().progress < 0.02
    opens = simulator.task.card.id.startswith("Open")
    goal = scene.size("cabinet", "travel_m") if opens else 0.5 * SHUT_M
    moved = replace(start, joints={"cabinet": goal})
    simulator.set_snapshot(moved)
    if "cube" in start.objects:
        outcome = simulator.outcome()
        assert not outcome.success
        assert outcome.conditions == {"inside": False, "shut": True, "still": True, "released": True}
        X_BT = simulator.scene().site("cabinet", "tray")
        p = X_BT[:3, 3] + [-0.615, 0.0, scene.size("cube", "edge_m") / 2.0]
        cube = np.concatenate([p, to_quaternion(X_BT[:3, :3])])
        simulator.set_snapshot(replace(moved, objects={**start.objects, "cube": cube}))
    conditions = simulator.outcome().conditions
    assert all(conditions.values())


@pytest.mark.sapien
@pytest.mark.parametrize("seed", [2, pytest.param(3, marks=pytest.mark.exhaustive)])
def test_drawer_experts_succeed_and_retreat_above_the_cabinet(simulator: Simulator, seed: int) -> None:
    name = simulator.task.card.id
    performance = run_expert(simulator, find_expert(name), compose(name, seed))
    assert performance.outcome.success, performance.outcome
    lifted = simulator.scene().X_BG[2, 3] - simulator.scene().size("cabinet", "height_m")
    assert lifted > 0.03  # the gripper is free again
