"""A task of your own: push a cube onto a target (docs/tasks.md, "Your own task").

kinebench-drake suite run --suite 0 --tasks examples/push_cube.py:PushCube --world-model oracle --episodes 2 --out push/
"""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from kinebench_drake.geometry import make_pose
from kinebench_drake.suites.expert.grasp import DOWN, closed_waypoint, grasp_rotation, lift
from kinebench_drake.suites.expert.motion import Waypoint
from kinebench_drake.suites.families.task import Difficulty, Placement, Scene, SceneLayout, Task, TaskCard, TaskVariant
from kinebench_drake.suites.scene.model import AssetModel
from kinebench_drake.suites.scene.state import STILL_M_S, State

FINGER_M = 0.011
"""Half the width of a finger."""


class PushCube(Task):
    """Push the blue cube onto the target.

    Description: a cube lies in front of the robot, a target beyond it; push the cube onto it with closed fingers.
    Randomizations: positions of both; yaw, size, shade, finish and mass of the cube; radius of the target.
    Success: the cube's centre is over the target (`on_target`), and the cube is slower than `STILL_M_S` (`still`).
    """

    card = TaskCard(id="PushCube-v1", family="cubes", difficulty=Difficulty.EASY)
    slots: ClassVar[Mapping[str, str]] = {"cube": "cube/blue", "target": "mark/target"}

    def layout(self, models: Mapping[str, AssetModel], rng: np.random.Generator, variant: TaskVariant) -> SceneLayout:
        """Place the cube, and the target 13 to 16 cm farther from the robot."""
        x, y = rng.uniform([0.42, -0.08], [0.46, 0.08])
        height = models["cube"].size["edge_m"] / 2.0
        return SceneLayout(
            placements={
                "cube": Placement.upright(models["cube"], (x, y, height), rng.uniform(-0.3, 0.3)),
                "target": Placement.upright(models["target"], (x + rng.uniform(0.13, 0.16), y, 0.0), decor=True),
            },
            prompt="The robot arm pushes the blue cube forward onto the red and white target.",
            finger_width_m=0.0,
        )

    def conditions(self, state: State) -> dict[str, Tensor]:
        """Return the conditions of the class docstring."""
        offset = (state.position("cube") - state.position("target"))[:, :2]
        return {
            "on_target": torch.linalg.norm(offset, dim=-1) <= state.size("target", "radius_m"),
            "still": state.speeds["cube"] <= STILL_M_S,
        }

    def progress(self, state: State) -> Tensor:
        """Return the fraction of the cube's way to the target's centre."""
        goal = state.position("target").clone()
        goal[:, 2] = state.starts["cube"][:, 2, 3]
        return state.distance_progress("cube", goal)

    def expert(self, scene: Scene) -> list[Waypoint]:
        """Come down behind the cube and push it to the target's centre."""
        cube = scene.poses["cube"][:3, 3]
        goal = scene.poses["target"][:3, 3]
        R = grasp_rotation(DOWN, scene.X_BG[:3, 1])
        edge = scene.size("cube", "edge_m")
        behind = make_pose(R, [cube[0] - 0.7 * edge - FINGER_M - 0.01, cube[1], 0.02])
        end = make_pose(R, [goal[0] - 0.5 * edge - FINGER_M, goal[1], 0.02])
        return [
            closed_waypoint(lift(behind, 0.1), through=True),
            closed_waypoint(behind),
            closed_waypoint(end, pace=1.3),
            closed_waypoint(lift(end, 0.1)),
        ]
