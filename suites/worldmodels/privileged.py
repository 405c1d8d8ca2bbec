"""TODO."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.suites.episode import Episode

State = Mapping[str, Mapping[str, NDArray[np.float32]]]
"""What `Stage.simulation_state` tells."""


@runtime_checkable
class Privileged(Protocol):
    """A world model that is told the true state before each request."""

    def see(self, episode: Episode, state: State) -> None:
        """Be told what the next request is about."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueTrack:
    """What a clip truly shows of the gripper."""

    X_CH: Array
    """(T, 4, 4) panda_hand in the camera frame [m]."""
    finger_width_m: Array
    """(T,) gap between the finger pads [m]."""


@runtime_checkable
class Telling(Protocol):
    """A world model that tells the true track of its clips: what perfect grounding would read."""

    def true_track(self) -> TrueTrack | None:
        """That of the clip generated last; None where it keeps it to itself."""
        ...
