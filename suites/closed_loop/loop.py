"""Closed loop of one episode: generate a clip, ground it, execute it, repeat from the last executed frame."""

import glob
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.clip_timing import ClipTiming, sample_uniformly
from kinebench_drake.errors import InputError, UnmeasurableError, UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.camera.framing import undo_framing
from kinebench_drake.grounding.priors import Clip, Priors
from kinebench_drake.grounding.video import Grounder
from kinebench_drake.grounding.video_result import GroundingResult
from kinebench_drake.io.atomic import disk_errors, remove
from kinebench_drake.io.jsonl import Json
from kinebench_drake.io.reader import read_video
from kinebench_drake.models.panda.description import TCP_LINK
from kinebench_drake.suites.clock import (
    FRAME_PERIOD_S,
    MAX_FRAME_PERIOD_S,
    MIN_FRAME_PERIOD_S,
    Control,
)
from kinebench_drake.suites.closed_loop.execution import CommandPlanner, Commands, Execution, RobotState, execute
from kinebench_drake.suites.closed_loop.following import ActionSource
from kinebench_drake.suites.composition import Episode
from kinebench_drake.suites.export import FPS, FRAMES
from kinebench_drake.suites.prompts import PromptTemplate
from kinebench_drake.suites.seeding import generator
from kinebench_drake.suites.simulator import Simulator, TaskOutcome
from kinebench_drake.suites.worldmodels.media import place_beside
from kinebench_drake.suites.worldmodels.worldmodel import (
    ActionTrack,
    ChoosesLength,
    Condition,
    OfflineModel,
    PrivilegedModel,
    Request,
    SupportsTrueTrack,
    WorldModel,
    WorldModelError,
    request_video,
)
from kinebench_drake.track import GripperTrack, InitialState


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopOptions:
    """Options of the closed loop."""

    rounds: int = 3
    """Largest number of clips of an episode."""
    control: Control = Control.JOINTS
    frame_period_s: float = FRAME_PERIOD_S
    """Task time between two frames [s]."""
    clip_timing: ClipTiming | None = None
    """How frames lie in task time; None: uniform for models that choose the number of frames, else native."""
    pixels_only: bool = False
    """Do not use the robot's joint state as a prior for the first frame."""
    prompts: PromptTemplate = field(default_factory=PromptTemplate)
    condition: Condition = Condition.NONE
    """Motion that requests state."""

    def __post_init__(self) -> None:
        """Check the frame period.

        Raises:
            UsageError: it is out of range.
        """
        if not MIN_FRAME_PERIOD_S <= self.frame_period_s <= MAX_FRAME_PERIOD_S:
            raise UsageError(
                f"$frame_period_s is {self.frame_period_s}, expected seconds from {MIN_FRAME_PERIOD_S:g} to "
                f"{MAX_FRAME_PERIOD_S:g}, such as {FRAME_PERIOD_S:g}"
            )

    def to_json(self) -> dict[str, Json]:
        """Serialize the options that a run can set into `config` of results.json."""
        return {
            "rounds": self.rounds,
            "control": self.control.value,
            "frame_period_s": self.frame_period_s,
            "clip_timing": None if self.clip_timing is None else self.clip_timing.value,
            "pixels_only": self.pixels_only,
            "condition": None if self.condition is Condition.NONE else self.condition.value,
            **self.prompts.to_json(),
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Round:
    """One clip: generated, grounded, executed."""

    video: Path
    timing: ClipTiming
    """How its frames lie in task time."""
    generated_frames: int
    """Number of its frames."""
    frames: NDArray[np.uint8]
    """(T, H, W, 3) those that are used, with aspect ratio and view of the camera."""
    robot: NDArray[np.bool_]
    """(T, H, W) pixels of the robot in them."""
    grounding: GroundingResult
    actions: ActionTrack | None = None
    """Motion that was requested."""
    commands: Commands | None = None
    """None if the track has nothing to execute."""
    rejection: str | None = None
    """Reason why there are no commands."""
    execution: Execution | None = None
    """None without commands."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PendingRound:
    """Next round of an episode, whose video an offline model does not have yet."""

    request: Request
    X_BG: Array
    """(4, 4) panda_hand_tcp in the base frame in the first frame [m]."""
    finger_width_m: float
    """Gap between the finger pads in it [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeRun:
    """Rounds and outcome of an episode."""

    rounds: tuple[Round, ...]
    outcome: TaskOutcome
    """Outcome of the task in the final state."""
    pending: PendingRound | None
    """None for a complete episode."""


class ClosedLoop:
    """Runs episodes with one world model; without a source of actions requests state none."""

    def __init__(
        self,
        grounder: Grounder,
        planner: CommandPlanner,
        model: WorldModel,
        options: LoopOptions,
        actions: ActionSource | None = None,
    ) -> None:
        self._grounder = grounder
        self._planner = planner
        self._model = model
        self._options = options
        self._actions = actions

    def run(self, simulator: Simulator, episode: Episode, videos: Path, sample: int = 0) -> EpisodeRun:
        """Run an episode until it succeeds, the rounds are used up, or nothing can be executed.

        Args:
            simulator: simulator of the task; it is reset.
            videos: path of the generated videos, to which "_r0" and so on are appended; its name is that of the sample.
            sample: number of the sample of the episode; each has its own seeds.

        Raises:
            WorldModelError: the model gave no video.
            InputError: its video cannot be read.
            SetupError: something is missing on this machine.
        """
        model = self._model
        options = self._options
        if not isinstance(model, OfflineModel):  # the folder of an offline model may be this one
            _remove_earlier_clips(videos)
        simulator.reset(episode)
        rounds = list[Round]()
        gripping = False
        pending = None
        for number in range(options.rounds):
            state = RobotState.of(simulator.snapshot(), gripping=gripping)
            first_frame = simulator.render().rgb
            request = self.make_request(episode, videos.name, sample, number, first_frame)
            if self._actions is not None:
                here = simulator.simulation_state()
                try:
                    actions = self._actions.track(episode, here, FRAMES, options.frame_period_s)
                except InputError:
                    if not rounds:
                        raise
                    break  # the clips have led to where no expert continues: the episode has failed
                request = replace(request, actions=actions)
            asks = number > 0 or request.actions is not None  # `suite export` writes first frames without actions
            if asks and isinstance(model, OfflineModel) and not model.files(videos.name, episode.task, number):
                pending = PendingRound(
                    request=request, X_BG=simulator.link_pose(TCP_LINK), finger_width_m=state.finger_width_m
                )
                break
            if isinstance(model, PrivilegedModel):
                model.set_state(episode, simulator.simulation_state())
            out = videos.with_name(f"{videos.name}_r{number}")
            try:
                video = place_beside(request_video(model, request, out), out)
            except WorldModelError:
                if not rounds or not isinstance(model, PrivilegedModel):
                    raise
                break  # likewise of the expert that is rendered
            grounded = self.ground_round(video, first_frame, simulator.camera, state)
            commands, rejection = self.plan_round(grounded.grounding.track, state)
            execution = None if commands is None else execute(simulator, commands, options.control)
            rounds.append(
                replace(grounded, actions=request.actions, commands=commands, rejection=rejection, execution=execution)
            )
            if commands is None or execution is None or execution.outcome.success:
                break
            gripping = commands.gripping
        return EpisodeRun(rounds=tuple(rounds), outcome=simulator.outcome(), pending=pending)

    def make_request(
        self, episode: Episode, name: str, sample: int, number: int, first_frame: NDArray[np.uint8]
    ) -> Request:
        """Return the request for the video of a round, whose seed is its own."""
        options = self._options
        further = [sample] if sample else []
        return Request(
            episode=name,
            task=episode.task,
            round=number,
            prompt=options.prompts.prompt(episode),
            negative_prompt=options.prompts.negative,
            seed=int(generator("world model", episode.id, number, 0, *further).integers(2**31)),
            first_frame=first_frame,
            num_frames=FRAMES,
            fps=FPS,
        )

    def choose_frames(self, frames: int) -> tuple[ClipTiming, NDArray[np.intp], Array]:
        """Return the timing of a clip of so many frames, the indices (T,) of those to use, and their times (T,) [s]."""
        options = self._options
        model = self._model
        own = isinstance(model, ChoosesLength) and model.chooses_length
        timing = options.clip_timing or (ClipTiming.UNIFORM if own else ClipTiming.NATIVE)
        period_s = options.frame_period_s
        if timing is ClipTiming.UNIFORM:
            return timing, *sample_uniformly(frames, period_s * (FRAMES - 1), period_s)
        return timing, np.arange(frames), period_s * np.arange(frames, dtype=np.float64)

    def ground_round(self, video: Path, first_frame: NDArray[np.uint8], camera: Camera, state: RobotState) -> Round:
        """Return the round of a video that was grounded, but not executed."""
        decoded = read_video(video).frames
        if len(decoded) < 2:
            raise InputError(f"{video.name}: has {len(decoded)} frames, expected {FRAMES}")
        timing, chosen, t_s = self.choose_frames(len(decoded))
        clip = Clip(frames=decoded[chosen], t_s=t_s, conditioning=first_frame, is_view=True)
        try:
            grounding = self._grounder.ground(clip, camera, self._priors(state, chosen), trusts_camera=True)
        except UnmeasurableError as error:
            raise InputError(f"{video.name}: {error}") from None
        frames = grounding.frames
        path = grounding.measured.camera_path
        if path is not None:
            frames, _ = path.stabilize(frames, grounding.camera, extends=False)
        return Round(
            video=video,
            timing=timing,
            generated_frames=len(decoded),
            frames=undo_framing(grounding.framing, np.asarray(frames)),
            robot=undo_framing(grounding.framing, grounding.robot),
            grounding=grounding,
        )

    def _priors(self, state: RobotState, frames: NDArray[np.intp]) -> Priors:
        """Return the true track at these frames if the model discloses it, else the robot's state in the first one."""
        if isinstance(self._model, SupportsTrueTrack) and (truth := self._model.true_track()) is not None:
            return Priors(X_CH=truth.X_CH[frames], finger_width_m=truth.finger_width_m[frames])
        if self._options.pixels_only:
            return Priors()
        return Priors(
            initial_state=InitialState(X_BG=self._planner.plant.forward(state.q), finger_width_m=state.finger_width_m)
        )

    def plan_round(self, track: GripperTrack, state: RobotState) -> tuple[Commands | None, str | None]:
        """Return the commands of a track, or the reason why there are none."""
        try:
            return self._planner.plan(track.X_BG, track.finger_width_m, track.tracked, track.t_s, state), None
        except UnmeasurableError as error:
            return None, str(error)


def _remove_earlier_clips(videos: Path) -> None:
    """Remove the clips of an earlier run of the episode, which may have had more rounds."""
    with disk_errors(videos.parent.name):
        for clip in videos.parent.glob(f"{glob.escape(videos.name)}_r[0-9]*"):
            remove(clip)
