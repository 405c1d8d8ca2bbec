"""A stage of one's own, on which world models that look behind the picture try out what they imagine."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.io.atomic import disk_errors
from kinebench_drake.io.container import write_video
from kinebench_drake.suites.clip import film
from kinebench_drake.suites.clock import CLIP_FRAMES
from kinebench_drake.suites.episode import Episode
from kinebench_drake.suites.experts.registry import Expert
from kinebench_drake.suites.faults.fault import FaultGrade
from kinebench_drake.suites.faults.fault_simulator import FaultSimulator
from kinebench_drake.suites.faults.plant import plant
from kinebench_drake.suites.faults.recording import Recording
from kinebench_drake.suites.rollout import Rollout, rollout_clip
from kinebench_drake.suites.simulator_cache import SimulatorCache
from kinebench_drake.suites.worldmodels.privileged import State, TrueTrack
from kinebench_drake.suites.worldmodels.worldmodel import Request, WorldModelError


class OracleRenderer:
    """Performs and films from the state that it was told."""

    def __init__(self) -> None:
        self._hand: SimulatorCache[FaultSimulator] | None = None
        self._seen: tuple[Episode, State] | None = None
        self._track: TrueTrack | None = None

    def see(self, episode: Episode, state: State) -> None:
        """Be told where the next clip begins."""
        self._seen = episode, state

    def write_clip(self, expert: Expert, request: Request, out: Path, fault: FaultGrade | None = None) -> Path:
        """Film what an expert does next, with a fault if one is named.

        Raises:
            InputError: the expert finds no path, or the clip has no place for the fault.
            WorldModelError: no state was told.
            SetupError: the video cannot be written.
        """
        if self._seen is None:
            raise WorldModelError("no state was told")
        frames = self._frames(*self._seen, expert, request, fault)
        path = out.with_name(f"{out.name}.mp4")
        with disk_errors(path.name):
            write_video(path, frames, request.fps)
        return path

    @property
    def true_track(self) -> TrueTrack | None:
        """What the last clip truly shows; None before the first."""
        return self._track

    def close(self) -> None:
        """Free the stage."""
        if self._hand is not None:
            self._hand.close()
            self._hand = None

    def _frames(
        self, episode: Episode, state: State, expert: Expert, request: Request, fault: FaultGrade | None
    ) -> NDArray[np.uint8]:
        self._hand = self._hand or SimulatorCache(FaultSimulator, request.first_frame.shape[0])
        stage = self._hand.stage(episode.task, episode.variant)
        stage.reset(episode)
        stage.restore(state)
        before = stage.snapshot()
        done = rollout_clip(stage, expert)
        rest = (before,) * CLIP_FRAMES if done is None else done.snapshots  # None: nothing is left to do
        snapshots = (before, *rest)[: request.num_frames]
        outcome = stage.outcome()
        shown = film(stage, snapshots)
        if fault is not None and done is not None:
            performance = Rollout(episode=episode, snapshots=snapshots, controls=done.controls, outcome=outcome)
            shown, _ = plant(Recording(stage=stage, performance=performance, clip=shown), fault)
        self._track = TrueTrack(X_CH=shown.X_CH, finger_width_m=shown.finger_width_m)
        return shown.rgb
