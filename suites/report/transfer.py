"""Loss of success from seen to unseen looks (suite 2) and tasks (suite 1), task by task."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.report.figures import ReportFigure, assign_numbers, draw_intervals, make_figure
from kinebench_drake.report.number import ALL_TASKS, share_difference
from kinebench_drake.report.table import Table, Value, make_table
from kinebench_drake.results.aggregate import Estimate, group_by
from kinebench_drake.stats import PairedShares, adjust_p_values, independent_mean_difference
from kinebench_drake.suites.report.episode_result import EpisodeResult

SEEN = "seen"
UNSEEN = "unseen"
"""Splits that are compared."""
Samples = Sequence[EpisodeResult]
"""All samples of one episode."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenUnseenDrop:
    """Success of one model on seen and unseen episodes of one task, or of all."""

    suite: int
    model: str
    task: str
    """Unseen task, or ALL_TASKS."""
    seen_tasks: tuple[str, ...]
    """Tasks of the seen episodes."""
    paired: bool
    """True if each unseen episode is compared with the seen one of its task and seed."""
    rates: tuple[Estimate, Estimate]
    """Success on seen and on unseen episodes, over those of `drop`."""
    drop: Estimate
    """Seen minus unseen over the episodes that are measured, of paired ones both. Bound: over all episodes, if each
    seen one without an outcome had succeeded and each unseen one had failed."""
    p: float | None
    """Two-sided p-value of paired episodes, see `PairedShares`; None of others."""
    adjusted_p: float | None = None
    """p of a task, adjusted as Benjamini and Hochberg (1995) over the tasks of the model on the suite."""


def study_drops(episodes: Sequence[EpisodeResult], transfers: Mapping[str, Sequence[str]]) -> list[SeenUnseenDrop]:
    """Compare seen with unseen episodes of every model on every suite that has both splits.

    Episodes of a task in both splits are paired by seed: the same layout with other assets and looks. An unseen task
    that has no seen episodes is compared with those of the tasks it derives from; these are not paired.

    Args:
        episodes: episodes of all runs.
        transfers: trained tasks that each unseen task derives from.
    """
    drops: list[SeenUnseenDrop] = []
    for (model, suite, _), own in group_by(episodes, lambda e: (e.model, e.part.suite, e.part.variant)).items():
        trained, others = (_by_task(e for e in own if e.part.split == split) for split in (SEEN, UNSEEN))
        pairs = {
            task: [(trained[task][k], others[task][k]) for k in trained[task] if k in others[task]]
            for task in sorted({*trained} & {*others})
        }
        by_task = [_paired(suite, model, task, some) for task, some in pairs.items() if some]
        if by_task:
            every = [pair for some in pairs.values() for pair in some]
            adjusted = adjust_p_values({d.task: d.p for d in by_task if d.p is not None})
            drops.append(_paired(suite, model, ALL_TASKS, every))
            drops += [replace(d, adjusted_p=adjusted.get(d.task)) for d in by_task]
        for task in sorted({*others} - {*trained}):
            origins = [own for name in transfers.get(task, ()) for own in trained.get(name, {}).values()]
            if origins:
                drops.append(_independent(suite, model, task, origins, [*others[task].values()]))
    return sorted(drops, key=lambda d: d.suite)


def _by_task(episodes: Iterable[EpisodeResult]) -> dict[str, dict[object, list[EpisodeResult]]]:
    """Group the samples of episodes by task and seed."""
    tasks = group_by(episodes, lambda e: e.task)
    return {task: group_by(own, lambda e: str(e.row.seed)) for task, own in tasks.items()}


def _rate(samples: Samples, missing: float | None = None) -> float:
    """Return the share of successes among an episode's samples, unmeasured ones left out or counted as `missing`."""
    outcomes = [missing if e.hit is None else e.hit for e in samples]
    measured = [outcome for outcome in outcomes if outcome is not None]
    return float(np.mean(measured)) if measured else float("nan")


