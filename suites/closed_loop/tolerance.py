"""Tolerance of tasks to track errors: success of the expert's true track with planted errors of graded size.

It relates an error of the grounding to the success that it costs, task by task.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial
from typing import Any

import numpy as np

from kinebench_drake.errors import KinebenchError, UnmeasurableError
from kinebench_drake.executors.base import Executor, Observer, WorkerCrash
from kinebench_drake.geometry import Array, make_pose, rotation_exp
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.stats import wilson
from kinebench_drake.suites.clock import CLIP_FRAMES, FRAME_PERIOD_S, Control
from kinebench_drake.suites.closed_loop.execution import CommandPlanner, RobotState, execute
from kinebench_drake.suites.composition import Episode
from kinebench_drake.suites.families.registry import find_expert
from kinebench_drake.suites.rollout import Rollout, run_expert
from kinebench_drake.suites.seeding import generator
from kinebench_drake.suites.simulator import Simulator
from kinebench_drake.suites.simulator_cache import SimulatorCache, SimulatorWorker, failure_reason


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


_RAD_PER_M = np.deg2rad(5.0) / 0.015
"""Ratio of rotation errors to position errors: 5 degrees with 15 mm."""
EXACT = ErrorGrade(error=None, size=0.0)


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
    return [EXACT, *(ErrorGrade(error=e, size=size) for e in errors for size in GRADES[e])]


def plant_error(X_BG: Array, finger_width_m: Array, grade: ErrorGrade, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return poses (T, 4, 4) [m] and gaps (T,) [m] of a track with an error.

    Rotation vectors are drawn like displacements, times `_RAD_PER_M`.
    """
    match grade.error:
        case PoseError.BIAS:
            directions = (rng.normal(size=3) for _ in range(2))
            p, w = (grade.size * np.asarray(v / np.linalg.norm(v)) for v in directions)
        case PoseError.JITTER:
            p, w = rng.normal(0.0, grade.size / np.sqrt(3.0), (2, len(X_BG), 3))
        case PoseError.FINGERS:
            frames = np.clip(np.arange(len(X_BG)) - int(grade.size), 0, len(X_BG) - 1)
            return X_BG, finger_width_m[frames]
        case None:
            return X_BG, finger_width_m
    return make_pose(X_BG[:, :3, :3] @ rotation_exp(_RAD_PER_M * w), X_BG[:, :3, 3] + p), finger_width_m


def _run_grades(simulator: Simulator, episode: Episode, errors: Sequence[PoseError]) -> list[ToleranceAttempt]:
    """Run the expert once and execute its track, exact and with each error in each size."""
    try:
        rollout = run_expert(simulator, find_expert(episode.task), episode)
    except Exception as error:
        reason = failure_reason(error)
        return [ToleranceAttempt(episode=episode, grade=grade, reason=reason) for grade in grades(errors)]
    planner = CommandPlanner(ArmPlant())
    return [_attempt(simulator, planner, rollout, grade) for grade in grades(errors)]


def _attempt(simulator: Simulator, planner: CommandPlanner, rollout: Rollout, grade: ErrorGrade) -> ToleranceAttempt:
    """Execute the track of a rollout with an error, clip by clip."""
    episode = rollout.episode
    rng = generator("tolerance", episode.id, "" if grade.error is None else grade.error.value)
    X_BG = planner.plant.forward_path([s.q for s in rollout.snapshots])
    width = np.array([s.finger_width_m for s in rollout.snapshots])
    X_BG, width = plant_error(X_BG, width, grade, rng)
    simulator.reset(episode)
    state = RobotState.of(simulator.snapshot())
    try:
        for start in range(0, len(X_BG) - 1, CLIP_FRAMES):
            clip = slice(start, start + CLIP_FRAMES + 1)
            frames = len(X_BG[clip])
            t_s = FRAME_PERIOD_S * np.arange(frames, dtype=np.float64)
            commands = planner.plan(X_BG[clip], width[clip], np.ones(frames, dtype=bool), t_s, state)
            execution = execute(simulator, commands, Control.JOINTS)
            if execution.outcome.success:
                break
            state = RobotState.of(execution.snapshots[-1], gripping=commands.gripping)
    except UnmeasurableError as error:
        return ToleranceAttempt(episode=episode, grade=grade, reason=str(error))
    outcome = simulator.outcome()
    return ToleranceAttempt(
        episode=episode, grade=grade, success=outcome.success, progress=outcome.progress, reason=outcome.reason
    )


def run_attempts(
    executor: Executor, episodes: Sequence[Episode], errors: Sequence[PoseError], observer: Observer
) -> list[ToleranceAttempt]:
    """Execute the exact and the worsened tracks of episodes; return all attempts, ordered by episode id.

    Raises:
        KinebenchError: a worker died.
    """
    observer.start(len(episodes), 0)
    attempts: list[ToleranceAttempt] = []
    work = partial(_run_grades, errors=tuple(errors))
    for done in executor.run(partial(SimulatorWorker, work, SimulatorCache(Simulator, renders=False)), list(episodes)):
        if isinstance(done, WorkerCrash):
            raise KinebenchError(f"{done.item.id}: {done.reason}")
        exact = done.result[0]
        observer.advance(f"{done.item.id}: {exact.reason}" if exact.reason else done.item.id)
        attempts += done.result
    return sorted(attempts, key=lambda a: a.episode.id)


def tasks_of(attempts: Sequence[ToleranceAttempt]) -> list[str]:
    """Return the tasks, in order."""
    return list(dict.fromkeys(a.episode.task for a in attempts))


def grades_of(attempts: Sequence[ToleranceAttempt], error: PoseError) -> list[ErrorGrade]:
    """Return the executed sizes of an error in increasing order, including 0; none if the error was not executed."""
    executed = {a.grade for a in attempts if a.grade.error is error}
    return sorted({EXACT, *executed}, key=lambda grade: grade.size) if executed else []


def rate(attempts: Sequence[ToleranceAttempt], grade: ErrorGrade, task: str | None = None) -> tuple[int, int]:
    """Count successes and attempts of a grade, of one task or of all."""
    chosen = [a for a in attempts if a.grade == grade and task in (None, a.episode.task)]
    return sum(a.success for a in chosen), len(chosen)


def table_lines(attempts: Sequence[ToleranceAttempt]) -> Iterator[str]:
    """Yield the lines of tables to print, one table per error."""
    for error in PoseError:
        tried = grades_of(attempts, error)
        if not tried:
            continue
        factor, unit = (1.0, "frames") if error is PoseError.FINGERS else (1000.0, "mm")
        yield f"success under {error.value.replace('_', ' ')}"
        yield f"{'':20}" + "".join(f"{f'{grade.size * factor:g} {unit}':>11}" for grade in tried)
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
