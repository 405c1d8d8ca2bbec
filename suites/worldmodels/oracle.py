"""The expert as a world model: what it would do from the present state on, rendered. It tells how far the rest can get.

With a fault its videos are made worse by a known amount, to see that success falls with it.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.mp4 import write_video
from kinebench_drake.suites.clip import film
from kinebench_drake.suites.episode import Episode
from kinebench_drake.suites.experts.registry import find_expert
from kinebench_drake.suites.faults.fault import Grade
from kinebench_drake.suites.faults.plant import plant
from kinebench_drake.suites.faults.take import Take
from kinebench_drake.suites.faults.trickstage import TrickStage
from kinebench_drake.suites.rollout import Performance, perform_clip
from kinebench_drake.suites.stagehand import Stagehand
from kinebench_drake.suites.worldmodels.privileged import State
from kinebench_drake.suites.worldmodels.worldmodel import Request, WorldModelError


class Oracle:
    """See the module. It is told the true state before each request (`see`)."""

    def __init__(self, fault: Grade | None = None) -> None:
        """Prepare.

        Args:
            fault: what to plant into the first clip of each episode.
        """
        self._fault = fault
        self._hand: Stagehand[TrickStage] | None = None
        self._seen: tuple[Episode, State] | None = None

    @property
    def name(self) -> str:
        """See `WorldModel`."""
        return "oracle" if self._fault is None else f"oracle+{self._fault.label}"

    def see(self, episode: Episode, state: State) -> None:
        """Be told what the next request is about."""
        self._seen = episode, state

    def generate(self, request: Request, out: Path) -> Path:
        """See `WorldModel`."""
        if self._seen is None:
            raise WorldModelError("the oracle was not told the state")
        episode, state = self._seen
        stage = self._stage(episode, request.first_frame.shape[0])
        stage.reset(episode)
        stage.restore(state)
        try:
            frames = self._frames(stage, episode, request)
        except InputError as error:
            raise WorldModelError(str(error)) from None
        path = out.with_name(f"{out.name}.mp4")
        write_video(path, frames, request.fps)
        return path

    def close(self) -> None:
        """See `WorldModel`."""
        if self._hand is not None:
            self._hand.close()
            self._hand = None

    def _stage(self, episode: Episode, size: int) -> TrickStage:
        if self._hand is None:
            self._hand = Stagehand(TrickStage, size)
        return self._hand.stage(episode.task, episode.variant)

    def _frames(self, stage: TrickStage, episode: Episode, request: Request) -> NDArray[np.uint8]:
        before = stage.snapshot()
        clip = perform_clip(stage, find_expert(episode.task))
        if clip is None:  # nothing is left to do
            return np.repeat(request.first_frame[None], request.num_frames, axis=0)
        snapshots = (before, *clip.snapshots)[: request.num_frames]
        shown = film(stage, snapshots)
        if self._fault is not None and request.round == 0:
            performance = Performance(
                episode=episode, snapshots=snapshots, controls=clip.controls, outcome=stage.outcome()
            )
            shown, _ = plant(Take(stage=stage, performance=performance, clip=shown), self._fault)
        return shown.rgb
