"""Tasks with laptops."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from kinebench_drake.suites.assets.model import Model
from kinebench_drake.suites.start import START_WIDTH_M
from kinebench_drake.suites.tasks.card import Difficulty, TaskCard, TaskVariant
from kinebench_drake.suites.tasks.layout import resting
from kinebench_drake.suites.tasks.state import CLEAR_M, STILL_RAD_S, State
from kinebench_drake.suites.tasks.task import Placement, SceneLayout, Task

OPEN_RAD = np.deg2rad(90.0)
"""A lid open this far counts as open."""
SHUT_RAD = np.deg2rad(4.0)
"""A lid open this little counts as shut."""

FORWARD_M = (0.45, 0.52)
"""Least and greatest x of the middle of the base."""


def _distance_to_lid(state: State) -> Tensor:
    """(N,) distance of the TCP from the lid [m]."""
    X_lid = state.poses["laptop/lid"]
    offset = state.X_BG[:, :3, 3] - X_lid[:, :3, 3]
    p = torch.einsum("nji,nj->ni", X_lid[:, :3, :3], offset)
    half_width, zero = 0.5 * state.size("laptop", "width_m"), torch.zeros_like(p[:, 0])
    low = torch.stack([zero, -half_width, state.size("laptop", "inside_m")], dim=-1)
    high = torch.stack([state.size("laptop", "reach_m"), half_width, state.size("laptop", "outside_m")], dim=-1)
    distance: Tensor = torch.linalg.norm(p - torch.minimum(torch.maximum(p, low), high), dim=-1)
    return distance


class _Laptop(Task):
    """What the tasks with a laptop share."""

    slots: ClassVar[Mapping[str, str]] = {"laptop": "laptop"}
    prompt: str
    """With a place for what the laptop is called."""
    goal_rad: float
    side_m = (-0.02, 0.05)
    """Least and greatest y of the middle of the base."""
    start_deg: tuple[float, float]
    """Least and greatest angle of the lid at the start."""
    turn_deg: tuple[float, float]
    """Least and greatest angle from the robot's right (-y) to where the free edge points, towards the camera (x)."""

    def layout(self, models: Mapping[str, Model], rng: np.random.Generator, variant: TaskVariant) -> SceneLayout:
        """A laptop whose hinge is on the robot's left."""
        model = models["laptop"]
        x, y = rng.uniform(*FORWARD_M), rng.uniform(*self.side_m)
        yaw = np.deg2rad(rng.uniform(*self.turn_deg) - 90.0)
        placement = Placement(
            model=model, X_BM=resting(x, y, 0.0, yaw), joint=float(np.deg2rad(rng.uniform(*self.start_deg)))
        )
        return SceneLayout(
            placements={"laptop": placement},
            prompt=self.prompt.format(model.words),
            finger_width_m=START_WIDTH_M[self.card.id],
        )

    def _freed(self, state: State) -> dict[str, Tensor]:
        return {
            "still": state.speeds["laptop"] <= STILL_RAD_S,
            "calm": state.calm(),
            "released": _distance_to_lid(state) >= CLEAR_M,
        }

    def progress(self, state: State) -> Tensor:
        """Part of the lid's way."""
        return state.travelled("laptop", torch.full_like(state.joints["laptop"], self.goal_rad))


class _Open(_Laptop):
    goal_rad = OPEN_RAD
    turn_deg = (15.0, 35.0)

    def conditions(self, state: State) -> dict[str, Tensor]:
        """See the class."""
        return {"open": state.joints["laptop"] >= OPEN_RAD, **self._freed(state)}


class _Close(_Laptop):
    goal_rad = SHUT_RAD

    def conditions(self, state: State) -> dict[str, Tensor]:
        """See the class."""
        return {"shut": state.joints["laptop"] <= SHUT_RAD, **self._freed(state)}


class OpenLaptopEasy(_Open):
    """Push a laptop that is ajar open.

    Description: the lid stands open a little; put a finger under its edge, push it up and over until it stands.
    Randomizations: the laptop, its place and direction, how far it is open (18 to 32 degrees).
    Success: the lid is open by 90 degrees or more (`open`), still and let go, the arm at rest (`calm`).
    """

    card = TaskCard(
        id="OpenLaptopEasy-v1", family="laptops", difficulty=Difficulty.EASY, articulated_dof=1, axes="x", contacts=1
    )
    prompt = (
        "The robot arm puts a finger under the lid of the {} that stands ajar and pushes it up and back until the "
        "laptop is open."
    )
    start_deg = (18.0, 32.0)


class OpenLaptopHard(_Open):
    """Pry a shut laptop's lid up and push it open.

    Description: the laptop is shut; pry the lid's edge up with a fingertip, then push it up and over until it stands.
    Randomizations: the laptop, its place and direction.
    Success: the lid is open by 90 degrees or more (`open`), still and let go, the arm at rest (`calm`).
    """

    card = TaskCard(
        id="OpenLaptopHard-v1", family="laptops", difficulty=Difficulty.HARD, articulated_dof=1, axes="x", contacts=2
    )
    prompt = (
        "The robot arm pries up the edge of the shut {}'s lid with a fingertip, then pushes the lid up and back until "
        "the laptop is open."
    )
    start_deg = (0.0, 0.0)


class CloseLaptopEasy(_Close):
    """Press a laptop shut that is open a little.

    Description: the lid stands open a little; press it down from above until it lies on the base.
    Randomizations: the laptop, its place and direction, how far it is open (37 to 47 degrees).
    Success: the lid is open by 4 degrees at most (`shut`), still and let go, the arm at rest (`calm`).
    """

    card = TaskCard(
        id="CloseLaptopEasy-v1", family="laptops", difficulty=Difficulty.EASY, articulated_dof=1, axes="x", contacts=1
    )
    prompt = "The robot arm presses the lid of the half-open {} down until the laptop is shut."
    start_deg = (37.0, 47.0)
    turn_deg = (-15.0, 20.0)


class CloseLaptopHard(_Close):
    """Shut a laptop that is wide open.

    Description: the lid leans back past the vertical; reach behind it, pull it forward over the vertical, then press it
    down until it lies on the base.
    Randomizations: the laptop, its place and direction, how far it is open (110 to 125 degrees).
    Success: the lid is open by 4 degrees at most (`shut`), still and let go, the arm at rest (`calm`).
    """

    card = TaskCard(
        id="CloseLaptopHard-v1", family="laptops", difficulty=Difficulty.MEDIUM, articulated_dof=1, axes="x", contacts=2
    )
    prompt = (
        "The robot arm reaches behind the lid of the wide open {}, pulls it up and forward, then presses it down until "
        "the laptop is shut."
    )
    start_deg = (110.0, 125.0)
    turn_deg = (-25.0, 0.0)
    side_m = (-0.02, 0.02)


TASKS = (CloseLaptopEasy(), CloseLaptopHard(), OpenLaptopEasy(), OpenLaptopHard())
"""Tasks of this family."""
