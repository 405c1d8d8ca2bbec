"""Tolerance of tasks to track errors: success of the expert's true track with planted errors of graded size.

It relates an error of the grounding to the success that it costs, task by task.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial
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
from kinebench_drake.suites.composition import Episode
from kinebench_drake.suites.families.registry import find_expert
from kinebench_drake.suites.rollout import Rollout, run_expert
from kinebench_drake.suites.seeding import generator
from kinebench_drake.suites.simulator import Control, Simulator
from kinebench_drake.suites.simulator_cache import SimulatorCache, SimulatorWorker, failure_reason

if TYPE_CHECKING:
    from matplotlib.figure import Figure


RAD_PER_M = np.deg2rad(5.0) / 0.015
"""Ratio of rotation errors to position errors: 5 degrees with 15 mm."""


class PoseError(Enum):
    """Errors of a track."""

    BIAS = "bias"
    """Constant displacement of all poses, in a random direction for each episode [m]."""
    JITTER = "jitter"
    """Independent displacement of each pose, by its root mean square [m]."""
    FINGERS = "finger_delay"
    """Delay of the fingers [frames]; negative: they are early."""


GRADES: dict[PoseError, tuple[float, ...]] = {
    PoseError.BIAS: (0.005, 0.01, 0.015, 0.02, 0.025, 0.03),
    PoseError.JITTER: (0.005, 0.01, 0.015, 0.02, 0.025, 0.03),
    PoseError.FINGERS: (-8.0, -4.0, -2.0, 2.0, 4.0, 8.0),
}
"""Sizes of each error, beside the exact track."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorGrade:
    """Error of one size; None: the exact track."""

    error: PoseError | None
    size: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ToleranceAttempt:
    """Execution of a track."""

    episode: Episode
    grade: ErrorGrade
    success: bool = False
    progress: float = 0.0
    """Progress, 0..1."""
    reason: str
    """Failed conditions, or why there was nothing to execute; empty on success."""


def grades(errors: Sequence[PoseError]) -> list[ErrorGrade]:
    """Return the exact track, then each error in each of its sizes."""
    return [ErrorGrade(error=None, size=0.0), *(ErrorGrade(error=e, size=size) for e in errors for size in GRADES[e])]


