"""Tasks with boxes with hinged lids."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from kinebench_drake.geometry import make_pose
from kinebench_drake.suites.assets.boxes import FLUSH, RIMMED, tight
from kinebench_drake.suites.assets.model import Model
from kinebench_drake.suites.start import START_WIDTH_M
from kinebench_drake.suites.tasks.card import Difficulty, TaskCard, TaskVariant
from kinebench_drake.suites.tasks.layout import resting, turned
from kinebench_drake.suites.tasks.state import CLEAR_M, STILL_RAD_S, State
from kinebench_drake.suites.tasks.task import Placement, SceneLayout, Task

OPEN_PART = 0.9
"""Part of its range that a lid must be open."""
SHUT_RAD = float(np.radians(4.0))
"""How far a lid that counts as shut may be open."""
AJAR_RAD = (float(np.radians(22.0)), float(np.radians(34.0)))
"""How far a lid that is slightly open is open at the start."""
WIDE_PART = (0.85, 0.98)
"""Part of its range that a wide open lid is open at the start."""
YAW_RAD = float(np.radians(12.0))
"""How far boxes may be turned either way."""


def distance_to_lid(state: State) -> Tensor:
    """Distance (N,) of the TCP from the rectangle that the lid is [m]."""
    X_BH, angle = state.site("box", "hinge"), state.joints["box"]
    p = torch.einsum("nij,ni->nj", X_BH[:, :3, :3], state.X_BG[:, :3, 3] - X_BH[:, :3, 3])
    along = p[:, 0] * torch.cos(angle) + p[:, 2] * torch.sin(angle)
    off = p[:, 2] * torch.cos(angle) - p[:, 0] * torch.sin(angle)
    beyond = torch.maximum(along - state.size("box", "lid_m"), -along).clamp(min=0.0)
    beside = (p[:, 1].abs() - 0.5 * state.size("box", "width_m")).clamp(min=0.0)
    distance: Tensor = torch.linalg.norm(torch.stack([off, beyond, beside], dim=-1), dim=-1)
    return distance


def _left(state: State) -> dict[str, Tensor]:
    """What both ways to move a lid ask for in the end."""
    return {
        "still": state.speeds["box"] <= STILL_RAD_S,
        "calm": state.calm(),
        "released": distance_to_lid(state) >= CLEAR_M,
    }


class OpenBox(Task):
    """Open the lid of an upright box.

    Description: a box stands on the table; lift its lid with the fingertips, push it fully open and draw back. In
    version 1 the hinge is on the robot's side of the box and the lid is taken by its side edge; in version 2 the box is
    turned to its right, so that its front edge faces that way, and the lid is taken there. Easy: the lid is slightly
    open. Hard: it is shut and must be pried up by its rim; in version 2 its hinge is tight, too.
    Randomizations: box, position, direction, angle of the lid if it is open.
    Success: the lid is open as far as it goes, or nearly (`open`), and at rest (`still`); so is the arm (`calm`),
    3 cm or more off the lid (`released`).
    """

    slots: ClassVar[Mapping[str, str]] = {"box": RIMMED}

    def __init__(self, name: str, *, ajar: bool, to_the_right: bool) -> None:
        """Make one of the four tasks.

        Args:
            name: plain id.
            ajar: whether the lid is slightly open at the start.
            to_the_right: whether the box is turned to its right.
        """
        self._ajar, self._to_the_right = ajar, to_the_right
        self.card = TaskCard(
            id=name,
            family="boxes",
            difficulty=Difficulty.EASY if ajar else Difficulty.HARD,
            articulated_dof=1,
            axes="x" if to_the_right else "y",
            contacts=1 if ajar else 2,
        )

    def layout(self, models: Mapping[str, Model], rng: np.random.Generator, variant: TaskVariant) -> SceneLayout:
        """A box in front of the robot, so near that its lid does not touch the waiting gripper."""
        box = models["box"]
        yaw = rng.uniform(-YAW_RAD, YAW_RAD)
        if self._to_the_right:
            x, y, yaw = rng.uniform(0.42, 0.47), rng.uniform(0.03, 0.10), yaw - np.pi / 2.0
        else:
            x, y = rng.uniform(0.46, 0.50), rng.uniform(-0.10, 0.10)
        if not self._ajar and self._to_the_right:
            box = tight(box)
        joint = float(rng.uniform(*AJAR_RAD)) if self._ajar else 0.0
        edge = "front edge" if self._to_the_right else "side edge"
        if self._ajar:
            prompt = f"puts its fingertips under the {edge} of the slightly open lid of the {box.words} and pushes it"
        else:
            prompt = f"goes to the {edge} of the closed {box.words}, pries up the lid with its fingertips and pushes it"
        return SceneLayout(
            placements={"box": Placement(model=box, X_BM=resting(x, y, 0.0, yaw), joint=joint)},
            prompt=f"The robot arm {prompt} fully open.",
            finger_width_m=START_WIDTH_M[self.card.id],
        )

    def conditions(self, state: State) -> dict[str, Tensor]:
        """See the class."""
        wide = state.joints["box"] >= OPEN_PART * state.size("box", "open_rad")
        return {"open": wide, **_left(state)}

    def progress(self, state: State) -> Tensor:
        """Part of the lid's way."""
        return state.travelled("box", OPEN_PART * state.size("box", "open_rad"))


