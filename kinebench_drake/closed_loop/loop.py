"""One episode in closed loop: a model imagines, the grounding reads, the robot executes, and so on, round by round."""

import glob
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.closed_loop.commands import CommandPlanner, Commands, RobotState
from kinebench_drake.closed_loop.execution import Execution, execute
from kinebench_drake.errors import InputError, UnmeasurableError, UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.framing.framing import undo_framing
from kinebench_drake.grounding.framing.search import find_framing
from kinebench_drake.grounding.pipeline import GroundingResult
from kinebench_drake.io.atomic import disk_errors, remove
from kinebench_drake.io.files import VIDEO_SUFFIXES
from kinebench_drake.io.reader import read_video
from kinebench_drake.suites.clock import (
    CLIP_FRAMES,
    CONTROL_PERIOD_S,
    FRAME_PERIOD_S,
    MAX_FRAME_PERIOD_S,
    MIN_FRAME_PERIOD_S,
)
from kinebench_drake.suites.episode import Episode
from kinebench_drake.suites.export import FPS
from kinebench_drake.suites.seeding import generator
from kinebench_drake.suites.simulator import Control, Simulator, TaskOutcome
from kinebench_drake.suites.worldmodels.worldmodel import (
    OfflineModel,
    PrivilegedModel,
    Request,
    SupportsTrueTrack,
    WorldModel,
)
from kinebench_drake.types import GripperTrack, InitialState, Priors


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopOptions:
    """How episodes are run."""

    rounds: int = 3
    """Most clips of an episode."""
    control: Control = Control.JOINTS
    """What the robot is told."""
    action_repeat: int | None = None
    """Control steps a frame; None: as long as the frames last."""
    frame_period_s: float = FRAME_PERIOD_S
    """Task time between two frames [s]."""
    pixels_only: bool = False
    """Whether the first frame's pose, which the robot knows of itself, is left aside."""
    num_frames: int = CLIP_FRAMES + 1
    """Frames asked of the model, the first one included."""
    negative_prompt: str = ""
    seed: int = 0
    """Of the model's randomness."""

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            UsageError: one of them makes no sense.
        """
        for option, count in (("--rounds", self.rounds), ("--action-repeat", self.action_repeat)):
            if count is not None and count < 1:
                raise UsageError(f"{option} is {count}, expected 1 or more")
        if not MIN_FRAME_PERIOD_S <= self.frame_period_s <= MAX_FRAME_PERIOD_S:
            raise UsageError(
                f"--frame-period is {self.frame_period_s}, expected seconds from {MIN_FRAME_PERIOD_S:g} to "
                f"{MAX_FRAME_PERIOD_S:g}, such as {FRAME_PERIOD_S:g}"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Round:
    """One clip: imagined, read, executed."""

    video: Path
    """What the model imagined."""
    frames: NDArray[np.uint8]
    """(T, H, W, 3) the same as frames in the shape of the camera's picture, whatever the model made of it."""
    robot: NDArray[np.bool_]
    """(T, H, W) their pixels that show the robot."""
    grounded: GroundingResult
    commands: Commands | None
    """None where the track holds nothing to execute; `refusal` says why."""
    refusal: str | None
    execution: Execution | None


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeRun:
    """How an episode went."""

    rounds: tuple[Round, ...]
    outcome: TaskOutcome
    """The task's verdict at the end."""


Ground = Callable[[NDArray[np.uint8], Camera, Array, Priors], GroundingResult]
"""Tracks the gripper through frames (T, H, W, 3) of a camera at times (T,) [s], with priors."""


