"""World models that look behind the picture: those that measure the rest of the program, not themselves."""

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.suites.episode import Episode

State = Mapping[str, Mapping[str, NDArray[np.float32]]]
"""What `Stage.simulation_state` tells."""


@runtime_checkable
class Privileged(Protocol):
    """A world model that is told the true state before each request."""

    def see(self, episode: Episode, state: State) -> None:
        """Be told what the next request is about."""
        ...
