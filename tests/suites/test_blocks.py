"""Blocks and obstacles: geometry, conditions of the tasks, and success of the experts."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.geometry import Array, make_pose, rotation_exp, to_quaternion
from kinebench_drake.suites.composition import asset_ids, compose, model
from kinebench_drake.suites.families.blocks import assets as blocks
from kinebench_drake.suites.families.task import TaskVariant
from kinebench_drake.suites.scene.state import MOVED_M
from kinebench_drake.suites.simulator import Simulator, TaskOutcome
from tests.suites.bodies import visual_points

X_WB = np.array([-0.615, 0.0, 0.0])
SCENES = [
    ("PullCube-v1", TaskVariant.PLAIN),
    ("StackCube-v1", TaskVariant.PLAIN),
    ("StackCube-v1", TaskVariant.OBSTACLES),
    ("LiftPegUpright-v1", TaskVariant.PLAIN),
]


@pytest.mark.parametrize("color", blocks.COLORS)
def test_cubes_have_the_colour_of_their_name(color: str) -> None:
    for asset_id in asset_ids(f"cube/{color}"):
        cube = model(asset_id)
        assert blocks.EDGE_M[0] <= cube.size["edge_m"] <= blocks.EDGE_M[1]
        surface = cube.bodies[0].visuals[0].surface
        assert surface.texture is not None
        shade = (surface.texture.astype(float) / 255.0).mean(axis=(0, 1)) * surface.color
        assert ["red", "green", "blue"][int(np.argmax(shade))] == color


def test_pegs_fit_between_the_fingers_and_are_red_at_one_end() -> None:
    for asset_id in asset_ids("peg"):
        peg = model(asset_id)
        assert blocks.PEG_LENGTH_M[0] <= peg.size["length_m"] <= blocks.PEG_LENGTH_M[1]
        assert blocks.PEG_WIDTH_M[0] <= peg.size["width_m"] <= blocks.PEG_WIDTH_M[1]
        red, blue, *_ = peg.bodies[0].visuals
        assert red.X_BodyV[0, 3] < 0.0 < blue.X_BodyV[0, 3]
        shades = [v.surface.texture.mean(axis=(0, 1)) for v in (red, blue) if v.surface.texture is not None]
        assert [int(np.argmax(shade)) for shade in shades] == [0, 2]


def test_targets_are_flat_and_obstacles_stand_on_their_foot() -> None:
    for asset_id in asset_ids("mark/target"):
        z = np.concatenate([v.mesh.vertices[:, 2] for v in model(asset_id).bodies[0].visuals])
        assert 0.0 <= z.min() < z.max() < 0.001
    for asset_id in asset_ids("obstacle/upright"):
        obstacle = model(asset_id)
        p = visual_points(obstacle.bodies[0])
        assert p[:, 2].min() == pytest.approx(0.0, abs=1e-6)
        assert p[:, 2].max() == pytest.approx(obstacle.size["height_m"], abs=0.001)
        assert np.hypot(p[:, 0], p[:, 1]).max() <= obstacle.size["radius_m"] + 0.001
        assert blocks.OBSTACLE_HEIGHT_M[0] <= obstacle.size["height_m"] <= blocks.OBSTACLE_HEIGHT_M[1]


def test_the_obstacle_stands_between_the_cubes() -> None:
    for seed in range(30):
        layout = compose("StackCube-v1", seed, variant=TaskVariant.OBSTACLES).layout()
        green, red, obstacle = (layout.placements[n].X_BM[:2, 3] for n in ("green", "red", "obstacle"))
        assert np.dot(green - obstacle, red - obstacle) < -0.99 * np.linalg.norm(green - obstacle) * np.linalg.norm(
            red - obstacle
        )
        assert min(np.linalg.norm(green - obstacle), np.linalg.norm(red - obstacle)) > 0.1
        assert layout.placements["obstacle"].avoid


@pytest.fixture(scope="module", params=SCENES, ids=lambda scene: f"{scene[0]}-{scene[1].value}")
def simulator(request: pytest.FixtureRequest) -> Iterator[tuple[Simulator, TaskVariant]]:
    task, variant = request.param
    with Simulator(task, variant=variant, renders=False) as simulator:
        yield simulator, variant


def outcome_with(simulator: Simulator, poses: dict[str, Array]) -> TaskOutcome:
    """Return the outcome with objects at poses (4, 4) in B."""
    moved = {name: np.concatenate([X[:3, 3] + X_WB, to_quaternion(X[:3, :3])]) for name, X in poses.items()}
    snapshot = simulator.snapshot()
    simulator.set_snapshot(replace(snapshot, objects=snapshot.objects | moved))
    return simulator.outcome()


@pytest.mark.sapien
@pytest.mark.parametrize("simulator", SCENES[1:3], indirect=True, ids=["plain", "obstacles"])
def test_stack_succeeds_with_green_on_red_and_the_obstacle_in_place(simulator: tuple[Simulator, TaskVariant]) -> None:
    own, variant = simulator
    own.reset(compose("StackCube-v1", 4, variant=variant))
    scene = own.scene()
    height = 0.5 * (scene.size("green", "edge_m") + scene.size("red", "edge_m"))
    top = make_pose(np.eye(3), scene.poses["red"][:3, 3] + [0.0, 0.0, height])
    beside = make_pose(np.eye(3), top[:3, 3] + [0.02, 0.0, 0.0])
    above = make_pose(np.eye(3), top[:3, 3] + [0.0, 0.0, 0.02])
    assert not outcome_with(own, {"green": beside}).conditions["above"]
    assert not outcome_with(own, {"green": above}).conditions["on_top"]
    assert outcome_with(own, {"green": top}).success
    if variant is TaskVariant.OBSTACLES:
        X = scene.poses["obstacle"]
        fallen = make_pose(rotation_exp(np.array([1.4, 0.0, 0.0])) @ X[:3, :3], X[:3, 3])
        pushed = make_pose(X[:3, :3], X[:3, 3] + [0.0, MOVED_M + 0.002, 0.0])
        assert not outcome_with(own, {"obstacle": fallen}).conditions["obstacle_upright"]
        assert not outcome_with(own, {"obstacle": pushed}).conditions["obstacle_in_place"]
        assert outcome_with(own, {"obstacle": X}).success


@pytest.mark.sapien
@pytest.mark.parametrize("simulator", SCENES[:1], indirect=True, ids=["plain"])
def test_pull_succeeds_when_the_cube_lies_on_the_target(simulator: tuple[Simulator, TaskVariant]) -> None:
    own, _ = simulator
    own.reset(compose("PullCube-v1", 4))
    scene = own.scene()
    radius = scene.size("target", "radius_m")
    half = scene.size("cube", "edge_m") / 2.0
    for x, y, z, failed in (
        (radius - 0.002, 0.0, half, set()),
        (0.0, radius + 0.002, half, {"on_target"}),
        (0.0, 0.0, half + 0.02, {"on_table"}),
    ):
        X = make_pose(np.eye(3), scene.poses["target"][:3, 3] + np.array([x, y, z]))
        outcome = outcome_with(own, {"cube": X})
        assert {name for name, holds in outcome.conditions.items() if not holds} == failed


@pytest.mark.sapien
@pytest.mark.parametrize("simulator", SCENES[2:3], indirect=True, ids=["obstacles"])
def test_obstacles_fall_only_beyond_their_tipping_angle(simulator: tuple[Simulator, TaskVariant]) -> None:
    own, variant = simulator
    for lean, falls in ((0.1, False), (0.7, True)):
        own.reset(compose("StackCube-v1", 7, variant=variant))
        start = own.snapshot()
        X = own.scene().poses["obstacle"]
        lifted = X[:3, 3] + [0.0, 0.0, own.scene().size("obstacle", "radius_m") * np.sin(lean)]
        outcome_with(own, {"obstacle": make_pose(rotation_exp(np.array([lean, 0.0, 0.0])) @ X[:3, :3], lifted)})
        for _ in range(30):
            own.step(start.q, 0.08)
        assert own.outcome().conditions["obstacle_upright"] is not falls


def standing(lean_rad: float) -> Array:
    """Return the rotation (3, 3) of a peg whose red end is up, tilted by an angle."""
    s = np.sin(lean_rad)
    c = np.cos(lean_rad)
    return np.array([[s, 0.0, c], [0.0, 1.0, 0.0], [-c, 0.0, s]])


@pytest.mark.sapien
@pytest.mark.parametrize("simulator", SCENES[3:], indirect=True, ids=["peg"])
def test_lift_succeeds_only_with_an_upright_peg_on_the_table(simulator: tuple[Simulator, TaskVariant]) -> None:
    own, _ = simulator
    own.reset(compose("LiftPegUpright-v1", 5))
    for R, lift_m, failed in (
        (standing(0.0), 0.0, set()),
        (standing(0.06), 0.0, set()),
        (standing(0.1), 0.0, {"upright"}),
        (standing(np.pi), 0.0, {"upright"}),
        (standing(0.0), 0.02, {"standing"}),
        (np.eye(3), 0.0, {"upright", "standing"}),
    ):
        lying = R[2, 2] == 1.0
        height = 0.5 * own.scene().size("peg", "width_m" if lying else "length_m") + lift_m
        outcome = outcome_with(own, {"peg": make_pose(R, [0.5, 0.1, height])})
        assert {name for name, holds in outcome.conditions.items() if not holds} == failed
        if lying:
            assert outcome.progress < 0.01


@pytest.mark.sapien
@pytest.mark.parametrize("simulator", SCENES[3:], indirect=True, ids=["peg"])
def test_a_standing_peg_keeps_standing(simulator: tuple[Simulator, TaskVariant]) -> None:
    own, _ = simulator
    own.reset(compose("LiftPegUpright-v1", 6))
    start = own.snapshot()
    outcome_with(
        own, {"peg": make_pose(standing(0.02), [0.5, 0.25, 0.5 * own.scene().size("peg", "length_m") + 0.0005])}
    )
    for _ in range(40):
        own.step(start.q, 0.08)
    assert own.outcome().success
