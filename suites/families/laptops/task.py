"""Tasks with laptops."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor
from typing_extensions import override

from kinebench_drake.suites.families.task import Difficulty, JointTask, Placement, TaskCard
from kinebench_drake.suites.scene.model import AssetModel
from kinebench_drake.suites.scene.state import State, to_frame

OPEN_RAD = float(np.deg2rad(90.0))
"""Least opening of an open lid."""
SHUT_RAD = float(np.deg2rad(4.0))
"""Greatest opening of a shut lid."""
AHEAD_M = (0.45, 0.52)
"""Least and greatest x of the base's centre."""


def _distance_to_lid(state: State) -> Tensor:
    """Return the distance (N,) of the TCP from the lid's box [m]."""
    p = to_frame(state.poses["laptop/lid"], state.X_BG[:, :3, 3])
    half_width = 0.5 * state.size("laptop", "width_m")
    low = torch.stack([torch.zeros_like(p[:, 0]), -half_width, state.size("laptop", "inside_m")], dim=-1)
    high = torch.stack([state.size("laptop", "reach_m"), half_width, state.size("laptop", "outside_m")], dim=-1)
    distance: Tensor = torch.linalg.norm(p - torch.minimum(torch.maximum(p, low), high), dim=-1)
    return distance


class _MoveLaptopLid(JointTask):
    """Common part of the tasks with a laptop."""

    slots: ClassVar[Mapping[str, str]] = {"laptop": "laptop"}
    side_m: ClassVar[tuple[float, float]] = (-0.02, 0.05)
    """Least and greatest y of the base's centre."""
    start_deg: ClassVar[tuple[float, float]]
    """Least and greatest initial opening of the lid."""
    turn_deg: ClassVar[tuple[float, float]]
    """Least and greatest angle from the robot's right (-y) to the direction of the free edge, towards the camera."""

    @override
    def place(self, model: AssetModel, rng: np.random.Generator) -> Placement:
        """Place a laptop whose hinge is on the robot's left."""
        x = rng.uniform(*AHEAD_M)
        y = rng.uniform(*self.side_m)
        yaw = np.deg2rad(rng.uniform(*self.turn_deg) - 90.0)
        return Placement.upright(model, (x, y, 0.0), yaw, joint=float(np.deg2rad(rng.uniform(*self.start_deg))))

    @override
    def goal(self, state: State) -> float:
        return OPEN_RAD if self.reached == "open" else SHUT_RAD

    @override
    def rest_conditions(self, state: State) -> dict[str, Tensor]:
        return state.rest_conditions("laptop", _distance_to_lid(state))


class OpenLaptopEasy(_MoveLaptopLid):
    """Push a laptop that is ajar open.

    Description: the lid is slightly open; put a finger under its edge and push it up and over until it stands.
    Randomizations: the laptop, its position and yaw, the initial opening (18 to 32 degrees).
    Success: the lid is open by at least `OPEN_RAD` (`open`) and slower than `STILL_RAD_S` (`still`); the arm is slower
    than `CALM_RAD_S` (`calm`), and the TCP at least `CLEAR_M` away from the lid (`released`).
    """

    card = TaskCard(id="OpenLaptopEasy-v1", family="laptops", difficulty=Difficulty.EASY, articulated_dof=1, axes="x")
    prompt = (
        "The robot arm puts a finger under the lid of the {} that stands ajar and pushes it up and back until the "
        "laptop is open."
    )
    reached = "open"
    start_deg = (18.0, 32.0)
    turn_deg = (15.0, 35.0)


class OpenLaptopHard(_MoveLaptopLid):
    """Pry a shut laptop's lid up and push it open.

    Description: the laptop is shut; pry the lid's edge up with a fingertip, then push it up and over until it stands.
    Randomizations: the laptop, its position and yaw.
    Success: the lid is open by at least `OPEN_RAD` (`open`) and slower than `STILL_RAD_S` (`still`); the arm is slower
    than `CALM_RAD_S` (`calm`), and the TCP at least `CLEAR_M` away from the lid (`released`).
    """

    card = TaskCard(
        id="OpenLaptopHard-v1", family="laptops", difficulty=Difficulty.HARD, articulated_dof=1, axes="x", contacts=2
    )
    prompt = (
        "The robot arm pries up the edge of the shut {}'s lid with a fingertip, then pushes the lid up and back until "
        "the laptop is open."
    )
    reached = "open"
    start_deg = (0.0, 0.0)
    turn_deg = (15.0, 35.0)


class CloseLaptopEasy(_MoveLaptopLid):
    """Press a half-open laptop shut.

    Description: the lid is partly open; press it down from above until it lies on the base.
    Randomizations: the laptop, its position and yaw, the initial opening (37 to 47 degrees).
    Success: the lid is open by at most `SHUT_RAD` (`shut`) and slower than `STILL_RAD_S` (`still`); the arm is slower
    than `CALM_RAD_S` (`calm`), and the TCP at least `CLEAR_M` away from the lid (`released`).
    """

    card = TaskCard(id="CloseLaptopEasy-v1", family="laptops", difficulty=Difficulty.EASY, articulated_dof=1, axes="x")
    prompt = "The robot arm presses the lid of the half-open {} down until the laptop is shut."
    reached = "shut"
    start_deg = (37.0, 47.0)
    turn_deg = (-15.0, 20.0)


class CloseLaptopHard(_MoveLaptopLid):
    """Shut a laptop that is wide open.

    Description: the lid leans back past the vertical; reach behind it, pull it forward over the vertical, then press it
    down until it lies on the base.
    Randomizations: the laptop, its position and yaw, the initial opening (110 to 125 degrees).
    Success: the lid is open by at most `SHUT_RAD` (`shut`) and slower than `STILL_RAD_S` (`still`); the arm is slower
    than `CALM_RAD_S` (`calm`), and the TCP at least `CLEAR_M` away from the lid (`released`).
    """

    card = TaskCard(
        id="CloseLaptopHard-v1", family="laptops", difficulty=Difficulty.MEDIUM, articulated_dof=1, axes="x", contacts=2
    )
    prompt = (
        "The robot arm reaches behind the lid of the wide open {}, pulls it up and forward, then presses it down until "
        "the laptop is shut."
    )
    reached = "shut"
    start_deg = (110.0, 125.0)
    turn_deg = (-25.0, 0.0)
    side_m = (-0.02, 0.02)


TASKS = (CloseLaptopEasy(), CloseLaptopHard(), OpenLaptopEasy(), OpenLaptopHard())
"""Tasks of this family."""
