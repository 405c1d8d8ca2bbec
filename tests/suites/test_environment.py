"""Environments: names, reproducibility by seed, observations and rewards."""

import hashlib
import subprocess
import sys
from collections.abc import Iterator

import numpy as np
import pytest

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.geometry import pose_difference
from kinebench_drake.suites.composition import Pool, compose, model
from kinebench_drake.suites.families.registry import TASKS, find_expert
from kinebench_drake.suites.families.task import TaskVariant
from kinebench_drake.suites.rollout import run_expert
from kinebench_drake.suites.simulator import Simulator
from tests.suites.scenes import EACH_TASK

TASK = "StackCube-v1"


@pytest.fixture(scope="module")
def simulator() -> Iterator[Simulator]:
    with Simulator(TASK) as simulator:
        yield simulator


def picture_hash(simulator: Simulator) -> str:
    p = simulator.render()
    return hashlib.sha256(p.rgb.tobytes() + p.depth_mm.tobytes() + p.mask.tobytes()).hexdigest()


@pytest.mark.sapien
def test_environment_names_do_not_shadow_those_of_maniskill() -> None:
    import gymnasium
    from mani_skill.envs.tasks import StackCubeEnv
    from mani_skill.utils.registration import REGISTERED_ENVS

    from kinebench_drake.suites.scene.environment import KineBenchEnv, register

    register()
    register()
    assert REGISTERED_ENVS["StackCube-v1"].cls is StackCubeEnv
    for task in TASKS:
        assert REGISTERED_ENVS[f"KineBench/{task}"].cls is KineBenchEnv
        assert gymnasium.spec(f"KineBench/{task}").max_episode_steps == 192 * TASKS[task].card.clips


@pytest.mark.sapien
def test_a_seed_gives_the_same_first_frame_regardless_of_earlier_episodes(simulator: Simulator) -> None:
    simulator.reset(compose(TASK, 5))
    first = picture_hash(simulator)
    simulator.reset(compose(TASK, 6))
    assert picture_hash(simulator) != first
    simulator.reset(compose(TASK, 5))
    assert picture_hash(simulator) == first
    code = (
        "import hashlib\n"
        "from kinebench_drake.suites.composition import compose\n"
        "from kinebench_drake.suites.simulator import Simulator\n"
        f"with Simulator({TASK!r}) as simulator:\n"
        f"    simulator.reset(compose({TASK!r}, 5))\n"
        "    p = simulator.render()\n"
        "    print(hashlib.sha256(p.rgb.tobytes() + p.depth_mm.tobytes() + p.mask.tobytes()).hexdigest())\n"
    )
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert other.stdout.split()[-1] == first


@pytest.mark.sapien
def test_a_seed_gives_the_same_motion_regardless_of_earlier_episodes(simulator: Simulator) -> None:
    def run() -> np.ndarray:
        performance = run_expert(simulator, find_expert(TASK), compose(TASK, 2))
        return np.stack([np.concatenate([s.q, *s.objects.values()]) for s in performance.snapshots])

    first = run()
    run_expert(simulator, find_expert(TASK), compose(TASK, 3))
    assert np.array_equal(run(), first)


@pytest.mark.sapien
def test_gymnasium_make_composes_the_same_episodes_as_the_simulator(simulator: Simulator) -> None:
    import gymnasium

    from kinebench_drake.suites.scene.environment import register

    register()
    simulator.reset(compose(TASK, 9))
    expected = simulator.scene()
    env = gymnasium.make(
        f"KineBench/{TASK}", obs_mode="state", sim_backend="cpu", render_backend="none", control_mode="pd_joint_pos"
    )
    env.reset(seed=9)
    scene = env.unwrapped.first_scene()
    assert env.unwrapped.episode == compose(TASK, 9)
    for name, X in expected.poses.items():
        assert np.array_equal(scene.poses[name], X)
    _, reward, _, _, info = env.step(env.action_space.sample())
    assert 0.0 <= float(reward) <= 1.0
    assert {"success", "progress", *TASKS[TASK].conditions(env.unwrapped.state())} <= set(info)
    env.close()


@pytest.mark.sapien
def test_episodes_of_another_task_are_refused(simulator: Simulator) -> None:
    other = next(task for task in TASKS if task != TASK)
    with pytest.raises(InputError, match=other):
        simulator.reset(compose(other, 0))


@pytest.mark.sapien
def test_several_scenes_in_one_environment_are_refused() -> None:
    from kinebench_drake.suites.scene.environment import KineBenchEnv

    with pytest.raises(UsageError, match="num_envs is 2, expected 1"):
        KineBenchEnv(task=TASK, num_envs=2)


def test_unknown_tasks_and_variants_are_usage_errors() -> None:
    with pytest.raises(UsageError, match="StackCube-v1"):
        compose("StackCubes", 0)
    plain = next(task for task, t in TASKS.items() if TaskVariant.OBSTACLES not in t.card.variants)
    with pytest.raises(UsageError, match="obstacles"):
        compose(plain, 0, variant=TaskVariant.OBSTACLES)


@pytest.mark.parametrize("task", TASKS)
def test_episodes_repeat_by_seed_and_pools_share_no_asset(task: str) -> None:
    ids = {compose(task, seed).id for seed in range(5)}
    assert len(ids) == 5
    episode = compose(task, 3)
    poses = {name: placement.X_BM for name, placement in episode.layout().placements.items()}
    model.cache_clear()  # the assets are made anew
    assert compose(task, 3) == episode
    again = {name: placement.X_BM for name, placement in compose(task, 3).layout().placements.items()}
    np.testing.assert_equal(again, poses)
    names = {tuple(compose(task, seed).layout().placements) for seed in range(20)}
    assert len(names) == 1, "conditions and experts name the objects"
    assert set(compose(task, 3, pool=Pool.SEEN).assets.values()).isdisjoint(
        compose(task, 4, pool=Pool.UNSEEN).assets.values()
    )


@pytest.mark.sapien
@pytest.mark.parametrize("task", EACH_TASK)
def test_poses_of_a_layout_equal_those_of_the_simulated_scene(task: str) -> None:
    episode = compose(task, 1)
    with Simulator(task, renders=False) as simulator:
        simulator.reset(episode)
        scene = simulator.scene()
    expected = episode.layout().scene(scene.X_BG)
    for name, X in expected.poses.items():
        distance, angle = pose_difference(scene.poses[name][None], X[None])
        assert distance[0] < 1e-5, name
        assert angle[0] < 1e-3, name
