"""How often a policy does a task: the expert, one that does nothing, one that moves at random."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.executors.base import Executor, WorkerCrash
from kinebench_drake.stats import wilson
from kinebench_drake.suites.clock import CLIP_FRAMES, STEPS_PER_FRAME
from kinebench_drake.suites.episode import Episode
from kinebench_drake.suites.experts.registry import find_expert
from kinebench_drake.suites.rollout import rollout
from kinebench_drake.suites.seeding import generator
from kinebench_drake.suites.simulator import Simulator, TaskOutcome
from kinebench_drake.suites.simulator_cache import SimulatorCache, failure

RANDOM_STEP_RAD = 0.1
"""The random policy moves each joint by up to this much a control step."""


class Policy(Enum):
    """Who moves the robot."""

    EXPERT = "expert"
    STILL = "still"
    RANDOM = "random"


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpertTrial:
    """One episode and how it ended."""

    episode: Episode
    policy: Policy
    success: bool
    progress: float
    """0..1."""
    reason: str
    """Which conditions failed, or why the expert found no way; empty with success."""
    frames: int
    """Frames that passed, the first included."""


class _TrialWorker:
    """Runs trials."""

    def __init__(self, policy: Policy) -> None:
        self._policy = policy
        self._hand = SimulatorCache(Simulator, benchmark_camera().width, renders=False)

    def __call__(self, episode: Episode) -> ExpertTrial:
        stage, frames = self._hand.stage(episode.task, episode.variant), 1
        try:
            if self._policy is Policy.EXPERT:
                performance = rollout(stage, find_expert(episode.task), episode)
                outcome, frames = performance.outcome, len(performance.snapshots)
            else:
                outcome, frames = _blind(stage, episode, self._policy)
        except Exception as error:
            return self._trial(episode, TaskOutcome(success=False, progress=0.0, conditions={}), frames, failure(error))
        return self._trial(episode, outcome, frames, outcome.reason)

    def _trial(self, episode: Episode, outcome: TaskOutcome, frames: int, reason: str) -> ExpertTrial:
        return ExpertTrial(
            episode=episode,
            policy=self._policy,
            success=outcome.success,
            progress=outcome.progress,
            reason=reason,
            frames=frames,
        )


def _blind(stage: Simulator, episode: Episode, policy: Policy) -> tuple[TaskOutcome, int]:
    """What comes of a policy that does not look, after as many steps as the expert may take; frames that passed."""
    stage.reset(episode)
    start = stage.snapshot()
    q, width = start.q.copy(), float(start.fingers_m.sum())
    rng = generator("random policy", episode.task, episode.seed)
    frames = 1
    for _ in range(stage.task.card.clips * CLIP_FRAMES):
        for _ in range(STEPS_PER_FRAME):
            if policy is Policy.RANDOM:
                q = np.clip(q + rng.uniform(-RANDOM_STEP_RAD, RANDOM_STEP_RAD, 7), *stage.joint_limits)
                width = float(rng.uniform(-0.02, 0.08))
            stage.step(q, width)
        frames += 1
        if (outcome := stage.outcome()).success:
            return outcome, frames
    return outcome, frames


def run_trials(engine: Executor, episodes: Sequence[Episode], policy: Policy) -> Iterator[ExpertTrial]:
    """Try every episode once; yields in any order. A worker that dies makes a failed trial."""
    for done in engine.run(_MakeTrials(policy), list(episodes)):
        if isinstance(done, WorkerCrash):
            yield ExpertTrial(
                episode=done.item, policy=policy, success=False, progress=0.0, reason=done.reason, frames=0
            )
        else:
            yield done.result


@dataclass(frozen=True, slots=True)
class _MakeTrials:
    """Makes a worker in each process."""

    policy: Policy

    def __call__(self) -> Callable[[Episode], ExpertTrial]:
        return _TrialWorker(self.policy)


def task_lines(trials: Sequence[ExpertTrial]) -> list[str]:
    """What came of the trials of one task, to print: the rate, and for the expert each failure."""
    good, progress = sum(t.success for t in trials), sum(t.progress for t in trials) / len(trials)
    low, high = wilson(good, len(trials))
    rate = f"{good:4}/{len(trials)}  {low:6.1%} to {high:6.1%}"
    frames = max(t.frames for t in trials)
    failures = [t for t in trials if not t.success and t.policy is Policy.EXPERT]
    return [
        f"{trials[0].episode.task:20} {rate}  progress {progress:.2f}  {frames} frames",
        *(f"    seed {t.episode.seed}: {t.reason} (progress {t.progress:.2f})" for t in failures),
    ]
