"""Tasks with boxes with hinged lids."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor
from typing_extensions import override

from kinebench_drake.geometry import make_pose, rotation_z
from kinebench_drake.suites.families.boxes.assets import FLUSH, RIMMED, with_tight_hinge
from kinebench_drake.suites.families.task import Difficulty, JointTask, Placement, Task, TaskCard
from kinebench_drake.suites.scene.model import AssetModel
from kinebench_drake.suites.scene.state import State, to_frame

OPEN_FRACTION = 0.9
"""Least opening of an open lid, as a fraction of its range."""
SHUT_RAD = float(np.radians(4.0))
"""Greatest opening of a shut lid."""
AJAR_RAD = (float(np.radians(22.0)), float(np.radians(34.0)))
"""Least and greatest initial opening of a slightly open lid."""
WIDE_FRACTION = (0.85, 0.98)
"""Least and greatest initial opening of a wide open lid, as fractions of its range."""
YAW_RAD = float(np.radians(12.0))
"""Greatest yaw of a box to either side."""


def distance_to_lid(state: State) -> Tensor:
    """Return the distance (N,) of the TCP from the lid's rectangle [m]."""
    angle = state.joints["box"]
    p = to_frame(state.site("box", "hinge"), state.X_BG[:, :3, 3])
    along = p[:, 0] * torch.cos(angle) + p[:, 2] * torch.sin(angle)
    off = p[:, 2] * torch.cos(angle) - p[:, 0] * torch.sin(angle)
    beyond = torch.maximum(along - state.size("box", "lid_m"), -along).clamp(min=0.0)
    beside = (p[:, 1].abs() - 0.5 * state.size("box", "width_m")).clamp(min=0.0)
    distance: Tensor = torch.linalg.norm(torch.stack([off, beyond, beside], dim=-1), dim=-1)
    return distance


class _MoveBoxLid(JointTask):
    """Common part of the tasks with a box."""

    @override
    def rest_conditions(self, state: State) -> dict[str, Tensor]:
        return state.rest_conditions("box", distance_to_lid(state))


class OpenBox(_MoveBoxLid):
    """Open the lid of an upright box.

    Description: a box stands on the table; lift its lid with the fingertips, push it fully open and retreat. In
    version 1 the hinge is on the robot's side of the box and the fingers act on the lid's side edge; in version 2 the
    box faces to its right and the fingers act on the front edge. Easy: the lid is slightly open. Hard: it is shut and
    must be pried up by its rim; in version 2 its hinge is also tight.
    Randomizations: box, position, yaw (up to `YAW_RAD`), opening of a slightly open lid (`AJAR_RAD`).
    Success: the lid is open by at least `OPEN_FRACTION` of its range (`open`) and slower than `STILL_RAD_S` (`still`);
    the arm is slower than `CALM_RAD_S` (`calm`), and the TCP at least `CLEAR_M` away from the lid (`released`).
    """

    slots: ClassVar[Mapping[str, str]] = {"box": RIMMED}
    reached = "open"

    def __init__(self, name: str, *, ajar: bool, to_the_right: bool) -> None:
        """Make one of the four tasks.

        Args:
            ajar: True if the lid is slightly open at the start.
        """
        self._ajar = ajar
        self._to_the_right = to_the_right
        self.card = TaskCard(
            id=name,
            family="boxes",
            difficulty=Difficulty.EASY if ajar else Difficulty.HARD,
            articulated_dof=1,
            axes="x" if to_the_right else "y",
            contacts=1 if ajar else 2,
        )
        edge = "front edge" if to_the_right else "side edge"
        if ajar:
            way = f"puts its fingertips under the {edge} of the slightly open lid of the {{}} and pushes it"
        else:
            way = f"goes to the {edge} of the closed {{}}, pries up the lid with its fingertips and pushes it"
        self.prompt = f"The robot arm {way} fully open."

    @override
    def place(self, model: AssetModel, rng: np.random.Generator) -> Placement:
        """Place a box in front of the robot, close enough that its lid does not touch the gripper at the start."""
        yaw = rng.uniform(-YAW_RAD, YAW_RAD)
        if self._to_the_right:
            x = rng.uniform(0.42, 0.47)
            y = rng.uniform(0.03, 0.10)
            yaw = yaw - np.pi / 2.0
        else:
            x = rng.uniform(0.46, 0.50)
            y = rng.uniform(-0.10, 0.10)
        if self._to_the_right and not self._ajar:
            model = with_tight_hinge(model)
        return Placement.upright(model, (x, y, 0.0), yaw, joint=float(rng.uniform(*AJAR_RAD)) if self._ajar else 0.0)

    @override
    def goal(self, state: State) -> Tensor:
        return OPEN_FRACTION * state.size("box", "open_rad")


class CloseBox(_MoveBoxLid):
    """Press the lid of a lying box shut.

    Description: a box lies on its side, its opening towards the camera, its lid wide open on a vertical hinge; fold the
    lid shut with the closed gripper and retreat.
    Randomizations: box, position, yaw (up to `YAW_RAD`), side of the hinge, opening of the lid (`WIDE_FRACTION`).
    Success: the lid is open by at most `SHUT_RAD` (`shut`) and slower than `STILL_RAD_S` (`still`); the arm is slower
    than `CALM_RAD_S` (`calm`), and the TCP at least `CLEAR_M` away from the lid (`released`).
    """

    card = TaskCard(id="CloseBox-v1", family="boxes", difficulty=Difficulty.EASY, articulated_dof=1, axes="z")
    slots: ClassVar[Mapping[str, str]] = {"box": FLUSH}
    prompt = "The robot arm presses the open lid of the {} shut with its closed gripper."
    reached = "shut"

    @override
    def place(self, model: AssetModel, rng: np.random.Generator) -> Placement:
        """Place a box on its side in front of the robot."""
        left = 1.0 if rng.random() < 0.5 else -1.0  # side of the hinge as seen from the robot
        R_lying = np.array([[0.0, 0.0, 1.0], [-left, 0.0, 0.0], [0.0, -left, 0.0]])
        R = rotation_z(rng.uniform(-YAW_RAD, YAW_RAD)) @ R_lying
        opening = np.array([rng.uniform(0.50, 0.54), left * rng.uniform(-0.03, 0.05), model.size["width_m"] / 2.0])
        return Placement(
            model=model,
            X_BM=make_pose(R, opening - model.size["height_m"] * R[:, 2]),
            joint=float(rng.uniform(*WIDE_FRACTION)) * model.size["open_rad"],
        )

    @override
    def goal(self, state: State) -> float:
        return SHUT_RAD


TASKS: tuple[Task, ...] = (
    CloseBox(),
    OpenBox("OpenBoxEasy-v1", ajar=True, to_the_right=False),
    OpenBox("OpenBoxEasy-v2", ajar=True, to_the_right=True),
    OpenBox("OpenBoxHard-v1", ajar=False, to_the_right=False),
    OpenBox("OpenBoxHard-v2", ajar=False, to_the_right=True),
)
"""Tasks of this family."""
