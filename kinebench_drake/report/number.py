"""Headline numbers of two models, compared on the samples that both have: table and text."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kinebench_drake.errors import count_noun
from kinebench_drake.geometry import Array
from kinebench_drake.report.metric import BY_NAME, Metric
from kinebench_drake.report.run import check_page_folder
from kinebench_drake.report.table import Table, Value, make_table, table_lines
from kinebench_drake.results.aggregate import Estimate, estimate, group_by
from kinebench_drake.results.direction import LOWER_IS_BETTER
from kinebench_drake.results.power import episodes_to_decide, least_difference
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.stats import (
    CONFIDENCE,
    IntervalEstimate,
    PairedShares,
    adjust_p_values,
    paired_mean_difference,
    share_interval,
    sign_test,
)

ALL_TASKS = "all tasks"
SHARES = {
    name: Metric(name=name, label=label, pattern="{:.0%}", meaning=meaning)
    for name, label, meaning in (
        ("success", "Success", BY_NAME["success"].meaning),
        ("executable", "Executable", "share of samples that a robot can execute as they are seen"),
        ("feasible", "Feasible", "share of samples whose motion exceeds no limit"),
        ("trajopt_feasible", "Trajectory optimised", BY_NAME["trajopt_feasible"].meaning),
        ("follows", "Follows", BY_NAME["follows"].meaning),
    )
}
"""Truth values; a missing one counts as false, of `executable` everywhere, of the others in the bound."""
_MEANS = (
    *("executability", "tracked_fraction", "ik_success_rate"),
    *("manipulability_mean", "manipulability_min", "manipulability_cost_mean"),
    *("joint_limit_margin_min", "sparc", "sparc_rotation", "ldlj", "slowdown_min", "velocity_ratio_max"),
    *("acceleration_ratio_max", "jerk_ratio_max", "torque_ratio_max", "self_distance_min_m", "table_distance_min_m"),
    *("follow_share", "deviation_m", "deviation_rad", "deviation_px", "deviation_hands"),
)
NUMBERS = {**SHARES, **{name: BY_NAME[name] for name in ("progress", *_MEANS)}}
"""Numbers that are compared, in the order of the table."""
HEADLINES = ("success", "executable", "feasible", "manipulability_mean", "sparc")
"""Numbers that are compared task by task, too, and on leaderboards."""
RANKING = ("success", "executable")
"""Shares by which models are ranked; open ones count as no, and as yes in `upper`."""
_PRINTED = ("first_mean", "second_mean", "difference", "complete", "p", "p_adjusted")
"""Keys of the columns printed to a terminal, after that of the row."""
_TERMINAL_LETTERS = 12
"""Letters of a model's name in a heading on a terminal, which has about 100 columns."""
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
    """Shared samples in which the first, and in which the second, is better at worst; none is worse than a missing
    worst case."""
    bound: Estimate
    """First minus second over all shared samples, each at its worst: a missing worst case counts as the worst value of
    either model."""
    paired: PairedShares | None
    """Truth values of all shared samples, each at its worst; None of other numbers."""
    adjusted_p: float | None
    """p-value of a task, adjusted for the number of tasks (Benjamini and Hochberg 1995); None of other numbers."""

    @property
    def is_clear(self) -> bool:
        """True if the intervals of the difference and of its bound exclude 0 on the same side, and p confirms it.

        Of few samples the bootstrap interval is too narrow; the sign test is exact.
        """
        ends = [(e.low, e.high) for e in (self.difference, self.bound) if e.low is not None and e.high is not None]
        outside = len(ends) == 2 and (all(low > 0.0 for low, _ in ends) or all(high < 0.0 for _, high in ends))
        return outside and (self.p_value if self.adjusted_p is None else self.adjusted_p) < 1.0 - CONFIDENCE

    @property
    def p_value(self) -> float:
        """Two-sided p-value: of truth values that of `PairedShares`, else of the exact sign test of `better`."""
        return self.paired.p_value if self.paired else sign_test(*self.better)


def worst_of(row: SampleRow, name: str) -> float | None:
    """Return the worst that a number of a row can be, whatever happens in lost frames; None if there is no worst."""
    bound = row.bound(name)
    return float(bound) if row.status is Status.OK and bound is not None else None


