"""The robot in the first frame, told without a scene."""

import numpy as np
import pytest

from kinebench_drake.errors import UsageError
from kinebench_drake.suites.composition import Pool, compose
from kinebench_drake.suites.families.registry import TASKS
from kinebench_drake.suites.simulator import Simulator
from kinebench_drake.suites.start import START_WIDTH_M, start_q


def test_every_task_of_the_benchmark_has_its_gap() -> None:
    assert {task: compose(task, 0).layout().finger_width_m for task in TASKS} == START_WIDTH_M


def test_a_task_that_is_not_known_needs_a_gap() -> None:
    with pytest.raises(UsageError, match="StackCube-v1"):
        start_q("Juggle-v1", 0)
    assert start_q("Juggle-v1", 0, 0.05)[7:].tolist() == [0.025, 0.025]


@pytest.mark.sapien
@pytest.mark.parametrize(
    ("task", "seed", "pool"), [("CloseLaptopHard-v1", 3, Pool.ALL), ("StackCube-v1", 7, Pool.SEEN)]
)
def test_a_reset_puts_the_robot_there(task: str, seed: int, pool: Pool) -> None:
    with Simulator(task, renders=False) as stage:
        stage.reset(compose(task, seed, pool=pool))
        start = stage.snapshot()
    assert np.allclose(np.concatenate([start.q, start.fingers_m]), start_q(task, seed), atol=1e-6)
    assert not np.allclose(start.q, start_q(task, seed + 1)[:7], atol=1e-3)
