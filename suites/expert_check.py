"""Success rates of scripted policies: the expert, a still robot, random motion."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial

import numpy as np

from kinebench_drake.executors.base import Executor, WorkerCrash
from kinebench_drake.stats import wilson
from kinebench_drake.suites.clock import CLIP_FRAMES, STEPS_PER_FRAME
from kinebench_drake.suites.composition import Episode
from kinebench_drake.suites.families.registry import find_expert
from kinebench_drake.suites.rollout import run_expert
from kinebench_drake.suites.seeding import generator
from kinebench_drake.suites.simulator import Simulator, TaskOutcome
from kinebench_drake.suites.simulator_cache import SimulatorCache, SimulatorWorker, failure_reason

RANDOM_STEP_RAD = 0.1
"""Largest step of each joint of the random policy per control step."""


class Policy(Enum):
    """Scripted policies."""

    EXPERT = "expert"
    STILL = "still"
    RANDOM = "random"


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpertTrial:
    """Outcome of a policy in one episode."""

    episode: Episode
    policy: Policy
    success: bool = False
    progress: float = 0.0
    """Progress, 0..1."""
    reason: str
    """Failed conditions, or why the expert found no path; empty on success."""
    frames: int
    """Number of frames, including the first."""


def _run_trial(simulator: Simulator, episode: Episode, policy: Policy) -> ExpertTrial:
    trial = partial(ExpertTrial, episode=episode, policy=policy)
    try:
        if policy is Policy.EXPERT:
            rollout = run_expert(simulator, find_expert(episode.task), episode)
            outcome = rollout.outcome
            frames = len(rollout.snapshots)
        else:
            outcome, frames = _run_open_loop(simulator, episode, policy)
    except Exception as error:
        return trial(reason=failure_reason(error), frames=1)
    return trial(success=outcome.success, progress=outcome.progress, reason=outcome.reason, frames=frames)


def _run_open_loop(simulator: Simulator, episode: Episode, policy: Policy) -> tuple[TaskOutcome, int]:
    """Run a policy without feedback for at most the steps of the expert; return outcome and number of frames."""
    simulator.reset(episode)
    start = simulator.snapshot()
    q = start.q.copy()
    width = start.finger_width_m
    rng = generator("random policy", episode.task, episode.seed)
    frames = 1
    for _ in range(simulator.task.card.clips * CLIP_FRAMES):
        for _ in range(STEPS_PER_FRAME):
            if policy is Policy.RANDOM:
                q = np.clip(q + rng.uniform(-RANDOM_STEP_RAD, RANDOM_STEP_RAD, 7), *simulator.joint_limits)
                width = float(rng.uniform(-0.02, 0.08))
            simulator.step(q, width)
        frames += 1
        if (outcome := simulator.outcome()).success:
            return outcome, frames
    return outcome, frames


def run_trials(executor: Executor, episodes: Sequence[Episode], policy: Policy) -> Iterator[ExpertTrial]:
    """Run every episode once and yield the trials in any order; a worker crash is a failed trial."""
    make_worker = partial(SimulatorWorker, partial(_run_trial, policy=policy), SimulatorCache(Simulator, renders=False))
    for done in executor.run(make_worker, list(episodes)):
        if isinstance(done, WorkerCrash):
            yield ExpertTrial(episode=done.item, policy=policy, reason=done.reason, frames=0)
        else:
            yield done.result


def task_lines(trials: Sequence[ExpertTrial]) -> list[str]:
    """Return lines to print for the trials of one task: success rate, and each failure of the expert."""
    good = sum(t.success for t in trials)
    progress = sum(t.progress for t in trials) / len(trials)
    low, high = wilson(good, len(trials))
    rate = f"{good:4}/{len(trials)}  {low:6.1%} to {high:6.1%}"
    frames = max(t.frames for t in trials)
    failures = [t for t in trials if not t.success and t.policy is Policy.EXPERT]
    return [
        f"{trials[0].episode.task:20} {rate}  progress {progress:.2f}  {frames} frames",
        *(f"    seed {t.episode.seed}: {t.reason} (progress {t.progress:.2f})" for t in failures),
    ]
