"""Tasks with small cubes."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from kinebench_drake.geometry import Array
from kinebench_drake.suites.assets.model import Model
from kinebench_drake.suites.start import START_WIDTH_M
from kinebench_drake.suites.tasks.card import Difficulty, TaskCard, TaskVariant
from kinebench_drake.suites.tasks.layout import resting, scattered, undisturbed
from kinebench_drake.suites.tasks.state import STILL_M_S, State
from kinebench_drake.suites.tasks.task import Placement, SceneLayout, Task

STACK_LEVEL_M = 0.012
"""How far the upper cube's centre may be off above the lower one's, sideways."""
STACK_HEIGHT_M = 0.006
"""How far the height of one centre above the other may differ from that of a stack."""
ON_TABLE_M = 0.005
"""How far the height of a cube's centre may differ from that of a cube on the table."""


def _on_table(model: Model, xy_m: Array, yaw_rad: float) -> Array:
    """Pose (4, 4) of a cube that lies on the table."""
    return resting(xy_m[0], xy_m[1], model.size["edge_m"] / 2.0, yaw_rad)


class StackCube(Task):
    """Put the green cube on the red one.

    Description: two cubes lie on the table; grasp the green one, put it on the red one, let go. With obstacles,
    something upright stands between them.
    Randomizations: all positions and directions, sizes, colours' shades, finishes, weights.
    Success: the green cube is over the red one (`above`), rests on it (`on_top`), is still and let go. The obstacle
    stands upright where it stood.
    """

    card = TaskCard(
        id="StackCube-v1",
        family="cubes",
        difficulty=Difficulty.MEDIUM,
        articulated_dof=0,
        axes="",
        contacts=1,
        variants=(TaskVariant.PLAIN, TaskVariant.OBSTACLES),
    )
    slots: ClassVar[Mapping[str, str]] = {"green": "cube/green", "red": "cube/red"}

    def slots_of(self, variant: TaskVariant) -> Mapping[str, str]:
        """With obstacles there is one more thing."""
        return self.slots if variant is TaskVariant.PLAIN else {**self.slots, "obstacle": "obstacle/upright"}

    def layout(self, models: Mapping[str, Model], rng: np.random.Generator, variant: TaskVariant) -> SceneLayout:
        """Two cubes at least 9 cm apart in front of the robot, or side by side with the obstacle between."""
        prompt = "The robot arm picks up the green cube, puts it on top of the red cube and lets go."
        if variant is TaskVariant.PLAIN:
            points = scattered(rng, 2, [0.48, -0.15], [0.66, 0.15], 0.09)
        else:
            middle, angle = rng.uniform([0.52, -0.04], [0.60, 0.04]), rng.uniform(-0.5, 0.5)
            side = rng.choice([-1.0, 1.0]) * np.array([np.sin(angle), np.cos(angle)])
            points = np.stack([middle + rng.uniform(0.11, 0.15) * side, middle - rng.uniform(0.11, 0.15) * side])
            prompt += f" It does not touch the {models['obstacle'].words} that stands between them."
        placements = {
            name: Placement(model=models[name], X_BM=_on_table(models[name], point, rng.uniform(-np.pi, np.pi)))
            for name, point in zip(("green", "red"), points, strict=True)
        }
        if variant is TaskVariant.OBSTACLES:
            placements["obstacle"] = Placement(
                model=models["obstacle"],
                X_BM=resting(middle[0], middle[1], 0.0, rng.uniform(-np.pi, np.pi)),
                avoid=True,
            )
        return SceneLayout(placements=placements, prompt=prompt)

    def conditions(self, state: State) -> dict[str, Tensor]:
        """See the class."""
        offset = state.position("green") - state.position("red")
        height = 0.5 * (state.size("green", "edge_m") + state.size("red", "edge_m"))
        conditions = {
            "above": torch.linalg.norm(offset[:, :2], dim=-1) <= STACK_LEVEL_M,
            "on_top": (offset[:, 2] - height).abs() <= STACK_HEIGHT_M,
            "still": state.speeds["green"] <= STILL_M_S,
            "released": ~state.grasps("green"),
        }
        return conditions | (undisturbed(state, "obstacle") if "obstacle" in state.poses else {})

    def progress(self, state: State) -> Tensor:
        """Part of the way from the green cube's place to the top of the red one."""
        goal = state.position("red").clone()
        goal[:, 2] += 0.5 * (state.size("green", "edge_m") + state.size("red", "edge_m"))
        return state.approached("green", goal)


class PullCube(Task):
    """Drag the blue cube back onto the target.

    Description: a cube lies on the table, a target of red and white rings nearer to the robot; reach over the cube with
    the closed gripper and drag it back onto the target.
    Randomizations: the target's place and size, the cube's distance and direction from it, the cube's own direction,
    size, colour's shade, finish, weight.
    Success: the cube's centre is over the target (`on_target`), on the table (`on_table`) and still.
    """

    card = TaskCard(
        id="PullCube-v1", family="cubes", difficulty=Difficulty.EASY, articulated_dof=0, axes="", contacts=1
    )
    slots: ClassVar[Mapping[str, str]] = {"cube": "cube/blue", "target": "mark/target"}

    def layout(self, models: Mapping[str, Model], rng: np.random.Generator, variant: TaskVariant) -> SceneLayout:
        """The target, and the cube 13 to 18 cm farther from the robot."""
        target, angle = rng.uniform([0.43, -0.10], [0.48, 0.10]), rng.uniform(-0.3, 0.3)
        cube = target + rng.uniform(0.13, 0.18) * np.array([np.cos(angle), np.sin(angle)])
        yaw = angle + rng.uniform(-0.25, 0.25)
        return SceneLayout(
            placements={
                "cube": Placement(model=models["cube"], X_BM=_on_table(models["cube"], cube, yaw)),
                "target": Placement(model=models["target"], X_BM=resting(target[0], target[1], 0.0), decor=True),
            },
            prompt="The robot arm closes its gripper, reaches over the blue cube and drags it back "
            "onto the red and white target.",
            finger_width_m=START_WIDTH_M[self.card.id],
        )

    def conditions(self, state: State) -> dict[str, Tensor]:
        """See the class."""
        offset = state.position("cube") - state.position("target")
        height = state.position("cube")[:, 2] - 0.5 * state.size("cube", "edge_m")
        return {
            "on_target": torch.linalg.norm(offset[:, :2], dim=-1) <= state.size("target", "radius_m"),
            "on_table": height.abs() <= ON_TABLE_M,
            "still": state.speeds["cube"] <= STILL_M_S,
        }

    def progress(self, state: State) -> Tensor:
        """Part of the cube's way to the target's middle."""
        goal = state.position("target").clone()
        goal[:, 2] = state.starts["cube"][:, 2, 3]
        return state.approached("cube", goal)


TASKS = (PullCube(), StackCube())
"""Tasks of this family."""
