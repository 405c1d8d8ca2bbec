"""How much error a task forgives: the expert's true track, made worse by known amounts, and executed.

So an error of the grounding can be read as success that it may have cost, task by task.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from math import ceil
from typing import TYPE_CHECKING, Any

import numpy as np

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.closed_loop.commands import CommandPlanner, RobotState
from kinebench_drake.closed_loop.execution import execute
from kinebench_drake.errors import KinebenchError, UnmeasurableError
from kinebench_drake.executors.base import Executor, WorkerCrash
from kinebench_drake.executors.progress import Observer
from kinebench_drake.geometry import Array, make_pose, rotation_exp
from kinebench_drake.io.figure import new_figure
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.stats import wilson
from kinebench_drake.suites.clock import CLIP_FRAMES, FRAME_PERIOD_S
from kinebench_drake.suites.episode import Episode
from kinebench_drake.suites.experts.registry import find_expert
from kinebench_drake.suites.rollout import Rollout, run_expert
from kinebench_drake.suites.seeding import generator
from kinebench_drake.suites.simulator import Control, Simulator
from kinebench_drake.suites.simulator_cache import SimulatorCache, failure_reason

if TYPE_CHECKING:
    from matplotlib.figure import Figure


RAD_PER_M = np.deg2rad(5.0) / 0.015
"""Rotation errors go with position errors: 5 degrees with 15 mm."""


class PoseError(Enum):
    """What is wrong with a track."""

    BIAS = "bias"
    """Every pose is off by the same, in a direction drawn for each episode [m]."""
    JITTER = "jitter"
    """Every pose is off by its own: the root mean square of the distance [m]."""
    FINGERS = "finger_delay"
    """The fingers do what they do so many frames later, or earlier if negative."""


GRADES: dict[PoseError, tuple[float, ...]] = {
    PoseError.BIAS: (0.005, 0.01, 0.015, 0.02, 0.025, 0.03),
    PoseError.JITTER: (0.005, 0.01, 0.015, 0.02, 0.025, 0.03),
    PoseError.FINGERS: (-8.0, -4.0, -2.0, 2.0, 4.0, 8.0),
}
"""Sizes tried of each, beside none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorGrade:
    """One error of one size; without a kind the track as it is."""

    error: PoseError | None
    size: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ToleranceAttempt:
    """One execution of one track."""

    episode: Episode
    grade: ErrorGrade
    success: bool
    progress: float
    """0..1."""
    reason: str
    """Which conditions failed, or why there was nothing to execute; empty with success."""


def grades(errors: Sequence[PoseError]) -> list[ErrorGrade]:
    """None, then each error in each of its sizes."""
    return [ErrorGrade(error=None, size=0.0), *(ErrorGrade(error=e, size=size) for e in errors for size in GRADES[e])]


def worsened(X_BG: Array, finger_width_m: Array, grade: ErrorGrade, rng: np.random.Generator) -> tuple[Array, Array]:
    """A track's poses (T, 4, 4) [m] and gaps (T,) [m] with an error planted.

    Rotation vectors are drawn like displacements, times `RAD_PER_M`.
    """
    match grade.error:
        case PoseError.BIAS:
            p, w = (grade.size * _direction(rng) for _ in range(2))
            return _moved(X_BG, p, RAD_PER_M * w), finger_width_m
        case PoseError.JITTER:
            p, w = rng.normal(0.0, grade.size / np.sqrt(3.0), (2, len(X_BG), 3))
            return _moved(X_BG, p, RAD_PER_M * w), finger_width_m
        case PoseError.FINGERS:
            frames = np.clip(np.arange(len(X_BG)) - int(grade.size), 0, len(X_BG) - 1)
            return X_BG, finger_width_m[frames]
        case None:
            return X_BG, finger_width_m


def _direction(rng: np.random.Generator) -> Array:
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))


def _moved(X_BG: Array, p: Array, w: Array) -> Array:
    return make_pose(X_BG[:, :3, :3] @ rotation_exp(w), X_BG[:, :3, 3] + p)


