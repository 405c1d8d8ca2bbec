"""How much error a task forgives: the expert's true track, made worse by known amounts, and executed.

So an error of the grounding can be read as success that it may have cost, task by task.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.engines import Crashed, Engine
from kinebench_drake.errors import KinebenchError, UnmeasurableError
from kinebench_drake.geometry import Array, make_pose, rotation_exp
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.suites.clock import CLIP_FRAMES, FRAME_PERIOD_S
from kinebench_drake.suites.closedloop.commands import Commander, Posed
from kinebench_drake.suites.closedloop.execution import execute
from kinebench_drake.suites.episode import Episode
from kinebench_drake.suites.experts.registry import find_expert
from kinebench_drake.suites.rollout import Performance, perform
from kinebench_drake.suites.seeding import generator
from kinebench_drake.suites.stage import Control, Stage
from kinebench_drake.suites.stagehand import Stagehand, failure

RAD_PER_M = np.deg2rad(5.0) / 0.015
"""Rotation errors go with position errors: 5 degrees with 15 mm."""


class Error(Enum):
    """What is wrong with a track."""

    BIAS = "bias"
    """Every pose is off by the same, in a direction drawn for each episode [m]."""
    JITTER = "jitter"
    """Every pose is off by its own: the root mean square of the distance [m]."""
    FINGERS = "finger_delay"
    """The fingers do what they do so many frames later, or earlier if negative."""


GRADES: dict[Error, tuple[float, ...]] = {
    Error.BIAS: (0.005, 0.01, 0.015, 0.02, 0.025, 0.03),
    Error.JITTER: (0.005, 0.01, 0.015, 0.02, 0.025, 0.03),
    Error.FINGERS: (-8.0, -4.0, -2.0, 2.0, 4.0, 8.0),
}
"""Sizes tried of each, beside none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Grade:
    """One error of one size; without a kind the track as it is."""

    error: Error | None
    size: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt:
    """One execution of one track."""

    episode: Episode
    grade: Grade
    success: bool
    progress: float
    """0..1."""
    reason: str
    """Which conditions failed, or why there was nothing to execute; empty with success."""


def grades(errors: Sequence[Error]) -> list[Grade]:
    """None, then each error in each of its sizes."""
    return [Grade(error=None, size=0.0), *(Grade(error=e, size=size) for e in errors for size in GRADES[e])]


def worsened(X_BG: Array, finger_width_m: Array, grade: Grade, rng: np.random.Generator) -> tuple[Array, Array]:
    """A track's poses (T, 4, 4) [m] and gaps (T,) [m] with an error planted.

    Rotation vectors are drawn like displacements, times `RAD_PER_M`.
    """
    match grade.error:
        case Error.BIAS:
            p, w = (grade.size * _direction(rng) for _ in range(2))
            return _moved(X_BG, p, RAD_PER_M * w), finger_width_m
        case Error.JITTER:
            p, w = rng.normal(0.0, grade.size / np.sqrt(3.0), (2, len(X_BG), 3))
            return _moved(X_BG, p, RAD_PER_M * w), finger_width_m
        case Error.FINGERS:
            frames = np.clip(np.arange(len(X_BG)) - int(grade.size), 0, len(X_BG) - 1)
            return X_BG, finger_width_m[frames]
        case None:
            return X_BG, finger_width_m


def _direction(rng: np.random.Generator) -> Array:
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))


def _moved(X_BG: Array, p: Array, w: Array) -> Array:
    return make_pose(X_BG[:, :3, :3] @ rotation_exp(w), X_BG[:, :3, 3] + p)


class _Worker:
    """Performs an episode once and executes its track with each error."""

    def __init__(self, errors: Sequence[Error]) -> None:
        self._grades = grades(errors)
        self._hand = Stagehand(Stage, benchmark_camera().width, renders=False)
        self._commander = Commander(ArmPlant())

    def __call__(self, episode: Episode) -> list[Attempt]:
        stage = self._hand.stage(episode.task, episode.variant)
        try:
            performance = perform(stage, find_expert(episode.task), episode)
        except Exception as error:
            return [_attempt(episode, grade, failure(error)) for grade in self._grades]
        return [self._attempt(stage, performance, grade) for grade in self._grades]

    def _attempt(self, stage: Stage, performance: Performance, grade: Grade) -> Attempt:
        episode, plant = performance.episode, self._commander.plant
        rng = generator("tolerance", episode.id, "" if grade.error is None else grade.error.value)
        X_BG = np.stack([plant.forward(s.q) for s in performance.snapshots])
        width = np.array([s.fingers_m.sum() for s in performance.snapshots])
        X_BG, width = worsened(X_BG, width, grade, rng)
        stage.reset(episode)
        now = stage.snapshot()
        posed = Posed(q=now.q, finger_width_m=float(now.fingers_m.sum()), gripping=False)
        try:
            for start in range(0, len(X_BG) - 1, CLIP_FRAMES):
                clip = slice(start, start + CLIP_FRAMES + 1)
                posed, done = self._clip(stage, X_BG[clip], width[clip], posed)
                if done:
                    break
        except UnmeasurableError as error:
            return _attempt(episode, grade, str(error))
        outcome = stage.outcome()
        return Attempt(
            episode=episode, grade=grade, success=outcome.success, progress=outcome.progress, reason=outcome.reason
        )

    def _clip(self, stage: Stage, X_BG: Array, finger_width_m: Array, start: Posed) -> tuple[Posed, bool]:
        """Execute one clip: how the robot stands then, and whether the task has succeeded."""
        seen = np.ones(len(X_BG), dtype=bool)
        t_s = FRAME_PERIOD_S * np.arange(len(X_BG), dtype=np.float64)
        commands = self._commander.commands(X_BG, finger_width_m, seen, t_s, start)
        execution = execute(stage, commands, Control.JOINTS)
        end = execution.snapshots[-1]
        posed = Posed(q=end.q, finger_width_m=float(end.fingers_m.sum()), gripping=commands.gripping)
        return posed, execution.outcome.success


def _attempt(episode: Episode, grade: Grade, reason: str) -> Attempt:
    return Attempt(episode=episode, grade=grade, success=False, progress=0.0, reason=reason)


@dataclass(frozen=True, slots=True)
class _Make:
    """Makes a worker in each process."""

    errors: tuple[Error, ...]

    def __call__(self) -> Callable[[Episode], list[Attempt]]:
        return _Worker(self.errors)


def run_attempts(engine: Engine, episodes: Sequence[Episode], errors: Sequence[Error]) -> Iterator[list[Attempt]]:
    """The attempts of each episode, in any order of episodes.

    Raises:
        KinebenchError: a worker died.
    """
    for done in engine.run(_Make(tuple(errors)), list(episodes)):
        if isinstance(done, Crashed):
            raise KinebenchError(f"{done.item.id}: {done.reason}")
        yield done.result
