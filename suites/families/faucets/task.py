"""Tasks with faucets."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from torch import Tensor
from typing_extensions import override

from kinebench_drake.suites.families.task import Difficulty, Placement, SceneLayout, Task, TaskCard, TaskVariant
from kinebench_drake.suites.scene.model import AssetModel
from kinebench_drake.suites.scene.state import STILL_RAD_S, State
from kinebench_drake.suites.start import START_WIDTH_M

OPEN_FRACTION = 0.8
"""Least opening of an open handle, as a fraction of its travel."""
CLOSED_FRACTION = 0.1
"""Greatest opening of a closed handle, as a fraction of its travel."""
START_FRACTION = 0.1
"""Greatest initial distance of a handle from its end stop, as a fraction of its travel."""


class _TurnFaucet(Task):
    """Common part of both tasks: one faucet, whose lever is swept from the robot's side towards the camera."""

    slots: ClassVar[Mapping[str, str]] = {"faucet": "faucet"}
    prompt: ClassVar[str]
    """Prompt with a placeholder for the faucet's name."""
    goal: ClassVar[float]
    """Opening at which the task is done, as a fraction of the travel."""
    side: ClassVar[float]
    """Side of the robot on which the lever starts: 1 left, -1 right."""

    def layout(self, models: Mapping[str, AssetModel], rng: np.random.Generator, variant: TaskVariant) -> SceneLayout:
        """Place a faucet whose lever at half travel points 55 to 100 degrees to the side of the camera."""
        model = models["faucet"]
        x, y = rng.uniform([0.52, -0.02], [0.59, 0.09])
        yaw = self.side * np.deg2rad(rng.uniform(55.0, 100.0))
        start = rng.uniform(0.0, START_FRACTION)
        joint = (start if self.goal == OPEN_FRACTION else 1.0 - start) * model.size["range_rad"]
        return SceneLayout(
            placements={"faucet": Placement.upright(model, (x, self.side * y, 0.0), yaw, joint=joint)},
            prompt=self.prompt.format(model.words),
            finger_width_m=START_WIDTH_M[self.card.id],
        )

    def _opening(self, state: State) -> Tensor:
        """Return the opening (N,) of the handles, 0..1."""
        return state.joints["faucet"] / state.size("faucet", "range_rad")

    def progress(self, state: State) -> Tensor:
        """Return the fraction of the handle's way to the goal."""
        return state.joint_progress("faucet", self.goal * state.size("faucet", "range_rad"))


class OpenFaucet(_TurnFaucet):
    """Turn the faucet's handle open.

    Description: a faucet stands on the table; sweep its handle counter-clockwise, seen from above, with the fingers of
    the closed gripper.
    Randomizations: shape, size, finish, travel and stiffness of the faucet; its position and yaw; initial opening (up
    to `START_FRACTION`).
    Success: the handle is open by at least `OPEN_FRACTION` (`open`) and slower than `STILL_RAD_S` (`still`).
    """

    card = TaskCard(id="OpenFaucet-v1", family="faucets", difficulty=Difficulty.EASY, articulated_dof=1, axes="z")
    prompt = "The robot arm opens the {}: it sweeps the handle counter-clockwise with its closed gripper."
    goal, side = OPEN_FRACTION, -1.0

    @override
    def conditions(self, state: State) -> dict[str, Tensor]:
        return {"open": self._opening(state) >= OPEN_FRACTION, "still": state.speeds["faucet"] <= STILL_RAD_S}


class CloseFaucet(_TurnFaucet):
    """Turn the faucet's handle shut.

    Description: an open faucet stands on the table; sweep its handle clockwise, seen from above, with the fingers of
    the closed gripper.
    Randomizations: shape, size, finish, travel and stiffness of the faucet; its position and yaw; initial opening (at
    least 1 - `START_FRACTION`).
    Success: the handle is open by at most `CLOSED_FRACTION` (`closed`) and slower than `STILL_RAD_S` (`still`).
    """

    card = TaskCard(id="CloseFaucet-v1", family="faucets", difficulty=Difficulty.EASY, articulated_dof=1, axes="z")
    prompt = "The robot arm closes the {}: it sweeps the handle clockwise with its closed gripper."
    goal, side = CLOSED_FRACTION, 1.0

    @override
    def conditions(self, state: State) -> dict[str, Tensor]:
        return {"closed": self._opening(state) <= CLOSED_FRACTION, "still": state.speeds["faucet"] <= STILL_RAD_S}


TASKS = (CloseFaucet(), OpenFaucet())
"""Tasks of this family."""
