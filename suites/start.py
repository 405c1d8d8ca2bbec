"""Robot state in the first frame of an episode, without building the scene (no simulator, no PyTorch)."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.suites.seeding import generator

START_Q = np.array([0.0, -0.272, 0.0, -2.542, 0.0, 2.27, np.pi / 4])
"""Initial joint angles [rad]: the gripper points down from (0.43, 0, 0.27) m in B, above and behind the objects, so
that the first frame shows them. (In ManiSkill's own tabletop tasks it is in front of them.)"""

_OPEN = (
    "CloseDrawer-v1", "LiftPegUpright-v1", "OpenDrawer-v1", "OpenLaptopEasy-v1", "OpenLaptopHard-v1", "PickFruits-v1",
    "StackCube-v1", "StoreCube-v1", "StoreCube-v2", "StoreFruitsBox-v1",
)  # fmt: skip
_SHUT = (
    "CloseBox-v1", "CloseFaucet-v1", "CloseLaptopEasy-v1", "CloseLaptopHard-v1", "OpenBoxEasy-v1", "OpenBoxEasy-v2",
    "OpenBoxHard-v1", "OpenBoxHard-v2", "OpenFaucet-v1", "PullCube-v1",
)  # fmt: skip
START_WIDTH_M: Mapping[str, float] = {task: 0.08 if task in _OPEN else 0.0 for task in sorted(_OPEN + _SHUT)}
"""Initial gap between the finger pads of each task; not in the task modules, as these load PyTorch."""
START_SIGMA_RAD = 0.02
"""Standard deviation of the noise of each initial joint angle."""


def start_q(task_id: str, seed: int, finger_width_m: float | None = None) -> NDArray[np.float64]:
    """Return the joint positions (9,) in an episode's first frame: seven of the arm [rad], two of the fingers [m].

    Args:
        finger_width_m: gap between the finger pads [m]; None: that of the benchmark task.

    Raises:
        UsageError: there is no such benchmark task, and no gap is given.
    """
    if finger_width_m is None:
        if task_id not in START_WIDTH_M:
            raise UsageError(f"no task {task_id!r}; there are {', '.join(START_WIDTH_M)}")
        finger_width_m = START_WIDTH_M[task_id]
    noise = generator("start", task_id, seed).normal(0.0, START_SIGMA_RAD, 7)
    return np.concatenate([START_Q + noise, np.full(2, finger_width_m / 2.0)])


_DECIMALS = 9


def first_facts(X_BG: Array, finger_width_m: float) -> dict[str, Any]:
    """Return the manifest keys of the initial pose (4, 4) of panda_hand_tcp in the base frame and finger gap [m]."""
    pose = X_BG.round(_DECIMALS) + 0.0  # no -0.0
    return {"first_base_from_tcp": pose.tolist(), "first_finger_width_m": round(finger_width_m, _DECIMALS) + 0.0}