class _AttemptWorker:
    """Performs an episode once and executes its track with each error."""

    def __init__(self, errors: Sequence[PoseError]) -> None:
        self._grades = grades(errors)
        self._simulators = SimulatorCache(Simulator, benchmark_camera().width, renders=False)
        self._commander = CommandPlanner(ArmPlant())

    def __call__(self, episode: Episode) -> list[ToleranceAttempt]:
        simulator = self._simulators.get(episode.task, episode.variant)
        try:
            rollout = run_expert(simulator, find_expert(episode.task), episode)
        except Exception as error:
            return [_attempt(episode, grade, failure_reason(error)) for grade in self._grades]
        return [self._attempt(simulator, rollout, grade) for grade in self._grades]

    def _attempt(self, simulator: Simulator, rollout: Rollout, grade: ErrorGrade) -> ToleranceAttempt:
        episode, plant = rollout.episode, self._commander.plant
        rng = generator("tolerance", episode.id, "" if grade.error is None else grade.error.value)
        X_BG = np.stack([plant.forward(s.q) for s in rollout.snapshots])
        width = np.array([s.fingers_m.sum() for s in rollout.snapshots])
        X_BG, width = worsened(X_BG, width, grade, rng)
        simulator.reset(episode)
        now = simulator.snapshot()
        posed = RobotState(q=now.q, finger_width_m=float(now.fingers_m.sum()), gripping=False)
        try:
            for start in range(0, len(X_BG) - 1, CLIP_FRAMES):
                clip = slice(start, start + CLIP_FRAMES + 1)
                posed, done = self._clip(simulator, X_BG[clip], width[clip], posed)
                if done:
                    break
        except UnmeasurableError as error:
            return _attempt(episode, grade, str(error))
        outcome = simulator.outcome()
        return ToleranceAttempt(
            episode=episode, grade=grade, success=outcome.success, progress=outcome.progress, reason=outcome.reason
        )

    def _clip(
        self, simulator: Simulator, X_BG: Array, finger_width_m: Array, start: RobotState
    ) -> tuple[RobotState, bool]:
        """Execute one clip: how the robot stands then, and whether the task has succeeded."""
        seen = np.ones(len(X_BG), dtype=bool)
        t_s = FRAME_PERIOD_S * np.arange(len(X_BG), dtype=np.float64)
        commands = self._commander.commands(X_BG, finger_width_m, seen, t_s, start)
        execution = execute(simulator, commands, Control.JOINTS)
        end = execution.snapshots[-1]
        posed = RobotState(q=end.q, finger_width_m=float(end.fingers_m.sum()), gripping=commands.gripping)
        return posed, execution.outcome.success


def _attempt(episode: Episode, grade: ErrorGrade, reason: str) -> ToleranceAttempt:
    return ToleranceAttempt(episode=episode, grade=grade, success=False, progress=0.0, reason=reason)


@dataclass(frozen=True, slots=True)
class _MakeAttempts:
    """Makes a worker in each process."""

    errors: tuple[PoseError, ...]

    def __call__(self) -> Callable[[Episode], list[ToleranceAttempt]]:
        return _AttemptWorker(self.errors)


def run_attempts(
    engine: Executor, episodes: Sequence[Episode], errors: Sequence[PoseError], observer: Observer
) -> list[ToleranceAttempt]:
    """Execute the exact and the worsened tracks of episodes; return all attempts, ordered by episode id.

    Raises:
        KinebenchError: a worker died.
    """
    observer.start(len(episodes), 0)
    attempts: list[ToleranceAttempt] = []
    for done in engine.run(_MakeAttempts(tuple(errors)), list(episodes)):
        if isinstance(done, WorkerCrash):
            raise KinebenchError(f"{done.item.id}: {done.reason}")
        exact = done.result[0]
        observer.advance(f"{done.item.id}: {exact.reason}" if exact.reason else done.item.id)
        attempts += done.result
    return sorted(attempts, key=lambda a: a.episode.id)


_UNITS = {PoseError.BIAS: (1000.0, "mm"), PoseError.JITTER: (1000.0, "mm"), PoseError.FINGERS: (1.0, "frames")}


def tasks_of(attempts: Sequence[ToleranceAttempt]) -> list[str]:
    """Tasks, in their order."""
    return list(dict.fromkeys(a.episode.task for a in attempts))