def plant_error(X_BG: Array, finger_width_m: Array, grade: ErrorGrade, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return poses (T, 4, 4) [m] and gaps (T,) [m] of a track with an error.

    Rotation vectors are drawn like displacements, times `RAD_PER_M`.
    """
    match grade.error:
        case PoseError.BIAS:
            p, w = (grade.size * _draw_direction(rng) for _ in range(2))
            return _displace(X_BG, p, RAD_PER_M * w), finger_width_m
        case PoseError.JITTER:
            p, w = rng.normal(0.0, grade.size / np.sqrt(3.0), (2, len(X_BG), 3))
            return _displace(X_BG, p, RAD_PER_M * w), finger_width_m
        case PoseError.FINGERS:
            frames = np.clip(np.arange(len(X_BG)) - int(grade.size), 0, len(X_BG) - 1)
            return X_BG, finger_width_m[frames]
        case None:
            return X_BG, finger_width_m


def _draw_direction(rng: np.random.Generator) -> Array:
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))


def _displace(X_BG: Array, p: Array, w: Array) -> Array:
    return make_pose(X_BG[:, :3, :3] @ rotation_exp(w), X_BG[:, :3, 3] + p)


class _AttemptWorker(SimulatorWorker[Simulator]):
    """Runs the expert once per episode and executes its track with each error."""

    def __init__(self, errors: Sequence[PoseError]) -> None:
        self._grades = grades(errors)
        super().__init__(SimulatorCache(Simulator, benchmark_camera().width, renders=False))
        self._planner = CommandPlanner(ArmPlant())

    def __call__(self, episode: Episode) -> list[ToleranceAttempt]:
        simulator = self._simulators.get(episode.task, episode.variant)
        try:
            rollout = run_expert(simulator, find_expert(episode.task), episode)
        except Exception as error:
            reason = failure_reason(error)
            return [ToleranceAttempt(episode=episode, grade=grade, reason=reason) for grade in self._grades]
        return [self._attempt(simulator, rollout, grade) for grade in self._grades]

    def _attempt(self, simulator: Simulator, rollout: Rollout, grade: ErrorGrade) -> ToleranceAttempt:
        episode, plant = rollout.episode, self._planner.plant
        rng = generator("tolerance", episode.id, "" if grade.error is None else grade.error.value)
        X_BG = plant.forward_path([s.q for s in rollout.snapshots])
        width = np.array([s.fingers_m.sum() for s in rollout.snapshots])
        X_BG, width = plant_error(X_BG, width, grade, rng)
        simulator.reset(episode)
        now = simulator.snapshot()
        state = RobotState(q=now.q, finger_width_m=float(now.fingers_m.sum()), gripping=False)
        try:
            for start in range(0, len(X_BG) - 1, CLIP_FRAMES):
                clip = slice(start, start + CLIP_FRAMES + 1)
                state, done = self._clip(simulator, X_BG[clip], width[clip], state)
                if done:
                    break
        except UnmeasurableError as error:
            return ToleranceAttempt(episode=episode, grade=grade, reason=str(error))
        outcome = simulator.outcome()
        return ToleranceAttempt(
            episode=episode, grade=grade, success=outcome.success, progress=outcome.progress, reason=outcome.reason
        )

    def _clip(
        self, simulator: Simulator, X_BG: Array, finger_width_m: Array, start: RobotState
    ) -> tuple[RobotState, bool]:
        """Execute one clip; return the final state of the robot and whether the task succeeded."""
        tracked = np.ones(len(X_BG), dtype=bool)
        t_s = FRAME_PERIOD_S * np.arange(len(X_BG), dtype=np.float64)
        commands = self._planner.plan(X_BG, finger_width_m, tracked, t_s, start)
        execution = execute(simulator, commands, Control.JOINTS)
        end = execution.snapshots[-1]
        state = RobotState(q=end.q, finger_width_m=float(end.fingers_m.sum()), gripping=commands.gripping)
        return state, execution.outcome.success


def run_attempts(
    executor: Executor, episodes: Sequence[Episode], errors: Sequence[PoseError], observer: Observer
) -> list[ToleranceAttempt]:
    """Execute the exact and the worsened tracks of episodes; return all attempts, ordered by episode id.

    Raises:
        KinebenchError: a worker died.
    """
    observer.start(len(episodes), 0)
    attempts: list[ToleranceAttempt] = []
    for done in executor.run(partial(_AttemptWorker, tuple(errors)), list(episodes)):
        if isinstance(done, WorkerCrash):
            raise KinebenchError(f"{done.item.id}: {done.reason}")
        exact = done.result[0]
        observer.advance(f"{done.item.id}: {exact.reason}" if exact.reason else done.item.id)
        attempts += done.result
    return sorted(attempts, key=lambda a: a.episode.id)


_UNITS = {PoseError.BIAS: (1000.0, "mm"), PoseError.JITTER: (1000.0, "mm"), PoseError.FINGERS: (1.0, "frames")}


def tasks_of(attempts: Sequence[ToleranceAttempt]) -> list[str]:
    """Return the tasks, in order."""
    return list(dict.fromkeys(a.episode.task for a in attempts))


def grades_of(attempts: Sequence[ToleranceAttempt], error: PoseError) -> list[ErrorGrade]:
    """Return the executed sizes of an error in increasing order, including 0; none if the error was not executed."""
    exact = ErrorGrade(error=None, size=0.0)
    tried = [ErrorGrade(error=error, size=size) for size in GRADES[error]]
    tried = [grade for grade in tried if any(a.grade == grade for a in attempts)]
    return sorted([exact, *tried], key=lambda grade: grade.size) if tried else []


def rate(attempts: Sequence[ToleranceAttempt], grade: ErrorGrade, task: str | None = None) -> tuple[int, int]:
    """Count successes and attempts of a grade, of one task or of all."""
    chosen = [a for a in attempts if a.grade == grade and task in (None, a.episode.task)]
    return sum(a.success for a in chosen), len(chosen)


def label(error: PoseError, grade: ErrorGrade) -> str:
    """Return a size with its unit, such as "15 mm"."""
    factor, unit = _UNITS[error]
    return f"{grade.size * factor:g} {unit}"


def table_lines(attempts: Sequence[ToleranceAttempt]) -> Iterator[str]:
    """Yield the lines of tables to print, one table per error."""
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
    """Return every attempt as JSON."""
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
    """Draw success against error for all tasks and each task: bias and jitter [mm] below, delay [frames] above."""
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
