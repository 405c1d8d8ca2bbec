"""Success of the expert's true track with planted errors of graded size, task by task: what an error costs."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial
from math import ceil
from pathlib import Path

import numpy as np

from benchmarks.trials import run_all
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.geometry import Array, make_pose, rotation_exp
from kinebench_drake.io.figure import new_figure, save
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.suites.clock import CLIP_FRAMES, FRAME_PERIOD_S, Control
from kinebench_drake.suites.closed_loop.execution import CommandPlanner, RobotState, execute
from kinebench_drake.suites.composition import Episode
from kinebench_drake.suites.families.registry import find_expert
from kinebench_drake.suites.rollout import Rollout, run_expert
from kinebench_drake.suites.seeding import generator
from kinebench_drake.suites.simulator import Simulator
from kinebench_drake.suites.simulator_cache import SimulatorCache, SimulatorWorker

ROTATION_RAD_PER_M = np.deg2rad(5.0) / 0.015
"""Ratio of rotation errors to position errors: 5 degrees with 15 mm [rad/m]."""
_COLUMNS = 5


class PoseError(Enum):
    """Errors of a track."""

    BIAS = "bias"
    """Constant displacement of all poses, in a random direction for each episode [m]."""
    JITTER = "jitter"
    """Independent displacement of each pose, by its root mean square [m]."""
    FINGERS = "finger_delay"
    """Delay of the fingers [frames]; negative: they are early."""


SIZES: dict[PoseError, tuple[float, ...]] = {
    PoseError.BIAS: (0.0, 0.005, 0.01, 0.015, 0.02, 0.025, 0.03),
    PoseError.JITTER: (0.0, 0.005, 0.01, 0.015, 0.02, 0.025, 0.03),
    PoseError.FINGERS: (-8.0, -4.0, -2.0, 0.0, 2.0, 4.0, 8.0),
}
"""Sizes of each error; 0: the exact track."""
_STYLES = {
    PoseError.BIAS: {"color": "#1f6fb2", "marker": "o", "label": "bias [mm]"},
    PoseError.JITTER: {"color": "#c4622d", "marker": "s", "label": "jitter [mm]"},
    PoseError.FINGERS: {"color": "#8a5fb0", "marker": "^", "label": "finger delay [frames, above]"},
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt:
    """Execution of a track with an error of one size."""

    task: str
    error: PoseError
    size: float
    success: bool


def plant_error(
    X_BG: Array, finger_width_m: Array, error: PoseError, size: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return poses (T, 4, 4) [m] and gaps (T,) [m] of a track with an error; rotations are drawn as positions."""
    if error is PoseError.FINGERS:
        frames = np.clip(np.arange(len(X_BG)) - int(size), 0, len(X_BG) - 1)
        return X_BG, finger_width_m[frames]
    if error is PoseError.BIAS:
        directions = (rng.normal(size=3) for _ in range(2))
        p, w = (size * np.asarray(v / np.linalg.norm(v)) for v in directions)
    else:
        p, w = rng.normal(0.0, size / np.sqrt(3.0), (2, len(X_BG), 3))
    return make_pose(X_BG[:, :3, :3] @ rotation_exp(ROTATION_RAD_PER_M * w), X_BG[:, :3, 3] + p), finger_width_m


def measure_tolerance(episodes: Sequence[Episode], jobs: int) -> Iterator[Attempt]:
    """Execute the expert's track in each episode with every error in every size.

    Raises:
        KinebenchError: a worker died.
    """
    make_worker = partial(SimulatorWorker, _attempt_all, SimulatorCache(Simulator, renders=False))
    for attempts in run_all(make_worker, episodes, jobs):
        yield from attempts


def _attempt_all(simulator: Simulator, episode: Episode) -> list[Attempt]:
    rollout = run_expert(simulator, find_expert(episode.task), episode)
    planner = CommandPlanner(ArmPlant())
    exact = _succeeds(simulator, planner, rollout, PoseError.FINGERS, 0.0)
    return [
        Attempt(
            task=episode.task,
            error=error,
            size=size,
            success=_succeeds(simulator, planner, rollout, error, size) if size else exact,
        )
        for error, sizes in SIZES.items()
        for size in sizes
    ]


def _succeeds(simulator: Simulator, planner: CommandPlanner, rollout: Rollout, error: PoseError, size: float) -> bool:
    """Execute the track of a rollout with an error, clip by clip; return whether the task succeeds."""
    episode = rollout.episode
    X_BG = planner.plant.forward_path([s.q for s in rollout.snapshots])
    width = np.array([s.finger_width_m for s in rollout.snapshots])
    X_BG, width = plant_error(X_BG, width, error, size, generator("tolerance", episode.id, error.value))
    simulator.reset(episode)
    state = RobotState.of(simulator.snapshot())
    for start in range(0, len(X_BG) - 1, CLIP_FRAMES):
        clip = slice(start, start + CLIP_FRAMES + 1)
        frames = len(X_BG[clip])
        t_s = FRAME_PERIOD_S * np.arange(frames, dtype=np.float64)
        try:
            commands = planner.plan(X_BG[clip], width[clip], np.ones(frames, dtype=bool), t_s, state)
        except UnmeasurableError:  # nothing to execute
            return False
        execution = execute(simulator, commands, Control.JOINTS)
        if execution.outcome.success:
            return True
        state = RobotState.of(execution.snapshots[-1], gripping=commands.gripping)
    return simulator.outcome().success


def success_share(attempts: Sequence[Attempt], error: PoseError, size: float) -> float:
    """Return the share of successes with an error of one size."""
    return float(np.mean([a.success for a in attempts if (a.error, a.size) == (error, size)]))


def draw_tolerance(attempts: Sequence[Attempt], out: Path) -> None:
    """Draw success against error for all tasks and each task: bias and jitter [mm] below, delay [frames] above."""
    tasks = sorted({attempt.task for attempt in attempts})
    rows = ceil((len(tasks) + 1) / _COLUMNS)
    figure, axes = new_figure(2.7 * _COLUMNS, 2.2 * rows, rows, _COLUMNS, sharey=True)
    lines = {}
    for ax, task in zip(axes.flat, ["", *tasks], strict=False):
        own = [attempt for attempt in attempts if task in ("", attempt.task)]
        ax.set_title(task or "all tasks", fontsize=9, fontweight="normal" if task else "bold")
        ax.set_ylim(-0.04, 1.04)
        ax.tick_params(labelsize=7)
        for error, style in _STYLES.items():
            delay = error is PoseError.FINGERS
            where = ax.twiny() if delay else ax
            if delay:
                where.tick_params(labelsize=6, colors=style["color"], pad=0)
            x = [size * (1.0 if delay else 1000.0) for size in SIZES[error]]
            shares = [success_share(own, error, size) for size in SIZES[error]]
            [lines[error]] = where.plot(x, shares, markersize=3, linewidth=1.2, **style)
    for ax in axes.flat[len(tasks) + 1 :]:
        ax.axis("off")
    for ax in axes[:, 0]:
        ax.set_ylabel("success", fontsize=8)
    figure.supxlabel("error of the position [mm], the rotation's with it", fontsize=9)
    figure.legend(handles=list(lines.values()), loc="outside upper center", ncols=3, fontsize=8, frameon=False)
    save(figure, out)
