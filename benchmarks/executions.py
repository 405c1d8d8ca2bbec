"""Execution of the tracks of videos in the simulator, from the initial state of their episodes, without rendering."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.perception.store import MeasurementStore, fingerprint
from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import InputError, UnmeasurableError
from kinebench_drake.executors.base import Observer
from kinebench_drake.executors.local import LocalExecutor
from kinebench_drake.io.npz import open_npz
from kinebench_drake.io.reader import read_video
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.results.trackfile import read_track
from kinebench_drake.segments import finite_rows
from kinebench_drake.suites.catalog import EpisodeSpec
from kinebench_drake.suites.clock import CLIP_FRAMES, FRAME_PERIOD_S, Control
from kinebench_drake.suites.closed_loop.execution import CommandPlanner, RobotState, execute
from kinebench_drake.suites.simulator import Simulator
from kinebench_drake.suites.simulator_cache import SimulatorCache
from kinebench_drake.track import GripperTrack
from training.baseline.network import Baseline


class Extractor(Enum):
    """Source of the track that is executed."""

    TRUTH = "truth"
    GROUNDING = "grounding"
    BASELINE = "baseline"


@dataclass(frozen=True, slots=True, kw_only=True)
class ClipTrack:
    """Track of the first clip of an episode by one extractor."""

    id: str
    """Id of the video."""
    spec: EpisodeSpec
    extractor: Extractor
    source: Path
    """File of the truth, of the grounding's track, or video of the baseline."""

    def read(self, baseline: Baseline | None) -> GripperTrack:
        """Return the track; the baseline is applied to the video.

        Raises:
            InputError: the file is absent or damaged.
        """
        if self.extractor is Extractor.GROUNDING:
            track = read_track(self.source).track
            return track.at(np.arange(min(len(track.t_s), CLIP_FRAMES + 1)))
        if self.extractor is Extractor.BASELINE and baseline is not None:
            frames = read_video(self.source).frames
            t_s = FRAME_PERIOD_S * np.arange(len(frames), dtype=np.float64)
            return baseline.track(frames, t_s, benchmark_camera())
        with open_npz(self.source) as truth:
            X_BG = truth["base_from_tcp"]
            tracked = np.asarray(np.isfinite(X_BG).all(axis=(1, 2)))
            return GripperTrack(
                t_s=truth["t_s"],
                X_CH=np.full_like(X_BG, np.nan),
                X_BG=X_BG,
                tracked=tracked,
                confidence=np.asarray(tracked, dtype=np.float64),
                finger_width_m=truth["finger_width_m"],
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackExecution:
    """Outcome of a video's track in the simulator."""

    success: bool
    reason: str


class ExecutionWorker:
    """Executes tracks from the initial state of their episodes."""

    def __init__(self, weights: Path | None) -> None:
        """Load the robot, and the weights of the baseline if there are any."""
        self._simulators = SimulatorCache(Simulator, benchmark_camera().width, renders=False)
        self._planner = CommandPlanner(ArmPlant())
        self._baseline = None if weights is None else Baseline.load(weights)

    def __call__(self, clip: ClipTrack) -> TrackExecution:
        """Execute one track; a track that cannot be read or executed fails."""
        try:
            return self.execute(clip.spec, clip.read(self._baseline))
        except (InputError, UnmeasurableError) as error:
            return TrackExecution(success=False, reason=str(error))

    def execute(self, spec: EpisodeSpec, track: GripperTrack) -> TrackExecution:
        """Execute a track of an episode.

        Raises:
            UnmeasurableError: there is nothing to execute.
        """
        simulator = self._simulators.get(spec.task, spec.variant)
        simulator.reset(spec.episode())
        start = RobotState.of(simulator.snapshot())
        # Where the arm contradicts the camera, a tracked gripper has no pose in the base frame.
        tracked = track.tracked & finite_rows(track.X_BG.reshape(-1, 16))
        commands = self._planner.plan(track.X_BG, track.finger_width_m, tracked, track.t_s, start)
        outcome = execute(simulator, commands, Control.JOINTS).outcome
        return TrackExecution(success=outcome.success, reason=outcome.reason)

    def close(self) -> None:
        """Release the simulator."""
        self._simulators.close()


def execute_all(
    clips: Sequence[ClipTrack], keep: Path, weights: Path | None, jobs: int, observer: Observer
) -> list[TrackExecution]:
    """Execute tracks, in their order; an interrupted run resumes from the file of finished executions, `keep`.

    Raises:
        SetupError: something is missing on this machine, or a worker died. What is finished is kept.
    """
    code = fingerprint(modules=[__name__], files=[] if weights is None else [weights])

    def key(clip: ClipTrack) -> str:
        files = [clip.source] if clip.source.is_file() else []
        return f"{code}-{fingerprint(clip.extractor.value, files=files)}-{clip.id}"

    make_worker = partial(ExecutionWorker, weights)
    store = MeasurementStore(keep, TrackExecution)
    return store.complete(clips, key, LocalExecutor(jobs=jobs), make_worker, observer, lambda clip: clip.id)