def grades_of(attempts: Sequence[ToleranceAttempt], error: PoseError) -> list[ErrorGrade]:
    """Sizes of an error that were tried, in rising order, without error among them; none if it was not."""
    exact = ErrorGrade(error=None, size=0.0)
    tried = [ErrorGrade(error=error, size=size) for size in GRADES[error]]
    tried = [grade for grade in tried if any(a.grade == grade for a in attempts)]
    return sorted([exact, *tried], key=lambda grade: grade.size) if tried else []


def rate(attempts: Sequence[ToleranceAttempt], grade: ErrorGrade, task: str | None = None) -> tuple[int, int]:
    """Successes and attempts of a grade, of one task or of all."""
    chosen = [a for a in attempts if a.grade == grade and task in (None, a.episode.task)]
    return sum(a.success for a in chosen), len(chosen)


def label(error: PoseError, grade: ErrorGrade) -> str:
    """A size in its unit, such as "15 mm"."""
    factor, unit = _UNITS[error]
    return f"{grade.size * factor:g} {unit}"


def table_lines(attempts: Sequence[ToleranceAttempt]) -> Iterator[str]:
    """The tables to print, one for each error."""
    for error in PoseError:
        tried = grades_of(attempts, error)
        if not tried:
            continue
        yield f"success under {error.value.replace('_', ' ')}"
        yield f"{'':20}" + "".join(f"{label(error, grade):>11}" for grade in tried)
        for task in (*tasks_of(attempts), None):
            cells = [rate(attempts, grade, task) for grade in tried]
            yield f"{task or 'all':20}" + "".join(f"{good:>7}/{n:<3}" for good, n in cells)
        bounds = [wilson(*rate(attempts, grade)) for grade in tried]
        yield f"{'95 % interval':20}" + "".join(f"{f'{low:.0%}-{high:.0%}':>11}" for low, high in bounds)
        yield ""


def table_json(attempts: Sequence[ToleranceAttempt]) -> dict[str, Any]:
    """Every attempt, as JSON."""
    return {
        "attempts": [
            {
                "task": a.episode.task,
                "seed": a.episode.seed,
                "error": None if a.grade.error is None else a.grade.error.value,
                "size": a.grade.size,
                "success": a.success,
                "progress": a.progress,
                "reason": a.reason,
            }
            for a in attempts
        ]
    }


_COLUMNS = 5
_STYLES = {
    PoseError.BIAS: {"color": "#1f6fb2", "marker": "o", "label": "bias [mm]"},
    PoseError.JITTER: {"color": "#c4622d", "marker": "s", "label": "jitter [mm]"},
    PoseError.FINGERS: {"color": "#8a5fb0", "marker": "^", "label": "finger delay [frames, above]"},
}


def draw_tolerance(attempts: Sequence[ToleranceAttempt]) -> "Figure":
    """All tasks together, then each; millimetres of bias and jitter below, frames of delay above."""
    panels: list[str | None] = [None, *tasks_of(attempts)]
    rows = ceil(len(panels) / _COLUMNS)
    figure, axes = new_figure(2.7 * _COLUMNS, 2.2 * rows, rows, _COLUMNS, sharey=True)
    lines: dict[PoseError, Any] = {}
    for ax, task in zip(axes.flat, panels, strict=False):
        ax.set_title(task or "all tasks", fontsize=9, fontweight="bold" if task is None else "normal")
        ax.set_ylim(-0.04, 1.04)
        ax.tick_params(labelsize=7)
        for error in PoseError:
            grades = grades_of(attempts, error)
            if not grades:
                continue
            delay = error is PoseError.FINGERS
            where = ax.twiny() if delay else ax
            if delay:
                where.tick_params(labelsize=6, colors=_STYLES[error]["color"], pad=0)
            sizes = [grade.size * (1.0 if delay else 1000.0) for grade in grades]
            shares = [good / max(n, 1) for good, n in (rate(attempts, grade, task) for grade in grades)]
            [lines[error]] = where.plot(sizes, shares, markersize=3, linewidth=1.2, **_STYLES[error])
    for ax in axes.flat[len(panels) :]:
        ax.axis("off")
    for ax in axes[:, 0]:
        ax.set_ylabel("success", fontsize=8)
    figure.supxlabel("error of the position [mm], the rotation's with it", fontsize=9)
    figure.legend(handles=list(lines.values()), loc="outside upper center", ncols=3, fontsize=8, frameon=False)
    return figure
