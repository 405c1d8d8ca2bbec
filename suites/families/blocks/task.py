"""Tasks with blocks: cubes to stack and to pull, and a peg to stand upright."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor
from typing_extensions import override

from kinebench_drake.geometry import Array
from kinebench_drake.suites.families.task import Difficulty, Placement, SceneLayout, Task, TaskCard, TaskVariant
from kinebench_drake.suites.scene.model import AssetModel
from kinebench_drake.suites.scene.state import STILL_M_S, State
from kinebench_drake.suites.start import START_WIDTH_M

APART_M = 0.09
"""Least initial distance between the centres of two cubes."""
STACK_RADIUS_M = 0.012
"""Greatest horizontal distance of the upper cube's centre from the lower one's."""
STACK_HEIGHT_M = 0.006
"""Greatest error of the height of the upper cube's centre above the lower one's."""
ON_TABLE_M = 0.005
"""Greatest error of the height of a cube's centre above the table."""
PEG_TILT_RAD = 0.08
"""Greatest tilt of the peg from the vertical."""
PEG_HEIGHT_M = 0.005
"""Greatest error of the height of the standing peg's centre above the table."""
PEG_YAW_RAD = 0.35
"""Greatest initial yaw of the peg from pointing straight away from the robot."""


def _on_table(model: AssetModel, xy_m: Array, yaw_rad: float) -> Placement:
    """Place a cube on the table."""
    return Placement.upright(model, (xy_m[0], xy_m[1], model.size["edge_m"] / 2.0), yaw_rad)


class StackCube(Task):
    """Put the green cube on the red one.

    Description: two cubes lie on the table; grasp the green one, put it on the red one and release it. With obstacles,
    an upright object stands between them.
    Randomizations: positions and yaws of all objects; sizes, shades, finishes and masses of the cubes.
    Success: the green cube's centre is within `STACK_RADIUS_M` above the red one's (`above`), at its height on the red
    cube within `STACK_HEIGHT_M` (`on_top`), slower than `STILL_M_S` (`still`), and not grasped (`released`). An
    obstacle stands upright within `MOVED_M` of its place (`obstacle_upright`, `obstacle_in_place`).
    """

    card = TaskCard(
        id="StackCube-v1",
        family="cubes",
        difficulty=Difficulty.MEDIUM,
        variants=(TaskVariant.PLAIN, TaskVariant.OBSTACLES),
    )
    slots: ClassVar[Mapping[str, str]] = {"green": "cube/green", "red": "cube/red"}

    def layout(self, models: Mapping[str, AssetModel], rng: np.random.Generator, variant: TaskVariant) -> SceneLayout:
        """Place two cubes at least `APART_M` apart, or side by side with the obstacle between them."""
        prompt = "The robot arm picks up the green cube, puts it on top of the red cube and lets go."
        if variant is TaskVariant.PLAIN:
            points = np.zeros((2, 2))
            while np.linalg.norm(points[0] - points[1]) < APART_M:
                points = rng.uniform([0.48, -0.15], [0.66, 0.15], size=(2, 2))
        else:
            middle = rng.uniform([0.52, -0.04], [0.60, 0.04])
            angle = rng.uniform(-0.5, 0.5)
            side = rng.choice([-1.0, 1.0]) * np.array([np.sin(angle), np.cos(angle)])
            points = np.stack([middle + rng.uniform(0.11, 0.15) * side, middle - rng.uniform(0.11, 0.15) * side])
            prompt += f" It does not touch the {models['obstacle'].words} that stands between them."
        placements = {
            name: _on_table(models[name], point, rng.uniform(-np.pi, np.pi))
            for name, point in zip(("green", "red"), points, strict=True)
        }
        if variant is TaskVariant.OBSTACLES:
            placements["obstacle"] = Placement.upright(
                models["obstacle"], (middle[0], middle[1], 0.0), rng.uniform(-np.pi, np.pi), avoid=True
            )
        return SceneLayout(placements=placements, prompt=prompt)

    @override
    def conditions(self, state: State) -> dict[str, Tensor]:
        offset = state.position("green") - state.position("red")
        return {
            "above": torch.linalg.norm(offset[:, :2], dim=-1) <= STACK_RADIUS_M,
            "on_top": (offset[:, 2] - self._height(state)).abs() <= STACK_HEIGHT_M,
            **state.release_conditions("green"),
        } | state.obstacle_conditions()

    def _height(self, state: State) -> Tensor:
        """Return the height (N,) of the green cube's centre above the red one's in a stack [m]."""
        return 0.5 * (state.size("green", "edge_m") + state.size("red", "edge_m"))

    def progress(self, state: State) -> Tensor:
        """Return the fraction of the green cube's way to the top of the red one."""
        goal = state.position("red").clone()
        goal[:, 2] += self._height(state)
        return state.distance_progress("green", goal)


