"""Tasks with a cabinet with one drawer."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor
from typing_extensions import override

from kinebench_drake.geometry import Array, make_pose, rotation_z
from kinebench_drake.suites.families.task import (
    Difficulty,
    JointTask,
    Placement,
    SceneLayout,
    Task,
    TaskCard,
    TaskVariant,
)
from kinebench_drake.suites.scene.model import AssetModel
from kinebench_drake.suites.scene.state import STILL_M_S, State

OPEN_FRACTION = 0.9
"""Least opening of an open drawer, as a fraction of its travel."""
SHUT_M = 0.008
"""Greatest opening of a shut drawer."""
HEAP_M = 0.045
"""Greatest height of the centre of an object in the tray above the tray's floor."""
YAW_RAD = 0.25
"""Greatest yaw of a cabinet to either side."""
START_FRACTION = 0.92
"""Least initial opening of a drawer that is to receive a cube, as a fraction of its travel."""
CUBE_YAW_RAD = 0.3
"""Greatest yaw of a cube that is to be dragged, relative to the drawer's direction."""


def _distance_from_tray(state: State, poses: Mapping[str, Tensor]) -> Tensor:
    """Return the distance (N,) of the cube's centre from the interior of the tray [m]; 0 inside."""
    X_BD = poses["cabinet/drawer"]
    tray = torch.stack([torch.as_tensor(m.sites["tray"].X_BodyS[:3, 3]) for m in state.models["cabinet"]])
    p = (X_BD[:, :3, :3].mT @ (poses["cube"][:, :3, 3] - X_BD[:, :3, 3])[..., None])[..., 0] - tray.to(X_BD)
    half = 0.5 * torch.stack([state.size("cabinet", "tray_length_m"), state.size("cabinet", "tray_width_m")], dim=-1)
    beside = (p[:, :2].abs() - half).clamp(min=0.0)
    over = torch.maximum(p[:, 2] - HEAP_M, -p[:, 2]).clamp(min=0.0)
    distance: Tensor = torch.linalg.norm(torch.cat([beside, over[:, None]], dim=-1), dim=-1)
    return distance


def _sideways(x_m: tuple[float, float], rng: np.random.Generator) -> Array:
    """Draw the pose (4, 4) of a cabinet at `x_m` whose drawer opens to the robot's left or right."""
    side = int(rng.choice([-1, 1]))
    x = rng.uniform(*x_m)
    yaw = side * np.pi / 2.0 + rng.uniform(-YAW_RAD, YAW_RAD)
    return make_pose(rotation_z(yaw), [x, -side * rng.uniform(0.065, 0.095), 0.0])


def _forwards(model: AssetModel, rng: np.random.Generator) -> Array:
    """Draw the pose (4, 4) of a cabinet whose drawer opens away from the robot, towards the camera."""
    reach = model.size["depth_m"] / 2.0 + model.size["travel_m"] + model.size["reach_m"]
    yaw = rng.uniform(-YAW_RAD, YAW_RAD)
    # of the handle, the drawer fully open
    front = rng.uniform(0.635, 0.66)
    aside = rng.uniform(-0.09, 0.09)
    return make_pose(rotation_z(yaw), [front - reach * np.cos(yaw), aside - reach * np.sin(yaw), 0.0])


class _MoveDrawer(JointTask):
    """Common part of opening and closing."""

    slots: ClassVar[Mapping[str, str]] = {"cabinet": "cabinet"}

    @override
    def rest_conditions(self, state: State) -> dict[str, Tensor]:
        distance = torch.linalg.norm(state.X_BG[:, :3, 3] - state.site("cabinet", "pull")[:, :3, 3], dim=-1)
        return state.rest_conditions("cabinet", distance, still=STILL_M_S)


