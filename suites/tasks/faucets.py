"""Tasks with faucets."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from torch import Tensor

from kinebench_drake.suites.assets.model import Model
from kinebench_drake.suites.start import START_WIDTH_M
from kinebench_drake.suites.tasks.card import Difficulty, TaskCard, TaskVariant
from kinebench_drake.suites.tasks.layout import resting
from kinebench_drake.suites.tasks.state import STILL_RAD_S, State
from kinebench_drake.suites.tasks.task import Placement, SceneLayout, Task

OPEN_PART = 0.8
"""From this part of its travel on a handle is open."""
CLOSED_PART = 0.1
"""Up to this part of its travel a handle is closed."""
START_PART = 0.1
"""A handle begins within this part of its travel from the end that it is to leave."""


class _TurnFaucet(Task):
    """What both tasks share: one faucet, whose lever is swept from the robot's side towards the camera."""

    slots: ClassVar[Mapping[str, str]] = {"faucet": "faucet"}
    _side: ClassVar[float]
    """1: the lever is on the robot's left, -1: on its right."""

    def layout(self, models: Mapping[str, Model], rng: np.random.Generator, variant: TaskVariant) -> SceneLayout:
        """A faucet in front of the robot, its lever half-way 55 to 100 degrees aside of the camera's direction."""
        model, side = models["faucet"], self._side
        x, y = rng.uniform([0.52, -0.02], [0.59, 0.09])
        return SceneLayout(
            placements={
                "faucet": Placement(
                    model=model,
                    X_BM=resting(x, side * y, 0.0, side * np.deg2rad(rng.uniform(55.0, 100.0))),
                    joint=self._start_part(rng.uniform(0.0, START_PART)) * model.size["range_rad"],
                )
            },
            prompt=self._prompt(model.words),
            finger_width_m=START_WIDTH_M[self.card.id],
        )

    @abstractmethod
    def _start_part(self, travelled: float) -> float:
        """Where in its range the handle begins, 0 closed to 1 open, if it has left its end by a part of its travel."""

    @abstractmethod
    def _prompt(self, words: str) -> str: ...

    def _part(self, state: State) -> Tensor:
        """How far (N,) the handles are open, 0..1."""
        return state.joints["faucet"] / state.size("faucet", "range_rad")


class OpenFaucet(_TurnFaucet):
    """Turn the faucet's handle open.

    Description: a faucet stands on the table; sweep its handle counter-clockwise, seen from above, with the closed
    gripper's fingers.
    Randomizations: shape, size, finish, travel and stiffness of the faucet, its place and direction, how far the handle
    is open at the start (up to a tenth).
    Success: the handle has come to 80 % of its travel (`open`) and is still.
    """

    card = TaskCard(
        id="OpenFaucet-v1", family="faucets", difficulty=Difficulty.EASY, articulated_dof=1, axes="z", contacts=1
    )

    _side = -1.0

    def _start_part(self, travelled: float) -> float:
        return travelled

    def _prompt(self, words: str) -> str:
        return f"The robot arm opens the {words}: it sweeps the handle counter-clockwise with its closed gripper."

    def conditions(self, state: State) -> dict[str, Tensor]:
        """See the class."""
        return {"open": self._part(state) >= OPEN_PART, "still": state.speeds["faucet"] <= STILL_RAD_S}

    def progress(self, state: State) -> Tensor:
        """Part of the way to 80 % of the travel."""
        return state.travelled("faucet", OPEN_PART * state.size("faucet", "range_rad"))


class CloseFaucet(_TurnFaucet):
    """Turn the faucet's handle shut.

    Description: a faucet stands on the table, open; sweep its handle clockwise, seen from above, with the closed
    gripper's fingers.
    Randomizations: shape, size, finish, travel and stiffness of the faucet, its place and direction, how far the handle
    is open at the start (nine tenths at least).
    Success: the handle is within 10 % of its travel from the end (`closed`) and is still.
    """

    card = TaskCard(
        id="CloseFaucet-v1", family="faucets", difficulty=Difficulty.EASY, articulated_dof=1, axes="z", contacts=1
    )

    _side = 1.0

    def _start_part(self, travelled: float) -> float:
        return 1.0 - travelled

    def _prompt(self, words: str) -> str:
        return f"The robot arm closes the {words}: it sweeps the handle clockwise with its closed gripper."

    def conditions(self, state: State) -> dict[str, Tensor]:
        """See the class."""
        return {"closed": self._part(state) <= CLOSED_PART, "still": state.speeds["faucet"] <= STILL_RAD_S}

    def progress(self, state: State) -> Tensor:
        """Part of the way to 10 % of the travel."""
        return state.travelled("faucet", CLOSED_PART * state.size("faucet", "range_rad"))


TASKS = (CloseFaucet(), OpenFaucet())
"""Tasks of this family."""
