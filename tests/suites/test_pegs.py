from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.geometry import Array, make_pose, to_quaternion
from kinebench_drake.suites.assets import pegs
from kinebench_drake.suites.assets.library import asset_ids, model
from kinebench_drake.suites.episode import compose
from kinebench_drake.suites.experts.registry import find_expert
from kinebench_drake.suites.rollout import rollout
from kinebench_drake.suites.simulator import Simulator

TASK = "LiftPegUpright-v1"
X_WB = np.array([-0.615, 0.0, 0.0])


def test_pegs_fit_between_the_fingers_and_are_red_at_one_end() -> None:
    for asset_id in asset_ids("peg"):
        peg = model(asset_id)
        assert pegs.LENGTH_M[0] <= peg.size["length_m"] <= pegs.LENGTH_M[1]
        assert pegs.WIDTH_M[0] <= peg.size["width_m"] <= pegs.WIDTH_M[1]
        red, blue, *_ = peg.bodies[0].visuals
        assert red.X_BodyV[0, 3] < 0.0 < blue.X_BodyV[0, 3]
        shades = [v.surface.texture.mean(axis=(0, 1)) for v in (red, blue) if v.surface.texture is not None]
        assert [int(np.argmax(shade)) for shade in shades] == [0, 2]


@pytest.fixture(scope="module")
def stage() -> Iterator[Simulator]:
    with Simulator(TASK, renders=False) as stage:
        yield stage


def turned_up(lean_rad: float) -> Array:
    """Rotation (3, 3) of a peg whose red end is up, leaning by an angle."""
    s, c = np.sin(lean_rad), np.cos(lean_rad)
    return np.array([[s, 0.0, c], [0.0, 1.0, 0.0], [-c, 0.0, s]])


@pytest.mark.sapien
@pytest.mark.parametrize(
    ("R", "lift_m", "failed"),
    [
        (turned_up(0.0), 0.0, set()),
        (turned_up(0.06), 0.0, set()),
        (turned_up(0.1), 0.0, {"upright"}),
        (turned_up(np.pi), 0.0, {"upright"}),
        (turned_up(0.0), 0.02, {"standing"}),
        (np.eye(3), 0.0, {"upright", "standing"}),
    ],
    ids=["upright", "leaning", "leaning too far", "blue end up", "in the air", "lying"],
)
def test_conditions_ask_for_a_standing_peg(stage: Simulator, R: Array, lift_m: float, failed: set[str]) -> None:
    stage.reset(compose(TASK, 5))
    lying = R[2, 2] == 1.0
    height = 0.5 * stage.scene().size("peg", "width_m" if lying else "length_m") + lift_m
    X = make_pose(R, [0.5, 0.1, height])
    stage.show(replace(stage.snapshot(), objects={"peg": np.concatenate([X[:3, 3] + X_WB, to_quaternion(X[:3, :3])])}))
    outcome = stage.outcome()
    assert {name for name, holds in outcome.conditions.items() if not holds} == failed
    if lying:
        assert outcome.progress < 0.01


@pytest.mark.sapien
def test_a_standing_peg_keeps_standing(stage: Simulator) -> None:
    stage.reset(compose(TASK, 6))
    snapshot = stage.snapshot()
    X = make_pose(turned_up(0.02), [0.5, 0.25, 0.5 * stage.scene().size("peg", "length_m") + 0.0005])
    stage.show(replace(snapshot, objects={"peg": np.concatenate([X[:3, 3] + X_WB, to_quaternion(X[:3, :3])])}))
    for _ in range(40):
        stage.step(snapshot.q, 0.08)
    assert stage.outcome().success


@pytest.mark.sapien
@pytest.mark.parametrize("seed", [31, pytest.param(32, marks=pytest.mark.exhaustive)])
def test_the_expert_stands_it_up(stage: Simulator, seed: int) -> None:
    assert rollout(stage, find_expert(TASK), compose(TASK, seed)).outcome.success