class CloseBox(Task):
    """Press the lid of a lying box shut.

    Description: a box lies on its side, its opening towards the camera, its lid wide open on an upright hinge; fold the
    lid shut with the closed gripper and draw back.
    Randomizations: box, position, direction, side of the hinge, angle of the lid.
    Success: the lid is shut (`shut`) and at rest (`still`); so is the arm (`calm`), 3 cm or more off the lid
    (`released`).
    """

    card = TaskCard(
        id="CloseBox-v1", family="boxes", difficulty=Difficulty.EASY, articulated_dof=1, axes="z", contacts=1
    )
    slots: ClassVar[Mapping[str, str]] = {"box": FLUSH}

    def layout(self, models: Mapping[str, Model], rng: np.random.Generator, variant: TaskVariant) -> SceneLayout:
        """A box on its side in front of the robot."""
        box = models["box"]
        left = 1.0 if rng.random() < 0.5 else -1.0  # where the hinge is, for the robot
        R_lying = np.array([[0.0, 0.0, 1.0], [-left, 0.0, 0.0], [0.0, -left, 0.0]])
        R = turned(rng.uniform(-YAW_RAD, YAW_RAD)) @ R_lying
        opening = np.array([rng.uniform(0.50, 0.54), left * rng.uniform(-0.03, 0.05), box.size["width_m"] / 2.0])
        return SceneLayout(
            placements={
                "box": Placement(
                    model=box,
                    X_BM=make_pose(R, opening - box.size["height_m"] * R[:, 2]),
                    joint=float(rng.uniform(*WIDE_PART)) * box.size["open_rad"],
                )
            },
            prompt=f"The robot arm presses the open lid of the {box.words} shut with its closed gripper.",
            finger_width_m=START_WIDTH_M[self.card.id],
        )

    def conditions(self, state: State) -> dict[str, Tensor]:
        """See the class."""
        return {"shut": state.joints["box"] <= SHUT_RAD, **_left(state)}

    def progress(self, state: State) -> Tensor:
        """Part of the lid's way."""
        return state.travelled("box", torch.full_like(state.joints["box"], SHUT_RAD))


TASKS: tuple[Task, ...] = (
    CloseBox(),
    OpenBox("OpenBoxEasy-v1", ajar=True, to_the_right=False),
    OpenBox("OpenBoxEasy-v2", ajar=True, to_the_right=True),
    OpenBox("OpenBoxHard-v1", ajar=False, to_the_right=False),
    OpenBox("OpenBoxHard-v2", ajar=False, to_the_right=True),
)
"""Tasks of this family."""