class OpenDrawer(_MoveDrawer):
    """Pull the drawer open.

    Description: a cabinet stands sideways, its drawer ajar; turn the gripper, reach with the closed fingertips into the
    gap behind the drawer's front, pull, and move up again.
    Randomizations: the cabinet (dimensions, surfaces, handle, friction), its position and yaw (up to `YAW_RAD`),
    whether it opens to the left or to the right, how far it is ajar (34 to 48 mm).
    Success: the drawer is open by at least `OPEN_FRACTION` of its travel (`open`) and slower than `STILL_M_S`
    (`still`); the arm is slower than `CALM_RAD_S` (`calm`), and the TCP at least `CLEAR_M` away from the drawer's
    upper edge (`released`).
    """

    card = TaskCard(id="OpenDrawer-v1", family="drawers", difficulty=Difficulty.MEDIUM, articulated_dof=1, axes="y")
    prompt = (
        "The robot arm turns its gripper, reaches into the gap of the {}'s slightly open drawer, pulls the drawer all "
        "the way out and moves up again."
    )
    reached = "open"

    @override
    def place(self, model: AssetModel, rng: np.random.Generator) -> Placement:
        """Place a cabinet that opens to the side."""
        X_BM = _sideways((0.475, 0.54), rng)
        return Placement(model=model, X_BM=X_BM, joint=rng.uniform(0.034, 0.048))

    @override
    def goal(self, state: State) -> Tensor:
        return OPEN_FRACTION * state.size("cabinet", "travel_m")


class CloseDrawer(_MoveDrawer):
    """Push the drawer shut.

    Description: a cabinet's drawer is open towards the camera; reach in front of it with the closed gripper, push it
    in, and move up again.
    Randomizations: the cabinet (dimensions, surfaces, handle, friction), its position and yaw (up to `YAW_RAD`), how
    far it is open (65 to 100 % of its travel).
    Success: the drawer is open by at most `SHUT_M` (`shut`) and slower than `STILL_M_S` (`still`); the arm is slower
    than `CALM_RAD_S` (`calm`), and the TCP at least `CLEAR_M` away from the drawer's upper edge (`released`).
    """

    card = TaskCard(id="CloseDrawer-v1", family="drawers", difficulty=Difficulty.EASY, articulated_dof=1, axes="x")
    prompt = "The robot arm pushes the open drawer of the {} completely shut and moves up again."
    reached = "shut"

    @override
    def place(self, model: AssetModel, rng: np.random.Generator) -> Placement:
        """Place a cabinet that opens away from the robot."""
        X_BM = _forwards(model, rng)
        return Placement(model=model, X_BM=X_BM, joint=rng.uniform(0.65, 1.0) * model.size["travel_m"])

    @override
    def goal(self, state: State) -> float:
        return SHUT_M


class _StoreCube(Task):
    """Common part of the tasks that put a cube into a drawer."""

    slots: ClassVar[Mapping[str, str]] = {"cabinet": "cabinet", "cube": "cube/red"}
    prompt: ClassVar[str]
    """Prompt with a placeholder for the cabinet's name."""

    @abstractmethod
    def _draw_poses(self, cabinet: AssetModel, rng: np.random.Generator) -> tuple[Array, tuple[float, float], float]:
        """Draw the poses of cabinet and cube.

        Returns:
            The pose (4, 4) of the cabinet; the position of the cube's centre on it, behind the edge over the drawer and
            along it [m]; the yaw of the cube relative to the cabinet [rad].
        """

    def layout(self, models: Mapping[str, AssetModel], rng: np.random.Generator, variant: TaskVariant) -> SceneLayout:
        """Place the cabinet with the cube on top."""
        cabinet = models["cabinet"]
        cube = models["cube"]
        X_BM, (back, aside), yaw_rad = self._draw_poses(cabinet, rng)
        p_MC = [cabinet.size["depth_m"] / 2.0 - back, aside, cabinet.size["height_m"] + cube.size["edge_m"] / 2.0]
        opening = rng.uniform(START_FRACTION, 1.0) * cabinet.size["travel_m"]
        return SceneLayout(
            placements={
                "cabinet": Placement(model=cabinet, X_BM=X_BM, joint=opening),
                "cube": Placement(model=cube, X_BM=np.asarray(X_BM @ make_pose(rotation_z(yaw_rad), p_MC))),
            },
            prompt=self.prompt.format(cabinet.words),
        )

    @override
    def conditions(self, state: State) -> dict[str, Tensor]:
        return {
            "inside": _distance_from_tray(state, state.poses) <= 0.0,
            "shut": state.joints["cabinet"] <= SHUT_M,
            "still": (state.speeds["cube"] <= STILL_M_S) & (state.speeds["cabinet"] <= STILL_M_S),
            "released": ~state.grasps("cube"),
        }

    def progress(self, state: State) -> Tensor:
        """Return half the fraction of the cube's way into the tray, then half the fraction of the drawer's way in."""
        before = _distance_from_tray(state, state.starts).clamp(min=1e-6)
        entered = (1.0 - _distance_from_tray(state, state.poses) / before).clamp(0.0, 1.0)
        shut = state.joint_progress("cabinet", SHUT_M).clamp(0.0, 1.0)
        return 0.5 * entered + 0.5 * torch.where(entered >= 1.0, shut, torch.zeros_like(shut))