class ClosedLoop:
    """Runs episodes with one model on one simulator."""

    def __init__(self, ground: Ground, commander: CommandPlanner, model: WorldModel, options: LoopOptions) -> None:
        """Compose."""
        self._ground, self._commander, self._model, self._options = ground, commander, model, options

    def run(self, simulator: Simulator, episode: Episode, videos: Path) -> EpisodeRun:
        """Run an episode until it succeeds, the rounds are used up, or nothing can be executed.

        Args:
            simulator: where; it is reset.
            episode: what is to be done.
            videos: path of what the model imagines, to which "_r0" and so on are added.

        Raises:
            WorldModelError: the model gave no video.
            InputError: its video cannot be read.
            SetupError: something is missing on this machine.
        """
        if not isinstance(self._model, OfflineModel):  # whose own folder this may be
            _forget(videos)
        simulator.reset(episode)
        return EpisodeRun(rounds=tuple(self._rounds(simulator, episode, videos)), outcome=simulator.outcome())

    def _rounds(self, simulator: Simulator, episode: Episode, videos: Path) -> Iterator[Round]:
        gripping = False
        for number in range(1 if isinstance(self._model, OfflineModel) else self._options.rounds):
            done = self._round(simulator, episode, number, videos.with_name(f"{videos.name}_r{number}"), gripping)
            yield done
            if done.execution is None or done.execution.outcome.success:
                return
            gripping = done.commands is not None and done.commands.gripping

    def _round(self, simulator: Simulator, episode: Episode, number: int, out: Path, gripping: bool) -> Round:
        options, now = self._options, simulator.snapshot()
        first_frame = simulator.render().rgb
        request = Request(
            episode=episode.id,
            task=episode.task,
            round=number,
            prompt=episode.prompt,
            negative_prompt=options.negative_prompt,
            seed=int(generator("world model", episode.id, number, options.seed).integers(2**31)),
            first_frame=first_frame,
            num_frames=options.num_frames,
            fps=FPS,
        )
        if isinstance(self._model, PrivilegedModel):
            self._model.set_state(episode, simulator.simulation_state())
        video = _kept(self._model.generate(request, out), out)
        frames = read_video(video).frames
        if len(frames) < 2:
            raise InputError(f"{video.name}: has {len(frames)} frames, expected {options.num_frames}")
        t_s = options.frame_period_s * np.arange(len(frames), dtype=np.float64)
        width = float(now.fingers_m.sum())
        first = InitialState(X_BG=self._commander.plant.forward(now.q), finger_width_m=width)
        known = Priors() if options.pixels_only else Priors(initial_state=first)
        if isinstance(self._model, SupportsTrueTrack) and (truth := self._model.true_track()) is not None:
            known = Priors(X_CH=truth.X_CH, finger_width_m=truth.finger_width_m)
        try:
            framing = find_framing(frames, simulator.camera, first_frame)
        except UnmeasurableError as error:
            raise InputError(f"{video.name}: {error}") from None
        shown = framing.crop(frames)
        grounded = self._ground(shown, framing.camera(simulator.camera), t_s, known)
        commands, refusal, execution = None, None, None
        try:
            start = RobotState(q=now.q, finger_width_m=width, gripping=gripping)
            commands = self._commands(grounded.track, start)
        except UnmeasurableError as error:
            refusal = str(error)
        else:
            execution = execute(simulator, commands, options.control)
        return Round(
            video=video,
            frames=undo_framing(framing, shown),
            robot=undo_framing(framing, grounded.robot),
            grounded=grounded,
            commands=commands,
            refusal=refusal,
            execution=execution,
        )

    def _commands(self, track: GripperTrack, start: RobotState) -> Commands:
        repeat = self._options.action_repeat
        t_s: Array = track.t_s
        if repeat is not None:
            t_s = CONTROL_PERIOD_S * repeat * np.arange(len(t_s), dtype=np.float64)
        return self._commander.commands(track.X_BG, track.finger_width_m, track.tracked, t_s, start)


def _forget(videos: Path) -> None:
    """Remove what was imagined for an episode when it was run before: that may have taken more rounds.

    Raises:
        SetupError: it cannot be removed.
    """
    with disk_errors(videos.parent.name):
        for clip in videos.parent.glob(f"{glob.escape(videos.name)}_r[0-9]*"):
            remove(clip)


def _kept(video: Path, out: Path) -> Path:
    """The video, or folder of frames, beside `out`: a copy where it lies elsewhere, in the place of earlier ones.

    Raises:
        SetupError: it cannot be copied.
    """
    here, source = out.parent.resolve(), video.resolve()
    if video.parent.resolve() == here:
        return video
    copy = out.with_name(f"{out.name}{video.suffix}" if video.is_file() else out.name)
    with disk_errors(copy.name):
        for earlier in (here / f"{out.name}{suffix}" for suffix in ("", *VIDEO_SUFFIXES)):
            if not source.is_relative_to(earlier):  # a model may work in a folder of the clip's name
                remove(earlier)
        if video.is_file():
            shutil.copyfile(video, copy)
        else:
            shutil.copytree(video, copy, dirs_exist_ok=True)
    return copy
