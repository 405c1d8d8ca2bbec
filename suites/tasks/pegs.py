"""Tasks with a peg."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from kinebench_drake.suites.assets.model import Model
from kinebench_drake.suites.tasks.card import Difficulty, TaskCard, TaskVariant
from kinebench_drake.suites.tasks.layout import resting
from kinebench_drake.suites.tasks.state import STILL_M_S, State
from kinebench_drake.suites.tasks.task import Placement, SceneLayout, Task

UPRIGHT_RAD = 0.08
"""How far the peg may lean from the vertical."""
HEIGHT_M = 0.005
"""How far the height of its middle may differ from that of a standing peg."""
YAW_RAD = 0.35
"""How far the lying peg may point aside from straight away from the robot."""


class LiftPegUpright(Task):
    """Stand the peg upright on its blue end.

    Description: a peg with a red and a blue end lies on the table, the red end towards the robot; grasp it by the red
    end, stand it up, let go.
    Randomizations: the peg's place, direction (within 20 degrees), length, width, shades, finish and weight.
    Success: the peg is upright, the red end up (`upright`), stands on the table (`standing`), is still and let go.
    """

    card = TaskCard(
        id="LiftPegUpright-v1", family="pegs", difficulty=Difficulty.MEDIUM, articulated_dof=0, axes="", contacts=1
    )
    slots: ClassVar[Mapping[str, str]] = {"peg": "peg"}

    def layout(self, models: Mapping[str, Model], rng: np.random.Generator, variant: TaskVariant) -> SceneLayout:
        """The peg, lying in front of the robot."""
        x, y = rng.uniform([0.51, -0.10], [0.60, 0.10])
        yaw = rng.uniform(-YAW_RAD, YAW_RAD)
        X_BM = resting(x, y, models["peg"].size["width_m"] / 2.0, yaw)
        return SceneLayout(
            placements={"peg": Placement(model=models["peg"], X_BM=X_BM)},
            prompt="The robot arm grasps the peg by its red end, stands it upright on its blue end and lets go.",
        )

    def conditions(self, state: State) -> dict[str, Tensor]:
        """See the class."""
        height = state.position("peg")[:, 2] - 0.5 * state.size("peg", "length_m")
        return {
            "upright": -state.poses["peg"][:, 2, 0] >= float(np.cos(UPRIGHT_RAD)),
            "standing": height.abs() <= HEIGHT_M,
            "still": state.speeds["peg"] <= STILL_M_S,
            "released": ~state.grasps("peg"),
        }

    def progress(self, state: State) -> Tensor:
        """How far the peg has been turned up, as part of a right angle."""
        return torch.asin((-state.poses["peg"][:, 2, 0]).clamp(-1.0, 1.0)) / (0.5 * np.pi)


TASKS = (LiftPegUpright(),)
"""Tasks of this family."""
