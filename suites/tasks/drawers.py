"""Tasks with a drawer."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.suites.assets.model import Model
from kinebench_drake.suites.tasks.card import Difficulty, TaskCard, TaskVariant
from kinebench_drake.suites.tasks.layout import resting, turned
from kinebench_drake.suites.tasks.state import CLEAR_M, STILL_M_S, State
from kinebench_drake.suites.tasks.task import Placement, SceneLayout, Task

OPEN_SHARE = 0.9
"""Part of its way that an open drawer has come out."""
SHUT_M = 0.008
"""A drawer that is open by no more than this is shut."""
HEAP_M = 0.045
"""How far above the tray's floor the middle of something that lies in it may be."""
YAW_RAD = 0.25
"""How far a cabinet may be turned to either side."""
AJAR = 0.92
"""Least part of its way that the drawer is open when a cube is to go into it."""
ASKEW_RAD = 0.3
"""How far a cube that is to be dragged may be turned against the drawer's way."""


def _shut(state: State) -> Tensor:
    return state.joints["cabinet"] <= SHUT_M


def _still(state: State, name: str) -> Tensor:
    return state.speeds[name] <= STILL_M_S


def _left(state: State) -> dict[str, Tensor]:
    """What opening and shutting ask for in the end."""
    away = torch.linalg.norm(state.X_BG[:, :3, 3] - state.site("cabinet", "pull")[:, :3, 3], dim=-1)
    return {"still": _still(state, "cabinet"), "calm": state.calm(), "released": away >= CLEAR_M}


def _outside_by(state: State, poses: Mapping[str, Tensor], name: str) -> Tensor:
    """How far (N,) the middle of a thing is outside the room of the tray in which it may lie [m]; 0 inside."""
    X_BD = poses["cabinet/drawer"]
    tray = torch.stack([torch.as_tensor(m.sites["tray"].X_BodyS[:3, 3]) for m in state.models["cabinet"]])
    p = (X_BD[:, :3, :3].mT @ (poses[name][:, :3, 3] - X_BD[:, :3, 3])[..., None])[..., 0] - tray.to(X_BD)
    half = 0.5 * torch.stack([state.size("cabinet", "tray_length_m"), state.size("cabinet", "tray_width_m")], dim=-1)
    beside = (p[:, :2].abs() - half).clamp(min=0.0)
    over = torch.maximum(p[:, 2] - HEAP_M, -p[:, 2]).clamp(min=0.0)
    away: Tensor = torch.linalg.norm(torch.cat([beside, over[:, None]], dim=-1), dim=-1)
    return away


def _on_top(models: Mapping[str, Model], X_BM: Array, back_m: float, aside_m: float, turn_rad: float) -> Array:
    """Pose (4, 4) of the cube on the cabinet, `back_m` behind the edge over the drawer."""
    size = models["cabinet"].size
    place = [size["depth_m"] / 2.0 - back_m, aside_m, size["height_m"] + models["cube"].size["edge_m"] / 2.0]
    return np.asarray(X_BM @ make_pose(turned(turn_rad), place))


def _sideways(side: int, x_m: float, rng: np.random.Generator) -> Array:
    """Pose (4, 4) of a cabinet at `x_m` whose drawer opens to the robot's left (`side` 1) or right (-1)."""
    turn = side * np.pi / 2.0 + rng.uniform(-YAW_RAD, YAW_RAD)
    return resting(x_m, -side * rng.uniform(0.065, 0.095), 0.0, turn)


def _forwards(model: Model, rng: np.random.Generator) -> Array:
    """Pose (4, 4) of a cabinet whose drawer opens away from the robot, towards the camera."""
    reach = model.size["depth_m"] / 2.0 + model.size["travel_m"] + model.size["reach_m"]
    turn = rng.uniform(-YAW_RAD, YAW_RAD)
    front, aside = rng.uniform(0.635, 0.66), rng.uniform(-0.09, 0.09)  # the handle's, the drawer wide open
    return resting(front - reach * np.cos(turn), aside - reach * np.sin(turn), 0.0, turn)


