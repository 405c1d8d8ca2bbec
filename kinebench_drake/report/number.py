"""Headline numbers of two models, compared on the samples that both have: table, figure and text."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.io.figure import FAINT, new_figure, plain, shorten
from kinebench_drake.report.figures import COLOURS, ReportFigure, draw_interval, make_figure
from kinebench_drake.report.metric import BY_NAME, Metric
from kinebench_drake.report.table import Table, Value, format_interval, format_value, make_table, table_lines
from kinebench_drake.results.aggregate import VERDICT_SHARES, Estimate, estimate
from kinebench_drake.results.direction import LOWER_IS_BETTER
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.stats import CONFIDENCE, PairedShares, paired_mean_difference, share_interval, sign_test

ALL_TASKS = "all tasks"
SHARES = {
    name: Metric(name=name, label=label, pattern="{:.0%}", meaning=meaning)
    for name, label, meaning in (
        ("executable", "Executable", "share of samples that a robot can execute as they are seen"),
        ("feasible", "Feasible", "share of samples whose motion exceeds no limit"),
        ("trajopt_feasible", "Trajectory optimised", BY_NAME["trajopt_feasible"].meaning),
    )
}
"""Truth values; a missing one counts as false, of `executable` everywhere, of the others in the bound."""
_MEANS = (
    *("tracked_fraction", "ik_success_rate", "manipulability_mean", "manipulability_min", "manipulability_cost_mean"),
    *("joint_limit_margin_min", "sparc", "sparc_rotation", "ldlj", "slowdown_min", "velocity_ratio_max"),
    *("acceleration_ratio_max", "jerk_ratio_max", "torque_ratio_max", "self_distance_min_m", "table_distance_min_m"),
)
NUMBERS = {**SHARES, **{name: BY_NAME[name] for name in _MEANS}}
"""Numbers that are compared, in the order of the table."""
_BY_TASK = ("executable", "feasible", "manipulability_mean", "sparc")
"""Numbers that are compared task by task, too."""
_PRINTED = (
    *("number", "first_mean", "second_mean", "difference", "complete", "shared", "first_better"),
    *("second_better", "p"),
)
"""Keys of the columns printed to a terminal."""
_PANELS = 3
"""Panels beside each other in the figure."""
_MAX_LINES = 15
"""Pairs of models up to which the figure is drawn."""
_MAX_LETTERS = 28
"""Letters of a model's name that the figure has room for."""
RowPair = tuple[SampleRow, SampleRow]
RowsPair = tuple[Sequence[SampleRow], Sequence[SampleRow]]
"""Rows of the same episode by two models, one or several samples each."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NumberComparison:
    """One number of two models on their shared samples."""

    part: str
    """What the samples are of, such as a suite; empty if there is one kind only."""
    task: str
    """Task, or ALL_TASKS."""
    metric: Metric
    first: str
    second: str
    shared: int
    """Samples that both have a row of."""
    means: tuple[Estimate, Estimate]
    """Means or shares of both, over the samples complete in both."""
    difference: Estimate
    """First minus second, over the samples complete in both."""
    better: tuple[int, int]
    """Shared samples in which the first, and in which the second, is better; a missing value is worse than any."""
    bound: Estimate
    """First minus second over all shared samples: a missing value counts as the worst of either model."""

    @property
    def is_clear(self) -> bool:
        """True if the intervals of the difference and of its bound exclude 0 on the same side, and p confirms it.

        Of few samples the bootstrap interval is too narrow; the sign test is exact.
        """
        ends = [(e.low, e.high) for e in (self.difference, self.bound) if e.low is not None and e.high is not None]
        outside = len(ends) == 2 and (all(low > 0.0 for low, _ in ends) or all(high < 0.0 for _, high in ends))
        return outside and self.p_value < 1.0 - CONFIDENCE

    @property
    def p_value(self) -> float:
        """Two-sided p-value of the exact sign test of `better`."""
        return sign_test(*self.better)


def value_of(row: SampleRow, name: str) -> float | None:
    """Return a number of a row, truth values as 0 or 1; None if it was not measured."""
    value = getattr(row, name) if name in VERDICT_SHARES else row.metrics.get(name)
    if row.status is not Status.OK or not isinstance(value, bool | int | float) or not math.isfinite(value):
        return None
    return float(value)


def compare_numbers(
    pairs: Sequence[RowsPair], first: str, second: str, part: str = "", seed: int = 0
) -> list[NumberComparison]:
    """Compare every number that is measured in a shared sample: all tasks together, then a few task by task.

    Args:
        pairs: rows of the first and of the second model of the same samples; several rows of an episode are averaged.
        first: label of the first model.
        second: label of the second model.
        part: what the samples are of.
        seed: seed of the resampling.
    """
    tasks: dict[str, list[RowsPair]] = {}
    for pair in pairs:
        tasks.setdefault(pair[0][0].task or pair[1][0].task or "unnamed", []).append(pair)
    groups = [(ALL_TASKS, pairs, tuple(NUMBERS))]
    if len(tasks) > 1:
        groups += [(task, tasks[task], _BY_TASK) for task in sorted(tasks)]
    comparisons = []
    for task, own, names in groups:
        for name in names:
            if any(value_of(row, name) is not None for pair in pairs for rows in pair for row in rows):
                compared = _compare(NUMBERS[name], own, seed, part=part, task=task, first=first, second=second)
                comparisons.append(compared)
    return comparisons


def _compare(metric: Metric, pairs: Sequence[RowsPair], seed: int, **labels: str) -> NumberComparison:
    """Compare one number; a missing truth value is false, any other missing value worse than all.

    An episode has the mean of its samples, and is complete if all of them have a value.
    """
    share, sign = metric.name in SHARES, -1.0 if metric.name in LOWER_IS_BETTER else 1.0
    samples = [[[value_of(row, metric.name) for row in rows] for rows in pair] for pair in pairs]
    measured = [v for pair in samples for rows in pair for v in rows if v is not None]
    worst = 0.0 if share else sign * min(sign * v for v in measured) if measured else math.nan
    filled = _average(samples, worst)
    # `executable` is a share of all samples, as in aggregates.
    values = filled if metric.name == "executable" and measured else _average(samples, math.nan)
    complete = values[np.isfinite(values).all(axis=1)]
    ranked = filled if share else np.where(np.isnan(values), -np.inf, sign * values)
    means = [_mean(own, share, seed) for own in complete.T.tolist()]
    return NumberComparison(
        **labels,
        metric=metric,
        shared=len(values),
        means=(means[0], means[1]),
        difference=_difference(complete, len(values), share, seed),
        better=(int((ranked[:, 0] > ranked[:, 1]).sum()), int((ranked[:, 0] < ranked[:, 1]).sum())),
        bound=_difference(filled[np.isfinite(filled).all(axis=1)], len(values), share, seed),
    )


def _average(samples: Sequence[Sequence[Sequence[float | None]]], missing: float) -> Array:
    """Return the mean (N, 2) of the samples of each episode by two models, with a value in place of missing ones."""
    means = [[float(np.mean([missing if v is None else v for v in own])) for own in pair] for pair in samples]
    return np.array(means, dtype=np.float64).reshape(-1, 2)


def _mean(values: Sequence[float], share: bool, seed: int) -> Estimate:
    """Return the mean of values of episodes, or the share of truth values, with its interval."""
    n = len(values)
    if not share or not n:
        return estimate(values, total=n, seed=seed)
    low, high = share_interval(np.array(values), np.random.default_rng(seed))
    mean = math.fsum(values) / n
    return Estimate(mean=mean, low=low, high=high, n=n, total=n, bound=mean)


def _difference(values: Array, total: int, share: bool, seed: int) -> Estimate:
    """Return the mean of first minus second of `values` (N, 2) with its interval."""
    n = len(values)
    if n == 0:
        return Estimate(mean=None, low=None, high=None, n=0, total=total)
    if share:
        return share_difference(PairedShares(first=values[:, 0], second=values[:, 1], seed=seed), total)
    value = paired_mean_difference(values[:, 0], values[:, 1], np.random.default_rng(seed))
    low, high = (None if math.isnan(end) else end for end in (value.low, value.high))
    return Estimate(mean=value.value, low=low, high=high, n=n, total=total)


def share_difference(paired: PairedShares, total: int | None = None) -> Estimate:
    """Return the difference of two shares with its interval."""
    low, high = paired.interval()
    return Estimate(mean=paired.difference, low=low, high=high, n=paired.n, total=paired.n if total is None else total)


def tabulate_numbers(comparisons: Sequence[NumberComparison]) -> Table:
    """Build the table of compared numbers, one per row."""
    return make_table(
        "numbers",
        map(_row, comparisons),
        bold=((i, "difference") for i, c in enumerate(comparisons) if c.is_clear),
        patterns=(c.metric.pattern for c in comparisons),
    )


def _row(c: NumberComparison) -> dict[str, Value]:
    estimates = {"first_mean": c.means[0], "second_mean": c.means[1], "difference": c.difference, "bound": c.bound}
    return {
        **({"part": c.part} if c.part else {}),
        **{"first": c.first, "second": c.second, "task": c.task, "metric": c.metric.name},
        "number": f"{c.metric.label} {'↓' if c.metric.name in LOWER_IS_BETTER else '↑'}",
        **{key: value for key, value in estimates.items() if value.n},
        **{"complete": c.difference.n, "shared": c.shared, "p": c.p_value},
        **{"first_better": c.better[0], "second_better": c.better[1]},
    }


def number_lines(comparisons: Sequence[NumberComparison]) -> Iterator[str]:
    """Format the comparison of all tasks together for a terminal, one block per pair of models and part."""
    return comparison_lines(tabulate_numbers([c for c in comparisons if c.task == ALL_TASKS]), _PRINTED)


def comparison_lines(table: Table, printed: Sequence[str]) -> Iterator[str]:
    """Format the `printed` columns of a comparison for a terminal, one block per pair of models and part."""
    keys = [column.key for column in table.columns]
    heads = [keys.index(key) for key in ("first", "second", "part") if key in keys]
    for (first, second, *part), rows in groupby(
        range(len(table.rows)), key=lambda i: [str(table.rows[i][k]) for k in heads]
    ):
        yield ", ".join([f"{first} - {second}", *part])
        yield from table_lines(table.select(printed, list(rows)))
        yield ""
    yield table.note


def executable_lines(comparisons: Sequence[NumberComparison]) -> Iterator[str]:
    """Format the shares of executable samples of every two models, all tasks together, a line each."""
    for c in comparisons:
        if c.metric.name == "executable" and c.task == ALL_TASKS:
            first, second = (format_value(mean, c.metric.pattern) for mean in c.means)
            signed = "{:+.0%}"
            difference, interval = format_value(c.difference, signed), format_interval(c.difference, signed)
            names = ", ".join(filter(None, (f"{c.first} - {c.second}", c.part)))
            yield f"{names}: executable {first} and {second} of {c.shared}, difference {difference} [{interval}]"


def draw_numbers(comparisons: Sequence[NumberComparison]) -> ReportFigure | None:
    """Draw the differences of each number, all tasks together, in a panel of its own; None if there is none."""
    drawn = [c for c in comparisons if c.task == ALL_TASKS and c.difference.mean is not None]
    names = list(dict.fromkeys(c.metric.name for c in drawn))
    lines = list(dict.fromkeys((c.first, c.second, c.part) for c in drawn))
    if not names or len(lines) > _MAX_LINES:
        return None
    from matplotlib.ticker import MaxNLocator

    rows = -(-len(names) // _PANELS)
    width = _PANELS * 2.2 + 0.06 * max(len(_line_label(*line)) for line in lines)
    figure, axes = new_figure(width, rows * (0.75 + 0.24 * len(lines)) + 0.3, rows, _PANELS, sharey=True)
    for ax, name in zip(axes.flat, names, strict=False):
        for c in drawn:
            if c.metric.name == name:
                y = float(lines[::-1].index((c.first, c.second, c.part)))
                draw_interval(ax, c.difference, y, "#000000" if c.is_clear else COLOURS[0], "D" if c.is_clear else "o")
        ax.axvline(0.0, color=FAINT, linewidth=1.2, zorder=1)
        ends = [0.0, *(end for c in drawn if c.metric.name == name for end in _ends(c.difference))]
        room = 0.15 * (max(ends) - min(ends)) or 1.0
        ax.set_xlim(min(ends) - room, max(ends) + room)
        ax.xaxis.set_major_locator(MaxNLocator(nbins=4))
        side = "← better" if name in LOWER_IS_BETTER else "better →"
        ax.set_title(f"{NUMBERS[name].label}   {side}", fontsize=8, loc="left")
        ax.set_ylim(-0.6, len(lines) - 0.4)
        ax.tick_params(labelsize=7)
    for ax in axes[:, 0]:
        ax.set_yticks(range(len(lines)), [plain(_line_label(*line)) for line in lines[::-1]], fontsize=7)
    for ax in axes.flat[len(names) :]:
        ax.set_visible(False)
    return make_figure("number_differences", figure)


def _ends(value: Estimate) -> Iterator[float]:
    yield from (end for end in (value.low, value.mean, value.high) if end is not None)


def _line_label(first: str, second: str, part: str) -> str:
    return pair_label(first, second) + (f", {part}" if part else "")


def pair_label(first: str, second: str) -> str:
    """Return the label of two models in a figure."""
    return f"{shorten(first, _MAX_LETTERS)} − {shorten(second, _MAX_LETTERS)}"
