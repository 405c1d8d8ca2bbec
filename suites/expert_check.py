"""Success rates of the experts."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from kinebench_drake.executors.base import Executor, WorkerCrash
from kinebench_drake.stats import wilson
from kinebench_drake.suites.composition import Episode
from kinebench_drake.suites.families.registry import find_expert
from kinebench_drake.suites.rollout import run_expert
from kinebench_drake.suites.simulator import Simulator
from kinebench_drake.suites.simulator_cache import SimulatorCache, SimulatorWorker, failure_reason


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpertTrial:
    """Outcome of an expert in one episode."""

    episode: Episode
    success: bool = False
    progress: float = 0.0
    """Progress, 0..1."""
    reason: str
    """Failed conditions, or why the expert found no path; empty on success."""
    frames: int
    """Number of frames, including the first."""


def _run_trial(simulator: Simulator, episode: Episode) -> ExpertTrial:
    try:
        rollout = run_expert(simulator, find_expert(episode.task), episode)
    except Exception as error:
        return ExpertTrial(episode=episode, reason=failure_reason(error), frames=1)
    outcome = rollout.outcome
    return ExpertTrial(
        episode=episode,
        success=outcome.success,
        progress=outcome.progress,
        reason=outcome.reason,
        frames=len(rollout.snapshots),
    )


def run_trials(executor: Executor, episodes: Sequence[Episode]) -> Iterator[ExpertTrial]:
    """Run every episode once and yield the trials in any order; a worker crash is a failed trial."""
    make_worker = partial(SimulatorWorker, _run_trial, SimulatorCache(Simulator, renders=False))
    for done in executor.run(make_worker, list(episodes)):
        if isinstance(done, WorkerCrash):
            yield ExpertTrial(episode=done.item, reason=done.reason, frames=0)
        else:
            yield done.result


def task_lines(trials: Sequence[ExpertTrial]) -> list[str]:
    """Return lines to print for the trials of one task: success rate, and each failure."""
    good = sum(t.success for t in trials)
    progress = sum(t.progress for t in trials) / len(trials)
    low, high = wilson(good, len(trials))
    rate = f"{good:4}/{len(trials)}  {low:6.1%} to {high:6.1%}"
    frames = max(t.frames for t in trials)
    failures = [t for t in trials if not t.success]
    return [
        f"{trials[0].episode.task:20} {rate}  progress {progress:.2f}  {frames} frames",
        *(f"    seed {t.episode.seed}: {t.reason} (progress {t.progress:.2f})" for t in failures),
    ]
