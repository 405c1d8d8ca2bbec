"""Fruits, containers, and the tasks with them."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
import torch

from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.suites.composition import Episode, asset_ids, compose, model
from kinebench_drake.suites.families.fruits.assets import FRUITS
from kinebench_drake.suites.families.fruits.containers import COMPARTMENTS, compartment_center
from kinebench_drake.suites.families.fruits.task import GAP_M, ORDER, OTHERS
from kinebench_drake.suites.families.registry import find_task
from kinebench_drake.suites.families.task import TaskVariant
from kinebench_drake.suites.scene.state import State
from tests.suites.bodies import collider_points, initial_state, solid_points

GRIP_M = (0.030, 0.062)
"""Range of thickness that the gripper holds easily."""


def state_of(episodes: list[Episode], moved: Mapping[str, list[Array]], grasped: str = "") -> State:
    """Return the initial state of episodes with some objects at other poses."""
    state = initial_state(episodes)
    poses = {name: torch.tensor(np.stack(X), dtype=torch.float32) for name, X in moved.items()}
    return replace(
        state, poses={**state.poses, **poses}, grasps=lambda name: torch.full((len(episodes),), name == grasped)
    )


def test_every_fruit_lies_on_a_flat_side_and_fits_the_gripper() -> None:
    for fruit in FRUITS:
        for asset_id in asset_ids(f"fruit/{fruit}"):
            asset = model(asset_id)
            assert GRIP_M[0] < asset.size["grip_m"] < GRIP_M[1], asset_id
            assert asset.size["height_m"] < 0.058, asset_id  # lower than the palm of a hand that holds its neighbour
            points = solid_points(asset.bodies[0])
            vertices = asset.bodies[0].visuals[0].mesh.vertices
            for low in (points[:, 2].min(), vertices[:, 2].min()):
                assert low == pytest.approx(-asset.size["rest_m"], abs=1e-6)
            assert (points[:, 2] < points[:, 2].min() + 1e-6).sum() >= 5, asset_id
            assert np.abs(points.min(axis=0) - vertices.min(axis=0)).max() < 0.002, asset_id
            assert np.abs(points.max(axis=0) - vertices.max(axis=0)).max() < 0.002, asset_id


def test_every_container_holds_a_fruit_and_stands_on_the_table() -> None:
    for asset_id in (*asset_ids("container"), *asset_ids("crate")):
        asset = model(asset_id)
        points = solid_points(asset.bodies[0])
        assert points[:, 2].min() == pytest.approx(0.0, abs=1e-6), asset_id
        assert points[:, 2].max() == pytest.approx(asset.size["rim_m"], abs=0.004), asset_id
        assert min(asset.size["inner_x_m"], asset.size["inner_y_m"]) > 0.14, asset_id
        assert 0.02 < asset.size["rim_m"] < 0.06, asset_id
        solids = [collider_points(c) for c in asset.bodies[0].colliders]
        low, high = (np.stack([f(p, axis=0) for p in solids]) for f in (np.min, np.max))
        over = ((low[:, :2] < -0.02) & (high[:, :2] > 0.02)).all(axis=1)
        assert high[over, 2].max() == pytest.approx(asset.size["floor_m"], abs=1e-6), asset_id


@pytest.mark.parametrize("variant", list(TaskVariant))
def test_every_fruit_scene_has_the_same_names_and_gaps_for_the_fingers(variant: TaskVariant) -> None:
    names = set()
    targets = set()
    for seed in range(60):
        layout = compose("PickFruits-v1", seed, variant=variant).layout()
        names.add(tuple(layout.placements))
        targets.add(layout.placements["target"].model.words)
        assert f"the {layout.placements['target'].model.words}," in layout.prompt
        fruits = [layout.placements[name] for name in ("target", *OTHERS)]
        assert len({fruit.model.words for fruit in fruits}) == 4
        gaps = [
            np.linalg.norm(a.X_BM[:2, 3] - b.X_BM[:2, 3]) - a.model.size["reach_m"] - b.model.size["reach_m"]
            for i, a in enumerate(fruits)
            for b in [*fruits[:i], layout.placements["container"]]
        ]
        assert min(gaps) > 0.6 * GAP_M
    assert len(names) == 1
    assert targets == set(FRUITS)


def test_a_fruit_counts_only_inside_the_container_and_released() -> None:
    task = find_task("PickFruits-v1")
    episodes = [compose("PickFruits-v1", seed) for seed in (3, 4)]
    layouts = [episode.layout() for episode in episodes]

    def into(name: str, up_m: float = 0.0) -> list[Array]:
        poses = []
        for layout in layouts:
            container = layout.placements["container"]
            height = container.model.size["floor_m"] + layout.placements[name].model.size["rest_m"] + up_m
            poses.append(make_pose(np.eye(3), container.X_BM[:3, 3] + [0.0, 0.0, height]))
        return poses

    begin = state_of(episodes, {})
    assert not task.conditions(begin)["in_container"].any()
    assert torch.allclose(task.progress(begin), torch.zeros(2), atol=1e-5)
    done = state_of(episodes, {"target": into("target")})
    assert torch.stack(list(task.conditions(done).values())).all()
    assert torch.allclose(task.progress(done), torch.ones(2), atol=1e-4)
    assert not task.conditions(state_of(episodes, {"target": into("target", 0.06)}))["in_container"].any()
    assert not task.conditions(state_of(episodes, {"target": into("target")}, grasped="target"))["released"].any()
    assert not task.conditions(state_of(episodes, {"other_1": into("other_1")}))["others_stay"].any()


def test_fruits_are_stored_in_the_order_of_the_compartments() -> None:
    task = find_task("StoreFruitsBox-v1")
    episodes = [compose("StoreFruitsBox-v1", seed) for seed in (3, 5)]
    layouts = [episode.layout() for episode in episodes]

    def stored(cells: tuple[int, ...]) -> dict[str, list[Array]]:
        moved: dict[str, list[Array]] = {}
        for name, cell in zip(ORDER, cells, strict=True):
            moved[name] = []
            for layout in layouts:
                crate = layout.placements["crate"]
                size = layout.placements[name].model.size
                p = crate.X_BM[:3, :3] @ compartment_center(crate.model.size.__getitem__, cell) + crate.X_BM[:3, 3]
                moved[name].append(make_pose(np.eye(3), [p[0], p[1], p[2] + size["rest_m"]]))
        return moved

    right = state_of(episodes, stored((0, 1, 2)))
    assert torch.stack(list(task.conditions(right).values())).all()
    assert torch.allclose(task.progress(right), torch.ones(2), atol=1e-4)
    wrong = task.conditions(state_of(episodes, stored((1, 0, 2))))
    assert not wrong["first_in_left"].any()
    assert not wrong["second_in_middle"].any()
    assert wrong["third_in_right"].all()
    for layout in layouts:  # left is where the camera, which looks back at the robot, sees it: towards -y
        size = layout.placements["crate"].model.size.__getitem__
        assert [compartment_center(size, i)[1] for i in range(COMPARTMENTS)] == sorted(
            compartment_center(size, i)[1] for i in range(COMPARTMENTS)
        )
    words = [layout.placements[name].model.words for layout in layouts[:1] for name in ORDER]
    asset = [layouts[0].prompt.index(f"the {word} into") for word in words]
    assert asset == sorted(asset)
