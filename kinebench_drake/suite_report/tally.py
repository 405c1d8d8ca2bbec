"""A group of episodes in numbers: how many were measured, how many succeeded, why the others did not."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from kinebench_drake.aggregate import Estimate, estimate
from kinebench_drake.row import Status
from kinebench_drake.suite_report.balance import balanced, tasks_counted
from kinebench_drake.suite_report.episode import Episode, group

VERDICTS = ("grounding", "generation", "execution", "task")
"""Causes of failure, in the order in which they act (see docs/formats.md)."""
NO_VERDICT = "no verdict"
"""A failure whose cause was not told."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tally:
    """What became of a group of episodes."""

    episodes: int
    """All of them."""
    tasks: int
    """Tasks among those measured."""
    measured: int
    """Those that ended as a success or as a failure."""
    unmeasurable: int
    """Rows with that status, or without a word on success: neither success nor failure."""
    errors: int
    """Rows with status error."""
    pooled: Estimate
    """Share of successes among the measured, with Wilson's interval."""
    counted: Estimate
    """The same among all, what was not measured counted as a failure."""
    success: Estimate
    """The same as mean over tasks, with a bootstrap interval."""
    progress: Estimate
    """Mean over tasks of progress, 0..1."""
    rounds: Estimate
    """Mean over tasks of the clips asked for."""
    sparc: Estimate
    """Mean over tasks of SPARC."""
    cost: Estimate
    """Mean over tasks of the scaled manipulability cost, 0..1."""
    verdicts: Mapping[str, int]
    """Measured failures of each verdict; those without one under NO_VERDICT."""


def tally(episodes: Sequence[Episode], seed: int = 0) -> Tally:
    """Put a group of episodes into numbers; every task counts the same in the means. The same ones give the same."""
    outcomes = [e.success for e in episodes]
    measured = [o for o in outcomes if o is not None]
    errors = sum(e.row.status is Status.ERROR for e in episodes)
    failures = Counter(e.verdict or NO_VERDICT for e in episodes if e.success is False)
    named = {name: failures.pop(name, 0) for name in VERDICTS}
    return Tally(
        episodes=len(episodes),
        tasks=tasks_counted(by_task(episodes, lambda e: e.hit)),
        measured=len(measured),
        errors=errors,
        unmeasurable=len(episodes) - len(measured) - errors,
        pooled=estimate(measured, total=len(episodes)),
        counted=estimate([o is True for o in outcomes], total=len(episodes)),
        success=mean(episodes, lambda e: e.hit, seed),
        progress=mean(episodes, lambda e: e.progress, seed),
        rounds=mean(episodes, lambda e: e.rounds, seed),
        sparc=mean(episodes, lambda e: e.metric("sparc"), seed),
        cost=mean(episodes, lambda e: e.cost_scaled, seed),
        verdicts={**named, NO_VERDICT: sum(failures.values())},
    )


def by_task(episodes: Sequence[Episode], value: Callable[[Episode], float | None]) -> dict[str, list[float | None]]:
    """Values of the episodes of each task."""
    return {task: [value(e) for e in own] for task, own in group(episodes, lambda e: e.task).items()}


def mean(episodes: Sequence[Episode], value: Callable[[Episode], float | None], seed: int = 0) -> Estimate:
    """Mean in which every task counts the same."""
    return balanced(by_task(episodes, value), seed=seed)
