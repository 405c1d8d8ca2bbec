"""Whether a robot can execute a whole video, and what is against it."""

from collections.abc import Collection
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.segments import segments

LOST_FRAMES = 3
"""Number of consecutive frames without a pose that no interpolation bridges soundly."""
LOST_SHARE = 0.1
"""Share of all frames without a pose above which no gap counts as bridged."""
INFEASIBLE, UNDECIDED, LOST = "infeasible", "undecided", "lost"
"""Reasons other than the kinds of anomalies."""

_NOT_OF_THE_ROBOT = frozenset({AnomalyKind.CAMERA.value})


def find_obstacles(feasible: bool | None, tracked: NDArray[np.bool_], anomalies: Collection[str] | None) -> list[str]:
    """List what is against executing a motion: INFEASIBLE or UNDECIDED, LOST, kinds of anomalies.

    In a video a gap of fewer than LOST_FRAMES frames between `tracked` ones (T,) is bridged by interpolation, if no
    more than LOST_SHARE of all frames is lost. Without a video (`anomalies` None) every lost frame counts.
    """
    obstacles = [] if feasible else [INFEASIBLE if feasible is False else UNDECIDED]
    gaps, n = segments(~tracked), len(tracked)
    bridged = anomalies is not None and (~tracked).sum() <= LOST_SHARE * n
    bridged = bridged and all(gap.start > 0 and gap.stop < n and gap.stop - gap.start < LOST_FRAMES for gap in gaps)
    if gaps and not bridged:
        obstacles.append(LOST)
    return obstacles + sorted(set(anomalies or ()) - _NOT_OF_THE_ROBOT)


def is_executable(obstacles: Collection[str]) -> bool | None:
    """Return whether nothing is against it; None if only the open verdict on the motion is."""
    return True if not obstacles else None if list(obstacles) == [UNDECIDED] else False


class FailureVerdict(Enum):
    """Causes of failed episodes, in the order in which they are tested."""

    GROUNDING = "grounding"
    """The gripper, or the gap between its fingers, was not tracked with confidence in frames that show it."""
    GENERATION = "generation"
    """The video has an anomaly, or a motion that the robot cannot execute."""
    EXECUTION = "execution"
    """The executed gripper deviated from the generated one."""
    TASK = "task"
    """None of these, and the goal is not reached: the generated motion does not do the task."""
