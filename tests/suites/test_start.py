"""State of the robot in the first frame, computed without a scene."""

import numpy as np
import pytest

from kinebench_drake.errors import UsageError
from kinebench_drake.suites.composition import Pool, compose
from kinebench_drake.suites.families.registry import TASKS
from kinebench_drake.suites.simulator import Simulator
from kinebench_drake.suites.start import START_WIDTH_M, start_q


def test_start_widths_equal_those_of_the_composed_tasks() -> None:
    assert {task: compose(task, 0).layout().finger_width_m for task in TASKS} == START_WIDTH_M


def test_an_unknown_task_needs_an_explicit_finger_width() -> None:
    with pytest.raises(UsageError, match="StackCube-v1"):
        start_q("Juggle-v1", 0)
    assert start_q("Juggle-v1", 0, 0.05)[7:].tolist() == [0.025, 0.025]


@pytest.mark.sapien
@pytest.mark.parametrize(
    ("task", "seed", "pool"), [("CloseLaptopHard-v1", 3, Pool.ALL), ("StackCube-v1", 7, Pool.SEEN)]
)
def test_the_robot_after_a_reset_is_at_the_computed_start_state(task: str, seed: int, pool: Pool) -> None:
    with Simulator(task, renders=False) as stage:
        stage.reset(compose(task, seed, pool=pool))
        start = stage.snapshot()
    assert np.allclose(np.concatenate([start.q, start.fingers_m]), start_q(task, seed), atol=1e-6)
    assert not np.allclose(start.q, start_q(task, seed + 1)[:7], atol=1e-3)
