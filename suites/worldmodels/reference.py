"""Reference models without a network: the expert (upper bound), a random policy and a still image (lower bounds)."""

from dataclasses import replace
from functools import partial
from itertools import repeat
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import rotation_exp
from kinebench_drake.suites.composition import Episode
from kinebench_drake.suites.expert.motion import Waypoint
from kinebench_drake.suites.families.registry import Expert, find_expert
from kinebench_drake.suites.families.task import Scene
from kinebench_drake.suites.rollout import Rollout, RolloutVideo, continue_expert, render_video
from kinebench_drake.suites.simulator import Simulator, SimulatorState
from kinebench_drake.suites.simulator_cache import SimulatorCache
from kinebench_drake.suites.worldmodels.media import encode_answer
from kinebench_drake.suites.worldmodels.worldmodel import Request, TrueTrack, WorldModel, WorldModelError

_TRIES = 20
_TURN_RAD = 0.5
"""Standard deviation of the rotations of random waypoints about each axis."""
_LEAST_HEIGHT_M = 0.03
"""Least height of random waypoints above the table."""
_WAYPOINTS = 4
"""Waypoints of the random policy in a clip."""


class StillModel(WorldModel):
    """World model that repeats the first frame."""

    def __init__(self, name: str = "still") -> None:
        self.name = name

    def generate(self, request: Request, out: Path) -> Path:
        """Write the first frame `num_frames` times."""
        return encode_answer(repeat(request.first_frame, request.num_frames), request.fps, out)


class OracleRenderer:
    """Simulator of its own in which an expert continues from a given state and is rendered.

    Args:
        delay: further frames for which its clips show the first frame before the motion.
    """

    simulator: type[Simulator] = Simulator
    """Class of the simulator."""

    def __init__(self, delay: int = 0) -> None:
        self._delay = delay
        self._simulators: SimulatorCache[Simulator] | None = None
        self._state: tuple[Episode, SimulatorState] | None = None
        self.truth: TrueTrack | None = None
        """Ground truth of the last clip; None before the first."""

    def set_state(self, episode: Episode, state: SimulatorState) -> None:
        """Set the state from which the next clip begins."""
        self._state = episode, state

    def write_clip(self, expert: Expert, request: Request, out: Path) -> Path:
        """Write the clip in which an expert continues from the state.

        Raises:
            InputError: the expert finds no path.
            WorldModelError: there is no state.
            SetupError: the video cannot be written.
        """
        if self._state is None:
            raise WorldModelError("no simulator state was set")
        return encode_answer(self._frames(*self._state, expert, request), request.fps, out)

    def film(self, simulator: Simulator, rollout: Rollout, request: Request) -> RolloutVideo:
        """Render a clip, of which the simulator is in the last state; other oracles render it in other ways."""
        return render_video(simulator, rollout.snapshots)

    def close(self) -> None:
        """Release the simulator."""
        if self._simulators is not None:
            self._simulators.close()
            self._simulators = None

    def _frames(self, episode: Episode, state: SimulatorState, expert: Expert, request: Request) -> NDArray[np.uint8]:
        self._simulators = self._simulators or SimulatorCache(self.simulator, request.first_frame.shape[0])
        simulator = self._simulators.get(episode.task, episode.variant)
        rollout = continue_expert(simulator, episode, state, expert)
        rollout = replace(rollout, snapshots=rollout.snapshots[: request.num_frames])
        video = self.film(simulator, rollout, request)
        video = video.select([max(k - self._delay, 0) for k in range(len(video.t_s))])
        self.truth = TrueTrack(X_CH=video.X_CH, finger_width_m=video.finger_width_m)
        return video.rgb


class OracleModel(OracleRenderer):
    """World model that renders what the task's expert does next: a perfect model.

    Args:
        discloses: whether it reports the true track of its clips, so that no pose is estimated from pixels.
    """

    def __init__(self, name: str = "oracle", *, discloses: bool = False, delay: int = 0) -> None:
        super().__init__(delay)
        self.name = name
        self._discloses = discloses

    def generate(self, request: Request, out: Path) -> Path:
        """Render the expert from the current state."""
        try:
            return self.write_clip(find_expert(request.task), request, out)
        except InputError as error:
            raise WorldModelError(str(error)) from None

    def true_track(self) -> TrueTrack | None:
        """Return the true track of the last clip, if the model discloses it."""
        return self.truth if self._discloses else None


class RandomPolicyModel(OracleRenderer):
    """World model that renders a robot moving through random waypoints."""

    def __init__(self, name: str = "random") -> None:
        super().__init__()
        self.name = name

    def generate(self, request: Request, out: Path) -> Path:
        """Render random motion from the current state; infeasible or colliding paths are drawn again."""
        rng = np.random.default_rng(request.seed)
        for _ in range(_TRIES):
            try:
                return self.write_clip(partial(_draw_waypoints, rng), request, out)
            except InputError as error:
                reason = str(error)
        raise WorldModelError(f"no random path in {_TRIES} tries: {reason}")


def _draw_waypoints(rng: np.random.Generator, scene: Scene) -> list[Waypoint]:
    waypoints = []
    for _ in range(_WAYPOINTS):
        X = scene.X_BG.copy()
        # Waypoints about the middle of the workspace, in B.
        X[:3, 3] = rng.normal((0.5, 0.0, 0.2), (0.12, 0.2, 0.08))
        X[2, 3] = max(X[2, 3], _LEAST_HEIGHT_M)
        X[:3, :3] = X[:3, :3] @ rotation_exp(rng.normal(0.0, _TURN_RAD, 3))
        waypoints.append(Waypoint(X_BG=X, finger_width_m=float(rng.choice([0.0, 0.08]))))
    return waypoints