class PullCube(Task):
    """Drag the blue cube back onto the target.

    Description: a cube lies on the table, a target of red and white rings nearer to the robot; reach over the cube with
    the closed gripper and drag it back onto the target.
    Randomizations: position and radius of the target; distance and direction of the cube from it; yaw, size, shade,
    finish and mass of the cube.
    Success: the cube's centre is over the target (`on_target`), at its height on the table within `ON_TABLE_M`
    (`on_table`), and slower than `STILL_M_S` (`still`).
    """

    card = TaskCard(id="PullCube-v1", family="cubes", difficulty=Difficulty.EASY)
    slots: ClassVar[Mapping[str, str]] = {"cube": "cube/blue", "target": "mark/target"}

    def layout(self, models: Mapping[str, AssetModel], rng: np.random.Generator, variant: TaskVariant) -> SceneLayout:
        """Place the target, and the cube 13 to 18 cm farther from the robot."""
        target = rng.uniform([0.43, -0.10], [0.48, 0.10])
        angle = rng.uniform(-0.3, 0.3)
        cube = target + rng.uniform(0.13, 0.18) * np.array([np.cos(angle), np.sin(angle)])
        return SceneLayout(
            placements={
                "cube": _on_table(models["cube"], cube, angle + rng.uniform(-0.25, 0.25)),
                "target": Placement.upright(models["target"], (target[0], target[1], 0.0), decor=True),
            },
            prompt="The robot arm closes its gripper, reaches over the blue cube and drags it back "
            "onto the red and white target.",
            finger_width_m=START_WIDTH_M[self.card.id],
        )

    @override
    def conditions(self, state: State) -> dict[str, Tensor]:
        offset = state.position("cube") - state.position("target")
        height = state.position("cube")[:, 2] - 0.5 * state.size("cube", "edge_m")
        return {
            "on_target": torch.linalg.norm(offset[:, :2], dim=-1) <= state.size("target", "radius_m"),
            "on_table": height.abs() <= ON_TABLE_M,
            "still": state.speeds["cube"] <= STILL_M_S,
        }

    def progress(self, state: State) -> Tensor:
        """Return the fraction of the cube's way to the target's centre."""
        goal = state.position("target").clone()
        goal[:, 2] = state.starts["cube"][:, 2, 3]
        return state.distance_progress("cube", goal)


class LiftPegUpright(Task):
    """Stand the peg upright on its blue end.

    Description: a peg with a red and a blue end lies on the table, the red end towards the robot; grasp it by the red
    end, stand it up and release it.
    Randomizations: position and yaw (up to `PEG_YAW_RAD`) of the peg; its length, width, shades, finish and mass.
    Success: the peg is within `PEG_TILT_RAD` of the vertical, the red end up (`upright`), its centre at the height of a
    standing peg's within `PEG_HEIGHT_M` (`standing`), slower than `STILL_M_S` (`still`), and not grasped (`released`).
    """

    card = TaskCard(id="LiftPegUpright-v1", family="pegs", difficulty=Difficulty.MEDIUM)
    slots: ClassVar[Mapping[str, str]] = {"peg": "peg"}

    def layout(self, models: Mapping[str, AssetModel], rng: np.random.Generator, variant: TaskVariant) -> SceneLayout:
        """Place the peg lying in front of the robot."""
        x, y = rng.uniform([0.51, -0.10], [0.60, 0.10])
        yaw = rng.uniform(-PEG_YAW_RAD, PEG_YAW_RAD)
        p_BM = (x, y, models["peg"].size["width_m"] / 2.0)
        return SceneLayout(
            placements={"peg": Placement.upright(models["peg"], p_BM, yaw)},
            prompt="The robot arm grasps the peg by its red end, stands it upright on its blue end and lets go.",
        )

    @override
    def conditions(self, state: State) -> dict[str, Tensor]:
        height = state.position("peg")[:, 2] - 0.5 * state.size("peg", "length_m")
        return {
            "upright": -state.poses["peg"][:, 2, 0] >= float(np.cos(PEG_TILT_RAD)),
            "standing": height.abs() <= PEG_HEIGHT_M,
            **state.release_conditions("peg"),
        }

    def progress(self, state: State) -> Tensor:
        """Return the angle by which the red end is raised, as a fraction of a right angle."""
        return torch.asin((-state.poses["peg"][:, 2, 0]).clamp(-1.0, 1.0)) / (0.5 * np.pi)


TASKS = (PullCube(), StackCube(), LiftPegUpright())
"""Tasks of this family."""