def compare_numbers(pairs: Sequence[RowsPair], first: str, second: str, part: str = "") -> list[NumberComparison]:
    """Compare every number that is measured in a shared sample: all tasks together, then a few task by task.

    Args:
        pairs: rows of the first and of the second model of the same samples; several rows of an episode are averaged.
    """
    tasks = group_by(pairs, lambda pair: pair[0][0].task or pair[1][0].task or "unnamed")
    groups = [(ALL_TASKS, pairs, tuple(NUMBERS))]
    if len(tasks) > 1:
        groups += [(task, tasks[task], HEADLINES) for task in sorted(tasks)]
    comparisons = [
        _compare(NUMBERS[name], own, part=part, task=task, first=first, second=second)
        for task, own, names in groups
        for name in names
        if any(row.number(name) is not None for pair in pairs for rows in pair for row in rows)
    ]
    adjusted = {
        (name, task): p
        for name in HEADLINES
        for task, p in adjust_p_values(
            {c.task: c.p_value for c in comparisons if c.metric.name == name and c.task != ALL_TASKS}
        ).items()
    }
    return [replace(c, adjusted_p=adjusted.get((c.metric.name, c.task))) for c in comparisons]


def _compare(metric: Metric, pairs: Sequence[RowsPair], **labels: str) -> NumberComparison:
    """Compare one number; a missing truth value is false, any other missing worst case worse than all.

    An episode has the mean of its samples, and is complete if all of them have a value.
    """
    share = metric.name in SHARES
    sign = -1.0 if metric.name in LOWER_IS_BETTER else 1.0
    samples = [[[row.number(metric.name) for row in rows] for rows in pair] for pair in pairs]
    bounds = [[[worst_of(row, metric.name) for row in rows] for rows in pair] for pair in pairs]
    every = [v for pair in (*samples, *bounds) for rows in pair for v in rows if v is not None]
    worst = 0.0 if share else sign * min(sign * v for v in every) if every else math.nan
    filled = _average(bounds, worst)
    # `executable` is a share of all samples, as in aggregates.
    values = filled if metric.name == "executable" and every else _average(samples, math.nan)
    complete = values[np.isfinite(values).all(axis=1)]
    least = filled if share else sign * _average(bounds, math.nan)
    ranked = np.where(np.isnan(least), -np.inf, least)
    means = [_mean(own, share) for own in complete.T.tolist()]
    repeats = max(len(rows) for pair in pairs for rows in pair)
    if metric.name in RANKING:
        most = [[[float(row.number(metric.name) != 0.0) for row in rows] for rows in pair] for pair in pairs]
        means = [replace(m, upper=float(u)) for m, u in zip(means, _average(most, 1.0).mean(axis=0), strict=True)]
    return NumberComparison(
        **labels,
        metric=metric,
        shared=len(values),
        means=(means[0], means[1]),
        difference=_difference(complete, len(values), share),
        better=(int((ranked[:, 0] > ranked[:, 1]).sum()), int((ranked[:, 0] < ranked[:, 1]).sum())),
        bound=_difference(filled[np.isfinite(filled).all(axis=1)], len(values), share),
        paired=PairedShares(first=filled[:, 0], second=filled[:, 1], samples=repeats) if share else None,
        adjusted_p=None,
    )


def _average(samples: Sequence[Sequence[Sequence[float | None]]], missing: float) -> Array:
    """Return the mean (N, 2) of the samples of each episode by two models, with a value in place of missing ones."""
    means = [[float(np.mean([missing if v is None else v for v in own])) for own in pair] for pair in samples]
    return np.array(means, dtype=np.float64).reshape(-1, 2)


def _mean(values: Sequence[float], share: bool) -> Estimate:
    """Return the mean of values of episodes, or the share of truth values, with its interval."""
    n = len(values)
    if not share or not n:
        return estimate(values, total=n)
    low, high = share_interval(np.array(values), np.random.default_rng(0))
    mean = math.fsum(values) / n
    return Estimate(mean=mean, low=low, high=high, n=n, total=n, bound=mean)


def _difference(values: Array, total: int, share: bool) -> Estimate:
    """Return the mean of first minus second of `values` (N, 2) with its interval."""
    n = len(values)
    if n == 0:
        return Estimate(mean=None, low=None, high=None, n=0, total=total)
    if share:
        return share_difference(PairedShares(first=values[:, 0], second=values[:, 1]), total)
    return to_estimate(paired_mean_difference(values[:, 0], values[:, 1], np.random.default_rng(0)), n, total)


def to_estimate(value: IntervalEstimate, n: int, total: int) -> Estimate:
    """Return a figure as an estimate over n of some samples, NaN as None."""
    mean, low, high = (None if math.isnan(v) else v for v in (value.value, value.low, value.high))
    return Estimate(mean=mean, low=low, high=high, n=n, total=total)


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
        **({} if c.adjusted_p is None else {"p_adjusted": c.adjusted_p}),
        **{"first_better": c.better[0], "second_better": c.better[1]},
    }


