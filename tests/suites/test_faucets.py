"""Faucets: geometry, behaviour of the joint, conditions and experts."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.suites.composition import asset_ids, compose, model
from kinebench_drake.suites.expert.clearance import SceneGeometry
from kinebench_drake.suites.families.faucets import assets as faucets
from kinebench_drake.suites.families.faucets.task import CLOSED_FRACTION, OPEN_FRACTION, TASKS
from kinebench_drake.suites.families.task import Scene
from kinebench_drake.suites.scene.model import AssetModel, RigidBody
from kinebench_drake.suites.simulator import Simulator
from kinebench_drake.suites.start import START_Q
from tests.suites.bodies import visual_points

IDS = asset_ids("faucet")
NAMES = [task.card.id for task in TASKS]
HUB_M = 0.03
"""Distance from the axis within which the body may be as high as the lever."""


@pytest.mark.parametrize("asset_id", IDS)
def test_faucet_sizes_are_in_bounds_and_leave_room_for_the_sweeping_finger(asset_id: str) -> None:
    faucet = model(asset_id)
    for name, (low, high) in {
        "height_m": faucets.LEVER_HEIGHT_M,
        "lever_m": faucets.LEVER_M,
        "range_rad": faucets.RANGE_RAD,
    }.items():
        assert low <= faucet.size[name] <= high
    base, handle = faucet.bodies
    p = visual_points(base)
    radius = np.hypot(p[:, 0], p[:, 1])
    direction = np.arctan2(p[:, 1], p[:, 0])
    sector = 0.5 * faucet.size["range_rad"] + 0.4
    swept = (radius > HUB_M) & (radius < faucet.size["lever_m"] + 0.03) & (np.abs(direction) < sector)
    assert p[swept, 2].max(initial=0.0) < faucet.size["height_m"] - 0.02
    assert p[:, 2].min() > -1e-6
    lever = visual_points(handle)
    assert lever[:, 0].max() == pytest.approx(faucet.size["lever_m"], abs=0.002)
    assert np.abs(lever[:, 2]).max() < 0.016


@pytest.mark.parametrize("asset_id", IDS)
def test_the_faucet_handle_turns_clear_of_the_body(asset_id: str) -> None:
    """The arms of the handle pass above the body."""
    base, handle = model(asset_id).bodies
    assert handle.joint is not None
    arms = visual_points(handle)
    arms = arms[np.hypot(arms[:, 0], arms[:, 1]) > HUB_M]
    p = visual_points(base)
    near = (np.hypot(p[:, 0], p[:, 1]) > HUB_M) & (np.hypot(p[:, 0], p[:, 1]) < arms[:, 0].max())
    assert p[near, 2].max(initial=0.0) < handle.joint.X_ParentJ[2, 3] + arms[:, 2].min()


def test_every_shape_comes_in_several_finishes() -> None:
    words = [model(asset_id).words for asset_id in IDS]
    assert all(len(set(words[shape::6])) >= 4 for shape in range(6))


@pytest.mark.sapien
@pytest.mark.parametrize("task", NAMES)
def test_the_gripper_in_its_start_posture_touches_no_faucet(task: str) -> None:
    plant = ArmPlant()
    margin = np.linspace(-0.03, 0.03, 3)
    for seed in range(12):
        layout = compose(task, seed).layout()
        placement = layout.placements["faucet"]
        base, handle = placement.model.bodies
        assert handle.joint is not None
        X = placement.X_BM @ handle.joint.X_ParentJ @ np.linalg.inv(handle.joint.X_BodyJ)
        models = {"body": alone(base), "handle": alone(handle)}
        scene = Scene(
            X_BG=np.eye(4), finger_width_m=0.0, poses={"body": placement.X_BM, "handle": X}, joints={}, models=models,
            avoided=frozenset(models),
        )  # fmt: skip
        q = START_Q + margin[:, None] * np.eye(7)[3]  # the elbow moves the hand up and down
        assert not list(SceneGeometry(plant, scene).penetrations(q, np.zeros(len(q)))), f"seed {seed}"


def alone(body: RigidBody) -> AssetModel:
    return AssetModel(asset_id="part/00", words="part", bodies=(replace(body, joint=None),), size={})


@pytest.fixture(scope="module", params=NAMES)
def simulator(request: pytest.FixtureRequest) -> Iterator[Simulator]:
    with Simulator(request.param, renders=False) as simulator:
        yield simulator


@pytest.mark.sapien
def test_faucet_conditions_follow_the_angle_of_the_handle(simulator: Simulator) -> None:
    simulator.reset(compose(simulator.task.card.id, 3))
    travel = simulator.scene().size("faucet", "range_rad")
    opens = simulator.task.card.id == "OpenFaucet-v1"
    limit = OPEN_FRACTION if opens else CLOSED_FRACTION
    for part in (0.0, limit - 0.01, limit + 0.01, 1.0):
        simulator.set_snapshot(replace(simulator.snapshot(), joints={"faucet": part * travel}))
        assert simulator.outcome().success == ((part > limit) == opens)
    simulator.env.objects["faucet"].set_qpos(np.array([[(1.0 if opens else 0.0) * travel]], dtype=np.float32))
    simulator.env.objects["faucet"].set_qvel(np.array([[0.2]], dtype=np.float32))
    assert simulator.outcome().conditions["still"] is False
