from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.geometry import Array, make_pose, rotation_exp, to_quaternion
from kinebench_drake.suites.assets import cubes, marks
from kinebench_drake.suites.assets.library import asset_ids, model
from kinebench_drake.suites.episode import compose
from kinebench_drake.suites.experts.registry import find_expert
from kinebench_drake.suites.rollout import rollout
from kinebench_drake.suites.simulator import Simulator, TaskOutcome
from kinebench_drake.suites.tasks.card import TaskVariant
from kinebench_drake.suites.tasks.layout import MOVED_M

X_WB = np.array([-0.615, 0.0, 0.0])
SCENES = [
    ("PullCube-v1", TaskVariant.PLAIN),
    ("StackCube-v1", TaskVariant.PLAIN),
    ("StackCube-v1", TaskVariant.OBSTACLES),
]


@pytest.mark.parametrize("color", cubes.COLORS)
def test_cubes_have_the_colour_that_they_are_called_by(color: str) -> None:
    for asset_id in asset_ids(f"cube/{color}"):
        cube = model(asset_id)
        assert cubes.EDGE_M[0] <= cube.size["edge_m"] <= cubes.EDGE_M[1]
        surface = cube.bodies[0].visuals[0].surface
        assert surface.texture is not None
        shade = (surface.texture.astype(float) / 255.0).mean(axis=(0, 1)) * surface.color
        assert ["red", "green", "blue"][int(np.argmax(shade))] == color


def test_targets_are_flat_and_obstacles_stand_on_their_foot() -> None:
    for asset_id in asset_ids("mark/target"):
        z = np.concatenate([v.mesh.vertices[:, 2] for v in model(asset_id).bodies[0].visuals])
        assert 0.0 <= z.min() < z.max() < 0.001
    for asset_id in asset_ids("obstacle/upright"):
        obstacle = model(asset_id)
        p = np.concatenate(
            [v.mesh.vertices @ v.X_BodyV[:3, :3].T + v.X_BodyV[:3, 3] for v in obstacle.bodies[0].visuals]
        )
        assert p[:, 2].min() == pytest.approx(0.0, abs=1e-6)
        assert p[:, 2].max() == pytest.approx(obstacle.size["height_m"], abs=0.001)
        assert np.hypot(p[:, 0], p[:, 1]).max() <= obstacle.size["radius_m"] + 0.001
        assert marks.OBSTACLE_HEIGHT_M[0] <= obstacle.size["height_m"] <= marks.OBSTACLE_HEIGHT_M[1]


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
def stage(request: pytest.FixtureRequest) -> Iterator[tuple[Simulator, TaskVariant]]:
    task, variant = request.param
    with Simulator(task, variant=variant, renders=False) as stage:
        yield stage, variant


def with_things(stage: Simulator, poses: dict[str, Array]) -> TaskOutcome:
    """The verdict with things at poses (4, 4) in B."""
    moved = {name: np.concatenate([X[:3, 3] + X_WB, to_quaternion(X[:3, :3])]) for name, X in poses.items()}
    snapshot = stage.snapshot()
    stage.show(replace(snapshot, objects=snapshot.objects | moved))
    return stage.outcome()


@pytest.mark.sapien
@pytest.mark.parametrize("stage", SCENES[1:], indirect=True, ids=["plain", "obstacles"])
def test_a_stack_is_green_on_red_and_nothing_else_moved(stage: tuple[Simulator, TaskVariant]) -> None:
    own, variant = stage
    own.reset(compose("StackCube-v1", 4, variant=variant))
    scene = own.scene()
    height = 0.5 * (scene.size("green", "edge_m") + scene.size("red", "edge_m"))
    top = make_pose(np.eye(3), scene.poses["red"][:3, 3] + [0.0, 0.0, height])
    beside = make_pose(np.eye(3), top[:3, 3] + [0.02, 0.0, 0.0])
    above = make_pose(np.eye(3), top[:3, 3] + [0.0, 0.0, 0.02])
    assert not with_things(own, {"green": beside}).conditions["above"]
    assert not with_things(own, {"green": above}).conditions["on_top"]
    assert with_things(own, {"green": top}).success
    if variant is TaskVariant.OBSTACLES:
        X = scene.poses["obstacle"]
        fallen = make_pose(rotation_exp(np.array([1.4, 0.0, 0.0])) @ X[:3, :3], X[:3, 3])
        pushed = make_pose(X[:3, :3], X[:3, 3] + [0.0, MOVED_M + 0.002, 0.0])
        assert not with_things(own, {"obstacle": fallen}).conditions["obstacle_upright"]
        assert not with_things(own, {"obstacle": pushed}).conditions["obstacle_in_place"]
        assert with_things(own, {"obstacle": X}).success


@pytest.mark.sapien
@pytest.mark.parametrize("stage", SCENES[:1], indirect=True, ids=["plain"])
def test_a_cube_is_pulled_when_it_lies_on_the_target(stage: tuple[Simulator, TaskVariant]) -> None:
    own, _ = stage
    own.reset(compose("PullCube-v1", 4))
    scene = own.scene()
    radius, half = scene.size("target", "radius_m"), scene.size("cube", "edge_m") / 2.0
    for x, y, z, failed in (
        (radius - 0.002, 0.0, half, set()),
        (0.0, radius + 0.002, half, {"on_target"}),
        (0.0, 0.0, half + 0.02, {"on_table"}),
    ):
        X = make_pose(np.eye(3), scene.poses["target"][:3, 3] + np.array([x, y, z]))
        outcome = with_things(own, {"cube": X})
        assert {name for name, holds in outcome.conditions.items() if not holds} == failed


@pytest.mark.sapien
@pytest.mark.parametrize("stage", SCENES[2:], indirect=True, ids=["obstacles"])
def test_obstacles_fall_when_they_lean_too_far(stage: tuple[Simulator, TaskVariant]) -> None:
    own, variant = stage
    for lean, falls in ((0.1, False), (0.7, True)):
        own.reset(compose("StackCube-v1", 7, variant=variant))
        start, X = own.snapshot(), own.scene().poses["obstacle"]
        lifted = X[:3, 3] + [0.0, 0.0, own.scene().size("obstacle", "radius_m") * np.sin(lean)]
        with_things(own, {"obstacle": make_pose(rotation_exp(np.array([lean, 0.0, 0.0])) @ X[:3, :3], lifted)})
        for _ in range(30):
            own.step(start.q, 0.08)
        assert own.outcome().conditions["obstacle_upright"] is not falls


@pytest.mark.sapien
@pytest.mark.parametrize("seed", [31, pytest.param(32, marks=pytest.mark.exhaustive)])
def test_experts_succeed(stage: tuple[Simulator, TaskVariant], seed: int) -> None:
    own, variant = stage
    task = own.task.card.id
    assert rollout(own, find_expert(task), compose(task, seed, variant=variant)).outcome.success
