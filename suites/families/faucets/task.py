"""Tasks with faucets."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from torch import Tensor
from typing_extensions import override

from kinebench_drake.suites.families.task import Difficulty, JointTask, Placement, TaskCard
from kinebench_drake.suites.scene.model import AssetModel
from kinebench_drake.suites.scene.state import STILL_RAD_S, State

OPEN_FRACTION = 0.8
"""Least opening of an open handle, as a fraction of its travel."""
CLOSED_FRACTION = 0.1
"""Greatest opening of a closed handle, as a fraction of its travel."""
START_FRACTION = 0.1
"""Greatest initial distance of a handle from its end stop, as a fraction of its travel."""


class _TurnFaucet(JointTask):
    """Common part of both tasks: the lever is swept from the robot's side towards the camera."""

    slots: ClassVar[Mapping[str, str]] = {"faucet": "faucet"}
    fraction: ClassVar[float]
    """Opening at which the task is done, as a fraction of the travel."""
    side: ClassVar[float]
    """Side of the robot on which the lever starts: 1 left, -1 right."""

    @override
    def place(self, model: AssetModel, rng: np.random.Generator) -> Placement:
        """Place a faucet whose lever at half travel points 55 to 100 degrees to the side of the camera."""
        x, y = rng.uniform([0.52, -0.02], [0.59, 0.09])
        yaw = self.side * np.deg2rad(rng.uniform(55.0, 100.0))
        start = rng.uniform(0.0, START_FRACTION)
        return Placement.upright(
            model,
            (x, self.side * y, 0.0),
            yaw,
            joint=(start if self.reached == "open" else 1.0 - start) * model.size["range_rad"],
        )

    @override
    def goal(self, state: State) -> Tensor:
        return self.fraction * state.size("faucet", "range_rad")

    @override
    def rest_conditions(self, state: State) -> dict[str, Tensor]:
        return {"still": state.speeds["faucet"] <= STILL_RAD_S}


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
    reached = "open"
    fraction = OPEN_FRACTION
    side = -1.0


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
    reached = "closed"
    fraction = CLOSED_FRACTION
    side = 1.0


TASKS = (CloseFaucet(), OpenFaucet())
"""Tasks of this family."""