class StoreCubeDrop(_StoreCube):
    """Drop the cube into the drawer, shut the drawer.

    Description: a red cube lies on top of a cabinet whose drawer is open towards the camera; grasp the cube, release it
    above the open drawer, push the drawer shut.
    Randomizations: the cabinet (dimensions, surfaces, handle, friction), its position and yaw (up to `YAW_RAD`), how
    far it is open (at least `START_FRACTION`); the cube, its position on top and its yaw.
    Success: the cube's centre is in the tray, at most `HEAP_M` above its floor (`inside`), the drawer is open by at
    most `SHUT_M` (`shut`), both are slower than `STILL_M_S` (`still`), and the cube is not grasped (`released`).
    """

    card = TaskCard(
        id="StoreCube-v1", family="drawers", difficulty=Difficulty.HARD, articulated_dof=1, axes="x", contacts=2
    )
    prompt = (
        "The robot arm picks up the red cube from the top of the {}, drops it into the open "
        "drawer and pushes the drawer shut."
    )

    @override
    def _draw_poses(self, cabinet: AssetModel, rng: np.random.Generator) -> tuple[Array, tuple[float, float], float]:
        X_BM = _forwards(cabinet, rng)
        return X_BM, (rng.uniform(0.035, 0.075), rng.uniform(-0.04, 0.04)), rng.uniform(-np.pi, np.pi)


class StoreCubeDrag(_StoreCube):
    """Drag the cube into the drawer, shut the drawer.

    Description: a red cube lies on top of a cabinet that stands sideways, its drawer open; reach behind the cube with
    the closed gripper, drag it over the edge so that it falls into the drawer, push the drawer shut.
    Randomizations: the cabinet (dimensions, surfaces, handle, friction), its position and yaw (up to `YAW_RAD`),
    whether it opens to the left or to the right, how far it is open (at least `START_FRACTION`); the cube, its
    position on top and its yaw (`CUBE_YAW_RAD`).
    Success: the cube's centre is in the tray, at most `HEAP_M` above its floor (`inside`), the drawer is open by at
    most `SHUT_M` (`shut`), both are slower than `STILL_M_S` (`still`), and the cube is not grasped (`released`).
    """

    card = TaskCard(
        id="StoreCube-v2", family="drawers", difficulty=Difficulty.HARD, articulated_dof=1, axes="y", contacts=2
    )
    prompt = (
        "The robot arm drags the red cube off the top of the {} into the open drawer with its "
        "closed gripper and pushes the drawer shut."
    )

    @override
    def _draw_poses(self, cabinet: AssetModel, rng: np.random.Generator) -> tuple[Array, tuple[float, float], float]:
        X_BM = _sideways((0.465, 0.51), rng)
        yaw = rng.integers(4) * np.pi / 2.0 + rng.uniform(-CUBE_YAW_RAD, CUBE_YAW_RAD)
        return X_BM, (rng.uniform(0.04, 0.075), rng.uniform(-0.025, 0.025)), yaw


TASKS: tuple[Task, ...] = (OpenDrawer(), CloseDrawer(), StoreCubeDrop(), StoreCubeDrag())
"""Tasks of this family."""