class OpenDrawer(Task):
    """Pull the drawer open.

    Description: a cabinet stands sideways, its drawer ajar; turn the gripper, reach with the closed fingertips into the
        gap behind the drawer's front, pull, go up again.
    Randomizations: the cabinet (measures, looks, handle, friction), its place, its direction, whether it opens to the
        left or to the right, how far it is ajar.
    Success: the drawer has come nearly as far as it goes (`open`) and is still (`still`), the arm is at rest (`calm`)
        and off the drawer (`released`).
    """

    card = TaskCard(
        id="OpenDrawer-v1", family="drawers", difficulty=Difficulty.MEDIUM, articulated_dof=1, axes="y", contacts=1
    )
    slots: ClassVar[Mapping[str, str]] = {"cabinet": "cabinet"}

    def layout(self, models: Mapping[str, Model], rng: np.random.Generator, variant: TaskVariant) -> SceneLayout:
        """A cabinet across the robot's view."""
        cabinet = models["cabinet"]
        X_BM = _sideways(int(rng.choice([-1, 1])), rng.uniform(0.475, 0.54), rng)
        return SceneLayout(
            placements={"cabinet": Placement(model=cabinet, X_BM=X_BM, joint=rng.uniform(0.034, 0.048))},
            prompt=(
                f"The robot arm turns its gripper, reaches into the gap of the {cabinet.words}'s slightly open drawer, "
                "pulls the drawer all the way out and moves up again."
            ),
        )

    def conditions(self, state: State) -> dict[str, Tensor]:
        """See the class."""
        wide = OPEN_SHARE * state.size("cabinet", "travel_m")
        return {"open": state.joints["cabinet"] >= wide, **_left(state)}

    def progress(self, state: State) -> Tensor:
        """Part of the drawer's way out."""
        return state.travelled("cabinet", OPEN_SHARE * state.size("cabinet", "travel_m"))


class CloseDrawer(Task):
    """Push the drawer shut.

    Description: a cabinet's drawer is open towards the camera; go behind its front with the closed gripper, push it in,
        go up again.
    Randomizations: the cabinet (measures, looks, handle, friction), its place and direction, how far it is open.
    Success: the drawer is shut (`shut`) and still (`still`), the arm is at rest (`calm`) and off the drawer
        (`released`).
    """

    card = TaskCard(
        id="CloseDrawer-v1", family="drawers", difficulty=Difficulty.EASY, articulated_dof=1, axes="x", contacts=1
    )
    slots: ClassVar[Mapping[str, str]] = {"cabinet": "cabinet"}

    def layout(self, models: Mapping[str, Model], rng: np.random.Generator, variant: TaskVariant) -> SceneLayout:
        """A cabinet that opens away from the robot."""
        cabinet = models["cabinet"]
        X_BM = _forwards(cabinet, rng)
        joint = rng.uniform(0.65, 1.0) * cabinet.size["travel_m"]
        return SceneLayout(
            placements={"cabinet": Placement(model=cabinet, X_BM=X_BM, joint=joint)},
            prompt=f"The robot arm pushes the open drawer of the {cabinet.words} completely shut and moves up again.",
        )

    def conditions(self, state: State) -> dict[str, Tensor]:
        """See the class."""
        return {"shut": _shut(state), **_left(state)}

    def progress(self, state: State) -> Tensor:
        """Part of the drawer's way in."""
        return state.travelled("cabinet", torch.full_like(state.joints["cabinet"], SHUT_M))


class _StoreCube(Task):
    """What the tasks that put a cube into a drawer share."""

    slots: ClassVar[Mapping[str, str]] = {"cabinet": "cabinet", "cube": "cube/red"}

    def conditions(self, state: State) -> dict[str, Tensor]:
        """See the tasks."""
        return {
            "inside": _outside_by(state, state.poses, "cube") <= 0.0,
            "shut": _shut(state),
            "still": _still(state, "cube") & _still(state, "cabinet"),
            "released": ~state.grasps("cube"),
        }

    def progress(self, state: State) -> Tensor:
        """Half for the cube's way into the tray; then half for the drawer's way in."""
        before = _outside_by(state, state.starts, "cube").clamp(min=1e-6)
        entered = (1.0 - _outside_by(state, state.poses, "cube") / before).clamp(0.0, 1.0)
        shut = state.travelled("cabinet", torch.full_like(state.joints["cabinet"], SHUT_M)).clamp(0.0, 1.0)
        return 0.5 * entered + 0.5 * torch.where(entered >= 1.0, shut, torch.zeros_like(shut))


