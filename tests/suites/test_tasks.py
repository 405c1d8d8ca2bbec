"""Laws of all tasks and assets."""

from collections.abc import Iterator

import numpy as np
import pytest

from kinebench_drake.suites.composition import KINDS, asset_ids, compose, model
from kinebench_drake.suites.families.registry import EXPERTS, TASKS
from kinebench_drake.suites.families.task import TaskVariant
from kinebench_drake.suites.simulator import Simulator
from tests.suites.bodies import solid_points, visual_points
from tests.suites.scenes import EACH_SCENE

BENCHMARK = [
    "CloseBox-v1",
    "CloseDrawer-v1",
    "CloseFaucet-v1",
    "CloseLaptopEasy-v1",
    "CloseLaptopHard-v1",
    "LiftPegUpright-v1",
    "OpenBoxEasy-v1",
    "OpenBoxEasy-v2",
    "OpenBoxHard-v1",
    "OpenBoxHard-v2",
    "OpenDrawer-v1",
    "OpenFaucet-v1",
    "OpenLaptopEasy-v1",
    "OpenLaptopHard-v1",
    "PickFruits-v1",
    "PullCube-v1",
    "StackCube-v1",
    "StoreCube-v1",
    "StoreCube-v2",
    "StoreFruitsBox-v1",
]
SEEDS = (21, 22)
HOLD_STEPS = 60
"""Number of control steps: three seconds."""
DRIFT_M = 0.004
DRIFT_SHARE = 0.01
"""Tolerated motion at rest: of an object as it settles, and of a joint as a fraction of its range."""


def test_every_task_of_the_benchmark_has_an_expert() -> None:
    assert list(TASKS) == BENCHMARK
    assert sorted(EXPERTS) == BENCHMARK
    assert sum(TaskVariant.OBSTACLES in task.card.variants for task in TASKS.values()) >= 2


@pytest.mark.parametrize("task", TASKS)
def test_every_task_has_a_description_and_an_instruction(task: str) -> None:
    doc = type(TASKS[task]).__doc__ or ""
    for part in ("Description:", "Randomizations:", "Success:"):
        assert part in doc
    for seed in range(4):
        prompt = compose(task, seed).prompt
        assert prompt.startswith("The robot arm ")
        assert prompt.endswith(".")


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_asset_has_20_different_instances(kind: str) -> None:
    assets = [model(asset_id) for asset_id in asset_ids(kind)]
    assert len(assets) >= 20
    assert len({tuple(sorted(m.size.items())) for m in assets}) == len(assets), "instances of the same measures"
    for m in assets:
        assert all(np.isfinite(v.mesh.vertices).all() for body in m.bodies for v in body.visuals)


@pytest.mark.parametrize("kind", KINDS)
def test_colliders_coincide_with_visuals(kind: str) -> None:
    """Bounding boxes of visuals and colliders agree within 12 mm."""
    for asset_id in asset_ids(kind)[::6]:
        for body in model(asset_id).bodies:
            if not body.colliders:
                continue
            visual = visual_points(body)
            solid = solid_points(body)
            assert np.abs(visual.min(axis=0) - solid.min(axis=0)).max() < 0.012, f"{asset_id} {body.name}"
            assert np.abs(visual.max(axis=0) - solid.max(axis=0)).max() < 0.012, f"{asset_id} {body.name}"


@pytest.fixture(scope="module", params=EACH_SCENE)
def simulator(request: pytest.FixtureRequest) -> Iterator[tuple[Simulator, TaskVariant]]:
    task, variant = request.param
    with Simulator(task, variant=variant, renders=False) as simulator:
        yield simulator, variant


@pytest.mark.sapien
def test_initial_scenes_are_at_rest_and_unsolved(simulator: tuple[Simulator, TaskVariant]) -> None:
    own, variant = simulator
    for seed in SEEDS:
        episode = compose(own.task.card.id, seed, variant=variant)
        own.reset(episode)
        outcome = own.outcome()
        assert not outcome.success
        assert outcome.progress <= 0.05
        before = own.scene()
        start = own.snapshot()
        for _ in range(HOLD_STEPS):
            own.step(start.q, start.finger_width_m)
        after = own.scene()
        for name, X in before.poses.items():
            if "/" not in name:
                assert np.linalg.norm(after.poses[name][:3, 3] - X[:3, 3]) < DRIFT_M, f"{name} of seed {seed}"
        for name, joint in before.joints.items():
            travel = before.models[name].bodies[1].joint.upper
            assert abs(after.joints[name] - joint) < DRIFT_SHARE * travel, name
        assert not own.outcome().success


@pytest.mark.sapien
def test_batched_conditions_and_progress_equal_those_of_single_scenes(simulator: tuple[Simulator, TaskVariant]) -> None:
    """Conditions and progress of a batch of two scenes, as in ManiSkill's GPU simulation."""
    import torch

    from kinebench_drake.suites.scene.state import State

    own, variant = simulator
    single = []
    for seed in SEEDS:
        own.reset(compose(own.task.card.id, seed, variant=variant))
        single.append(own.env.state())

    def both(name: str) -> dict[str, torch.Tensor]:
        parts = [getattr(state, name) for state in single]
        return {key: torch.cat([part[key] for part in parts]) for key in parts[0]}

    batch = State(
        X_BG=torch.cat([s.X_BG for s in single]),
        finger_width_m=torch.cat([s.finger_width_m for s in single]),
        **{name: both(name) for name in ("poses", "starts", "joints", "joint_starts", "speeds")},
        models={name: [m for s in single for m in s.models[name]] for name in single[0].models},
        grasps=lambda name: torch.cat([torch.zeros(1, dtype=torch.bool) for _ in single]),
    )
    separate = [own.task.conditions(state) for state in single]
    for name, value in own.task.conditions(batch).items():
        assert value.shape == (2,)
        assert value.dtype == torch.bool
        assert value.tolist() == [bool(s[name][0]) for s in separate]
    progress = own.task.progress(batch)
    assert torch.allclose(progress, torch.cat([own.task.progress(state) for state in single]))
