"""Execution of commands in the simulator, frame by frame."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kinebench_drake.closed_loop.commands import Commands
from kinebench_drake.geometry import Array
from kinebench_drake.models.panda.robot import TCP_LINK
from kinebench_drake.suites.simulator import Control, Simulator, Snapshot, TaskOutcome


@dataclass(frozen=True, slots=True, kw_only=True)
class Execution:
    """Executed part of a clip."""

    snapshots: tuple[Snapshot, ...]
    """States at the frames, beginning with the one before the first command and ending at success."""
    outcomes: tuple[TaskOutcome, ...]
    """Outcomes of the task at each frame but the first."""
    X_BG: Array
    """(T, 4, 4) panda_hand_tcp in the base frame at each snapshot [m]."""

    @property
    def finger_width_m(self) -> Array:
        """(T,) gap between the finger pads at each snapshot [m]."""
        return np.array([s.fingers_m.sum() for s in self.snapshots])

    @property
    def outcome(self) -> TaskOutcome:
        """Outcome at the end."""
        return self.outcomes[-1]


def execute(simulator: Simulator, commands: Commands, control: Control) -> Execution:
    """Execute commands from the current state on, until the task succeeds or they end.

    Args:
        simulator: simulator with this control.
        commands: the commands.
        control: send joint angles or poses.
    """
    snapshots, outcomes, X_BG = [simulator.snapshot()], list[TaskOutcome](), [simulator.link_pose(TCP_LINK)]
    for start, end in pairwise(commands.frame_steps):
        for i in range(start, end):
            if control is Control.JOINTS:
                simulator.step(commands.q[i], float(commands.finger_width_m[i]))
            else:
                simulator.step_pose(commands.X_BG[i], float(commands.finger_width_m[i]))
        snapshots.append(simulator.snapshot())
        outcomes.append(simulator.outcome())
        X_BG.append(simulator.link_pose(TCP_LINK))
        if outcomes[-1].success:
            break
    return Execution(snapshots=tuple(snapshots), outcomes=tuple(outcomes), X_BG=np.stack(X_BG))