class StoreCubeDrop(_StoreCube):
    """Drop the cube into the drawer, shut the drawer.

    Description: a red cube lies on top of a cabinet whose drawer is open towards the camera; grasp the cube, let it go
        over the open drawer, push the drawer shut.
    Randomizations: the cabinet (measures, looks, handle, friction), its place and direction, how far it is open, the
        cube, its place on top and its direction.
    Success: the cube is in the tray (`inside`), the drawer is shut (`shut`), both are still (`still`), and the cube is
        let go (`released`).
    """

    card = TaskCard(
        id="StoreCube-v1", family="drawers", difficulty=Difficulty.HARD, articulated_dof=1, axes="x", contacts=2
    )

    def layout(self, models: Mapping[str, Model], rng: np.random.Generator, variant: TaskVariant) -> SceneLayout:
        """A cabinet that opens away from the robot, the cube on top of it."""
        cabinet = models["cabinet"]
        X_BM = _forwards(cabinet, rng)
        X_BC = _on_top(models, X_BM, rng.uniform(0.035, 0.075), rng.uniform(-0.04, 0.04), rng.uniform(-np.pi, np.pi))
        return SceneLayout(
            placements={
                "cabinet": Placement(model=cabinet, X_BM=X_BM, joint=rng.uniform(AJAR, 1.0) * cabinet.size["travel_m"]),
                "cube": Placement(model=models["cube"], X_BM=X_BC),
            },
            prompt=(
                f"The robot arm picks up the red cube from the top of the {cabinet.words}, drops it into the open "
                "drawer and pushes the drawer shut."
            ),
        )


class StoreCubeDrag(_StoreCube):
    """Drag the cube into the drawer, shut the drawer.

    Description: a red cube lies on top of a cabinet that stands sideways, its drawer open; go behind the cube with the
        closed gripper, drag it over the edge so that it falls into the drawer, push the drawer shut.
    Randomizations: the cabinet (measures, looks, handle, friction), its place, its direction, whether it opens to the
        left or to the right, how far it is open, the cube, its place on top and its direction.
    Success: the cube is in the tray (`inside`), the drawer is shut (`shut`), both are still (`still`), and the cube is
        not held (`released`).
    """

    card = TaskCard(
        id="StoreCube-v2", family="drawers", difficulty=Difficulty.HARD, articulated_dof=1, axes="y", contacts=2
    )

    def layout(self, models: Mapping[str, Model], rng: np.random.Generator, variant: TaskVariant) -> SceneLayout:
        """A cabinet across the robot's view, the cube on top of it."""
        cabinet = models["cabinet"]
        X_BM = _sideways(int(rng.choice([-1, 1])), rng.uniform(0.465, 0.51), rng)
        turn = rng.integers(4) * np.pi / 2.0 + rng.uniform(-ASKEW_RAD, ASKEW_RAD)
        X_BC = _on_top(models, X_BM, rng.uniform(0.04, 0.075), rng.uniform(-0.025, 0.025), turn)
        return SceneLayout(
            placements={
                "cabinet": Placement(model=cabinet, X_BM=X_BM, joint=rng.uniform(AJAR, 1.0) * cabinet.size["travel_m"]),
                "cube": Placement(model=models["cube"], X_BM=X_BC),
            },
            prompt=(
                f"The robot arm drags the red cube off the top of the {cabinet.words} into the open drawer with its "
                "closed gripper and pushes the drawer shut."
            ),
        )


TASKS: tuple[Task, ...] = (OpenDrawer(), CloseDrawer(), StoreCubeDrop(), StoreCubeDrag())
"""Tasks of this family."""
