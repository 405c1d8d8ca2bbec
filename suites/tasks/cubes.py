"""Tasks with small cubes."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from kinebench_drake.suites.assets.model import Model
from kinebench_drake.suites.tasks.card import Difficulty, TaskCard, Variant
from kinebench_drake.suites.tasks.place import resting, scattered
from kinebench_drake.suites.tasks.state import State
from kinebench_drake.suites.tasks.task import Layout, Placement, Task

STILL_M_S = 0.02
"""Things slower than this are at rest."""
STACK_LEVEL_M = 0.012
"""How far the upper cube's centre may be off above the lower one's, sideways."""
STACK_HEIGHT_M = 0.006
"""How far the height of one centre above the other may differ from that of a stack."""


class StackCube(Task):
    """Put the green cube on the red one.

    Description: two cubes lie on the table; grasp the green one, put it on the red one, let go.
    Randomizations: both positions and directions, sizes, colours' shades, weights.
    Success: the green cube is over the red one (`above`), rests on it (`on_top`), is still and let go.
    """

    card = TaskCard(
        id="StackCube-v1", family="cubes", difficulty=Difficulty.MEDIUM, articulated_dof=0, axes="", contacts=1
    )
    slots: ClassVar[Mapping[str, str]] = {"green": "cube/green", "red": "cube/red"}

    def layout(self, models: Mapping[str, Model], rng: np.random.Generator, variant: Variant) -> Layout:
        """Two cubes at least 9 cm apart in front of the robot."""
        points = scattered(rng, 2, [0.48, -0.15], [0.66, 0.15], 0.09)
        placements = {
            name: Placement(
                model=models[name],
                X_BM=resting(*point, models[name].size["edge_m"] / 2.0, rng.uniform(-np.pi, np.pi)),
            )
            for name, point in zip(("green", "red"), points, strict=True)
        }
        return Layout(
            placements=placements,
            prompt="The robot arm picks up the green cube, puts it on top of the red cube and lets go.",
        )

    def conditions(self, state: State) -> dict[str, Tensor]:
        """See the class."""
        offset = state.position("green") - state.position("red")
        height = 0.5 * (state.size("green", "edge_m") + state.size("red", "edge_m"))
        return {
            "above": torch.linalg.norm(offset[:, :2], dim=-1) <= STACK_LEVEL_M,
            "on_top": (offset[:, 2] - height).abs() <= STACK_HEIGHT_M,
            "still": state.speeds["green"] <= STILL_M_S,
            "released": ~state.grasps("green"),
        }

    def progress(self, state: State) -> Tensor:
        """Part of the way from the green cube's place to the top of the red one."""
        goal = state.position("red").clone()
        goal[:, 2] += 0.5 * (state.size("green", "edge_m") + state.size("red", "edge_m"))
        return state.approached("green", goal)


TASKS = (StackCube(),)
"""Tasks of this family."""
