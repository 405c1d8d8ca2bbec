"""Loss of success from seen to unseen looks (suite 2) and tasks (suite 1), task by task."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.io.figure import FAINT, new_figure, plain, shorten
from kinebench_drake.report.figures import ReportFigure, add_legend, assign_numbers, draw_interval, label_shares, style
from kinebench_drake.report.number import ALL_TASKS, share_difference
from kinebench_drake.report.suite.episode import EpisodeResult, SuitePart, group_by, list_models
from kinebench_drake.report.table import Column, Table, Value, plain_columns
from kinebench_drake.results.aggregate import Estimate
from kinebench_drake.stats import PairedShares, adjust_p_values, independent_mean_difference

SEEN, UNSEEN = "seen", "unseen"
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


def study_drops(
    episodes: Sequence[EpisodeResult], transfers: Mapping[str, Sequence[str]], seed: int = 0
) -> list[SeenUnseenDrop]:
    """Compare seen with unseen episodes of every model on every suite that has both splits.

    Episodes of a task in both splits are paired by seed: the same layout with other assets and looks. An unseen task
    that has no seen episodes is compared with those of the tasks it derives from; these are not paired.

    Args:
        episodes: episodes of all runs.
        transfers: trained tasks that each unseen task derives from.
        seed: seed of the resampling.
    """
    drops: list[SeenUnseenDrop] = []
    for (model, suite, _), own in group_by(episodes, lambda e: (e.model, e.part.suite, e.part.variant)).items():
        trained, others = (_by_task(e for e in own if e.part.split == split) for split in (SEEN, UNSEEN))
        pairs = {
            task: [(trained[task][k], others[task][k]) for k in trained[task] if k in others[task]]
            for task in sorted({*trained} & {*others})
        }
        by_task = [_paired(suite, model, task, some, seed) for task, some in pairs.items() if some]
        if by_task:
            every = [pair for some in pairs.values() for pair in some]
            drops += [_paired(suite, model, ALL_TASKS, every, seed), *_adjust(by_task)]
        for task in sorted({*others} - {*trained}):
            names = tuple(name for name in transfers.get(task, ()) if name in trained)
            some = [samples for name in names for samples in trained[name].values()]
            if some:
                drops.append(_independent(suite, model, task, names, (some, [*others[task].values()]), seed))
    return sorted(drops, key=lambda d: d.suite)


def _by_task(episodes: Iterable[EpisodeResult]) -> dict[str, dict[object, list[EpisodeResult]]]:
    """Group the samples of episodes by task and seed."""
    tasks = group_by(episodes, lambda e: e.task)
    return {task: group_by(own, lambda e: str(e.row.extra.get("seed"))) for task, own in tasks.items()}


def _rate(samples: Samples, missing: float | None = None) -> float:
    """Return the share of successes among an episode's samples, unmeasured ones left out or counted as `missing`."""
    outcomes = [missing if e.hit is None else e.hit for e in samples]
    measured = [outcome for outcome in outcomes if outcome is not None]
    return float(np.mean(measured)) if measured else float("nan")


def _paired(suite: int, model: str, task: str, pairs: Sequence[tuple[Samples, Samples]], seed: int) -> SeenUnseenDrop:
    rates = np.array([[_rate(samples) for samples in pair] for pair in pairs], dtype=np.float64)
    complete = rates[np.isfinite(rates).all(axis=1)]
    bound = float(np.mean([_rate(one, 1.0) - _rate(other, 0.0) for one, other in pairs]))
    drop, p = Estimate(mean=None, low=None, high=None, n=0, total=len(pairs)), None
    if len(complete):
        samples = max(len(own) for pair in pairs for own in pair)
        shares = PairedShares(first=complete[:, 0], second=complete[:, 1], samples=samples, seed=seed)
        drop, p = share_difference(shares, len(pairs)), shares.p_value
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
    suite: int,
    model: str,
    task: str,
    seen_tasks: tuple[str, ...],
    groups: tuple[Sequence[Samples], Sequence[Samples]],
    seed: int,
) -> SeenUnseenDrop:
    """Compare the seen with the unseen episodes of `groups`."""
    rates = [np.array([_rate(samples) for samples in own], dtype=np.float64) for own in groups]
    first, second = (own[np.isfinite(own)] for own in rates)
    n, total = len(first) + len(second), sum(map(len, groups))
    drop = Estimate(mean=None, low=None, high=None, n=n, total=total)
    if len(first) and len(second):
        value = independent_mean_difference(first, second, np.random.default_rng(seed))
        drop = _estimate(value.value, value.low, value.high, n, total)
    best, worst = (np.mean([_rate(s, v) for s in own]) for own, v in zip(groups, (1.0, 0.0), strict=True))
    return SeenUnseenDrop(
        suite=suite,
        model=model,
        task=task,
        seen_tasks=seen_tasks,
        paired=False,
        rates=(_mean(first), _mean(second)),
        drop=replace(drop, bound=float(best - worst)),
        p=None,
    )


