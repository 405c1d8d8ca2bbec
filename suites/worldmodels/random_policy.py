"""A robot that moves about at random: what a world model that shows any motion at all should beat."""

from functools import partial
from pathlib import Path

import numpy as np

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import rotation_exp
from kinebench_drake.suites.episode import Episode
from kinebench_drake.suites.experts.motion import Waypoint
from kinebench_drake.suites.tasks.task import Scene
from kinebench_drake.suites.worldmodels.oracle_renderer import OracleRenderer
from kinebench_drake.suites.worldmodels.privileged import State
from kinebench_drake.suites.worldmodels.worldmodel import Request, WorldModelError

MOVES = 4
"""Moves in a clip."""
SPREAD_M = (0.12, 0.2, 0.08)
"""Standard deviation of a move's end from the middle of the workspace, along x, y and z."""
MIDDLE_M = (0.5, 0.0, 0.2)
"""The middle of the workspace in B."""
LOWEST_M = 0.03
"""Least height of the TCP over the table."""
TURN_RAD = 0.5
"""Standard deviation of a move's turn about each axis."""
_TRIES = 20


class RandomPolicyModel:
    """See the module. It is told the true state before each request (`see`)."""

    def __init__(self, name: str = "random") -> None:
        self.name = name
        self._private = OracleRenderer()

    def see(self, episode: Episode, state: State) -> None:
        """See `Privileged`."""
        self._private.see(episode, state)

    def generate(self, request: Request, out: Path) -> Path:
        """See `WorldModel`. Paths that the arm cannot do, or that collide, are drawn anew."""
        rng = np.random.default_rng(request.seed)
        for _ in range(_TRIES):
            try:
                return self._private.write_clip(partial(_anywhere, rng), request, out)
            except InputError as error:
                reason = str(error)
        raise WorldModelError(f"no random path in {_TRIES} tries: {reason}")

    def close(self) -> None:
        """See `WorldModel`."""
        self._private.close()


def _anywhere(rng: np.random.Generator, scene: Scene) -> list[Waypoint]:
    waypoints = []
    for _ in range(MOVES):
        X = scene.X_BG.copy()
        X[:3, 3] = rng.normal(MIDDLE_M, SPREAD_M)
        X[2, 3] = max(X[2, 3], LOWEST_M)
        X[:3, :3] = X[:3, :3] @ rotation_exp(rng.normal(0.0, TURN_RAD, 3))
        waypoints.append(Waypoint(X_BG=X, finger_width_m=float(rng.choice([0.0, 0.08]))))
    return waypoints