def number_lines(comparisons: Sequence[NumberComparison]) -> Iterator[str]:
    """Format a comparison for a terminal: all numbers over all tasks, then success task by task."""
    whole = [c for c in comparisons if c.task == ALL_TASKS]
    tasks = [c for c in comparisons if c.task != ALL_TASKS and c.metric.name == "success"]
    for key, own in (("number", whole), ("task", tasks)):
        for table in tabulate_numbers(own).by_pair(_TERMINAL_LETTERS):
            if table.rows:
                yield table.title
                yield from table_lines(table.select((key, *_PRINTED), range(len(table.rows))))
                yield ""
    yield "* the intervals of the difference and of its worst case exclude 0, and p < 0.05; both: measured for both"


def verdict_lines(comparisons: Sequence[NumberComparison]) -> Iterator[str]:
    """Say of every two models which succeeds more often and which has more executable samples, a line each."""
    for name in RANKING:
        for c in comparisons:
            if c.metric.name == name and c.task == ALL_TASKS and c.paired is not None:
                yield verdict_line(c.first, c.second, c.part, name, c.paired, (c.means[0].upper, c.means[1].upper))


def verdict_line(
    first: str,
    second: str,
    part: str,
    share: str,
    paired: PairedShares,
    uppers: tuple[float | None, float | None] = (None, None),
) -> str:
    """Say which of two models has the greater share, or that it is undecided and how many samples would decide.

    Args:
        paired: truth values of the shared samples, missing ones as false.
        uppers: the shares if all missing truth values were true; None where they are the same.
    """
    difference = paired.difference
    (low, high) = paired.interval()
    sides = list(zip((first, second), paired.rates, uppers, strict=True))
    if difference < 0.0:
        sides, difference, low, high = sides[::-1], -difference, -high, -low
    numbers = [
        f"{rate:.0%}" + (f" (at most {upper:.0%})" if upper is not None and upper > rate else "")
        for _, rate, upper in sides
    ]
    (one, *_), (other, *_) = sides
    text = (
        f"{share} {numbers[0]} against {numbers[1]} of {count_noun(paired.n, 'shared sample')}"
        f"{f' of {part}' if part else ''}, "
        f"difference {difference:+.0%} [{low:+.0%} to {high:+.0%}], p = {paired.p_value:.2g}"
    )
    if low > 0.0 and paired.p_value < 1.0 - CONFIDENCE:
        return f"{one} is better than {other}: {text}"
    needed = episodes_to_decide(paired)
    least = least_difference(paired)
    if needed is not None:
        text += f"; about {needed} such samples would decide"
    elif least is not None:
        text += f"; so many samples show differences of {least:.0%} and more"
    else:
        text += "; too few samples to show any difference"
    return f"Undecided between {one} and {other}: {text}"


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelComparison:
    """Models of some runs, compared two by two on the samples or episodes that both have."""

    rows: Mapping[str, Sequence[SampleRow]]
    """Rows of each model."""
    numbers: Sequence[NumberComparison]
    pairings: Sequence[str] = ()
    """How the samples of every two models are paired, a line each."""
    warnings: Sequence[str]
    """What else differs between the runs, a line each."""
    write_page: Callable[[Path, Sequence[str]], Path]
    """Writes page and tables to a folder, the page beginning with some lines; returns the page."""

    @property
    def leads(self) -> list[str]:
        """The better of every two models, in success, then in executable samples; motionless samples."""
        verdicts = list(verdict_lines(self.numbers)) or ["No sample has a verdict that would rank the models"]
        counts = {model: sum(row.metrics.motionless for row in rows) for model, rows in self.rows.items()}
        shares = (f"{n} of {count_noun(len(self.rows[model]), 'sample')} of {model}" for model, n in counts.items())
        return [*verdicts, *([f"Motionless: {', '.join(shares)}"] if any(counts.values()) else [])]

    @property
    def lines(self) -> list[str]:
        """Text for a terminal: the better models, how samples are paired, numbers of all tasks together and of each."""
        return [*self.leads, *self.pairings, "", *number_lines(self.numbers)]

    def write(self, out: Path) -> Path:
        """Write page and tables; return the page.

        Raises:
            UsageError: the folder is the output folder of a run.
        """
        check_page_folder(out)
        return self.write_page(out, self.leads)