def _estimate(value: float, low: float, high: float, n: int, total: int) -> Estimate:
    ends = (low, high) if np.isfinite([low, high]).all() else (None, None)
    return Estimate(mean=value, low=ends[0], high=ends[1], n=n, total=total)


def _mean(values: Array) -> Estimate:
    mean = float(values.mean()) if len(values) else None
    return Estimate(mean=mean, low=None, high=None, n=len(values), total=len(values))


def _adjust(drops: Sequence[SeenUnseenDrop]) -> list[SeenUnseenDrop]:
    by_task = adjust_p_values({d.task: d.p for d in drops if d.p is not None})
    return [replace(d, adjusted_p=by_task.get(d.task)) for d in drops]


def tabulate_drops(drops: Sequence[SeenUnseenDrop]) -> Table:
    """Build the table of drops, one per row."""
    return Table(
        name="seen_unseen",
        title="Drop of success from seen to unseen, task by task",
        note="Seen minus unseen: positive is a loss. Suite 2 pairs the episodes of one task and seed, the same layout "
        "with other assets and looks: over the pairs measured on both sides, 95 % intervals by Newcombe's method 10, p "
        "of McNemar's exact test (of several samples an episode: paired bootstrap over episodes, randomization of the "
        "signs of the differences), adjusted p by Benjamini and Hochberg over the tasks of a model. Suite 1 compares "
        "an unseen task with the trained tasks it derives from; these episodes are not paired, with Newcombe's "
        "interval of independent shares. All tasks: every pair counts the same. Below a drop over incomplete data: the "
        "greatest drop that the other episodes allow.",
        columns=(
            *plain_columns(suite="Suite", model="Model", task="Unseen task", seen_tasks="Seen task"),
            Column(key="success_seen", label="Success, seen", pattern="{:.1%}"),
            Column(key="success_unseen", label="Success, unseen", pattern="{:.1%}"),
            Column(key="drop", label="Drop", pattern="{:+.1%}", estimated=True),
            Column(key="p", label="p", pattern="{:.3g}"),
            Column(key="p_adjusted", label="Adjusted p", pattern="{:.3g}"),
            *plain_columns(comparison="Comparison", measured="Measured", episodes="All"),
        ),
        rows=tuple(_row(d) for d in drops),
        bold=frozenset((i, 6) for i, d in enumerate(drops) if d.task == ALL_TASKS),
    )


def _row(d: SeenUnseenDrop) -> tuple[Value, ...]:
    same = d.seen_tasks == (d.task,) or d.task == ALL_TASKS
    return (
        *(f"Suite {d.suite}", d.model, d.task, "the same" if same else ", ".join(d.seen_tasks)),
        *(rate.mean for rate in d.rates),
        d.drop,
        *(d.p, d.adjusted_p, "pairs of one seed" if d.paired else "independent", d.drop.n, d.drop.total),
    )


def draw_drops(drops: Sequence[SeenUnseenDrop]) -> list[ReportFigure]:
    """Draw the drops by task and model, a figure for each suite."""
    models = list(dict.fromkeys(d.model for d in drops))
    figures = []
    for suite, own in group_by(drops, lambda d: d.suite).items():
        tasks = sorted({d.task for d in own}, key=lambda task: (task != ALL_TASKS, task), reverse=True)
        here = [m for m in models if any(d.model == m for d in own)]
        figure, axes = new_figure(7.2, 1.3 + len(tasks) * max(0.3, 0.1 + 0.1 * len(here)))
        ax, numbers = axes[0, 0], assign_numbers(models, here)
        for k, model in enumerate(here):
            colour, marker = style(numbers[model])
            offset = 0.62 * (0.5 - (k + 0.5) / len(here))
            for d in own:
                if d.model == model:
                    draw_interval(ax, d.drop, tasks.index(d.task) + offset, colour, marker)
            ax.plot([], [], color=colour, marker=marker, markersize=4, linewidth=1.2, label=plain(shorten(model)))
        ax.axvline(0.0, color=FAINT, linewidth=1.2, zorder=1)
        label_shares(ax, tasks, "drop of success, seen minus unseen", low=-1.0)
        add_legend(figure, here)
        figures.append(
            ReportFigure(
                name=f"seen_unseen_suite{suite}",
                title=f"Suite {suite}: drop of success from seen to unseen",
                caption="Right of the line: less success on unseen episodes; 95 % intervals, see the table.",
                figure=figure,
            )
        )
    return figures


def missing_splits(episodes: Sequence[EpisodeResult]) -> list[tuple[str, SuitePart]]:
    """List the parts that lack for a drop: of suites 1 and 2, the other split of each run with one of both."""
    parts = {model: {e.part for e in own} for model, own in group_by(episodes, lambda e: e.model).items()}
    other = {SEEN: UNSEEN, UNSEEN: SEEN}
    return [
        (model, wanted)
        for model in list_models(episodes)
        for part in sorted(parts[model])
        if part.suite in (1, 2) and part.split in other
        for wanted in [replace(part, split=other[part.split])]
        if wanted not in parts[model]
    ]