def _paired(suite: int, model: str, task: str, pairs: Sequence[tuple[Samples, Samples]]) -> SeenUnseenDrop:
    """Compare the seen with the unseen episode of each pair."""
    rates = np.array([[_rate(samples) for samples in pair] for pair in pairs], dtype=np.float64)
    complete = rates[np.isfinite(rates).all(axis=1)]
    bound = float(np.mean([_rate(one, 1.0) - _rate(other, 0.0) for one, other in pairs]))
    drop = Estimate(mean=None, low=None, high=None, n=0, total=len(pairs))
    p = None
    if len(complete):
        samples = max(len(own) for pair in pairs for own in pair)
        shares = PairedShares(first=complete[:, 0], second=complete[:, 1], samples=samples)
        drop = share_difference(shares, len(pairs))
        p = shares.p_value
    return SeenUnseenDrop(
        suite=suite,
        model=model,
        task=task,
        seen_tasks=tuple(dict.fromkeys(one[0].task for one, _ in pairs)),
        paired=True,
        rates=(_mean(complete[:, 0]), _mean(complete[:, 1])),
        drop=replace(drop, bound=bound),
        p=p,
    )


def _independent(
    suite: int, model: str, task: str, origins: Sequence[Samples], derived: Sequence[Samples]
) -> SeenUnseenDrop:
    """Compare the episodes of trained tasks with those of the unseen task that derives from them."""
    rates = [np.array([_rate(samples) for samples in own], dtype=np.float64) for own in (origins, derived)]
    first, second = (own[np.isfinite(own)] for own in rates)
    drop = Estimate(mean=None, low=None, high=None, n=len(first) + len(second), total=len(origins) + len(derived))
    if len(first) and len(second):
        value = independent_mean_difference(first, second, np.random.default_rng(0))
        low, high = (value.low, value.high) if np.isfinite([value.low, value.high]).all() else (None, None)
        drop = replace(drop, mean=value.value, low=low, high=high)
    bound = np.mean([_rate(samples, 1.0) for samples in origins]) - np.mean(
        [_rate(samples, 0.0) for samples in derived]
    )
    return SeenUnseenDrop(
        suite=suite,
        model=model,
        task=task,
        seen_tasks=tuple(dict.fromkeys(samples[0].task for samples in origins)),
        paired=False,
        rates=(_mean(first), _mean(second)),
        drop=replace(drop, bound=float(bound)),
        p=None,
    )


def _mean(values: Array) -> Estimate:
    return Estimate(
        mean=float(values.mean()) if len(values) else None, low=None, high=None, n=len(values), total=len(values)
    )


def tabulate_drops(drops: Sequence[SeenUnseenDrop]) -> Table:
    """Build the table of drops, one per row."""
    whole = ((i, "drop") for i, d in enumerate(drops) if d.task == ALL_TASKS)
    return make_table("seen_unseen", map(_row, drops), bold=whole)


def _row(d: SeenUnseenDrop) -> dict[str, Value]:
    same = d.seen_tasks == (d.task,) or d.task == ALL_TASKS
    return {
        **{"suite": f"Suite {d.suite}", "model": d.model, "task": d.task},
        **{"seen_tasks": "the same" if same else ", ".join(d.seen_tasks)},
        **{"success_seen": d.rates[0].mean, "success_unseen": d.rates[1].mean, "drop": d.drop},
        **{"p": d.p, "p_adjusted": d.adjusted_p, "comparison": "pairs of one seed" if d.paired else "independent"},
        **{"measured": d.drop.n, "episodes": d.drop.total},
    }


def draw_drops(drops: Sequence[SeenUnseenDrop]) -> list[ReportFigure]:
    """Draw the drops by task and model, a figure for each suite."""
    models = list(dict.fromkeys(d.model for d in drops))
    figures = []
    for suite, own in group_by(drops, lambda d: d.suite).items():
        tasks = sorted({d.task for d in own}, key=lambda task: (task != ALL_TASKS, task), reverse=True)
        values = {m: [(d.task, d.drop) for d in own if d.model == m] for m in models if any(d.model == m for d in own)}
        numbers = assign_numbers(models, [*values])
        figure = draw_intervals(tasks, values, numbers, "drop of success, seen minus unseen", low=-1.0)
        figures.append(make_figure("seen_unseen", figure, suite=suite))
    return figures
