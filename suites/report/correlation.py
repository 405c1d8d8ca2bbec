"""Rank correlation of a kinematic metric and success: its task-balanced mean, and success standardised within tasks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.io.figure import FAINT, LABEL_PT, new_figure, plain, shorten
from kinebench_drake.report.figures import COLOURS, ReportFigure, add_legend, make_figure, style
from kinebench_drake.report.table import Table, Value, make_table
from kinebench_drake.results.aggregate import Estimate, group_by
from kinebench_drake.stats import percentile_interval, resampled_counts
from kinebench_drake.suites.report.episode_result import EpisodeResult, SuitePart, worst_metric
from kinebench_drake.suites.report.pooling import model_of

MIN_POINTS = 3
"""Points needed: two are always in perfect order."""
_MIN_TASKS = 2
"""Tasks needed for an interval, which resamples them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Predictor:
    """Metric that may go along with success."""

    name: str
    """Stem of the file names."""
    label: str
    side: str
    """Which values are better."""
    sense: str
    """Meaning of one of the extremes of rho."""
    value: Callable[[EpisodeResult], float | None]
    worst: Callable[[Sequence[EpisodeResult]], float | None]
    """Worst value among some episodes."""

    @property
    def captions(self) -> dict[str, Any]:
        """Values of the placeholders in captions."""
        heading = self.label[:1].upper() + self.label[1:]
        return {"predictor": self.name, "heading": heading, "label": self.label, "sense": self.sense}


SPARC = Predictor(
    name="sparc",
    label="SPARC",
    side="nearer 0 is smoother",
    sense="1: smoother is better",
    value=lambda e: e.metric("sparc"),
    worst=lambda episodes: worst_metric("sparc", episodes),
)
MANIPULABILITY = Predictor(
    name="manipulability_cost",
    label="scaled manipulability cost",
    side="lower is better",
    sense="-1: a lower cost is better",
    value=lambda e: e.cost_scaled,
    worst=lambda episodes: 1.0,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class CorrelationPoint:
    """One model on one part."""

    part: SuitePart
    model: str
    metric: float
    """Mean over tasks of the mean of the metric over their episodes."""
    success: float
    """Mean over tasks of success standardised within tasks [standard deviations]."""
    tasks: int
    """Tasks that have both."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CorrelationStudy:
    """Points, and the values of the single tasks that they average."""

    predictor: Predictor
    points: tuple[CorrelationPoint, ...]
    metric: Array
    """(P, T) mean of the metric of each point and task; NaN where not measured."""
    success: Array
    """(P, T) standardised success; NaN where not measured."""

    @property
    def is_defined(self) -> bool:
        """True if any part, or all together, have a correlation."""
        return any(self.correlate(part)[0].mean is not None for part in (None, *(p.part for p in self.points)))

    def correlate(self, part: SuitePart | None = None) -> tuple[Estimate, int]:
        """Compute Spearman's rho (Am. J. Psychology 15, 1904) over the points of one part, or of all; and their tasks.

        There is no mean with fewer than three points, or if one of the two variables is constant. The percentile
        interval is over 2000 draws of tasks with replacement, the same for all points: it covers other tasks of the
        same kind. Draws in which rho is undefined are skipped; there is no interval if there are too few tasks or all
        draws have the same rho.
        """
        chosen = np.array([part in (None, p.part) for p in self.points], dtype=bool)
        x = self.metric[chosen]
        y = self.success[chosen]
        some = np.isfinite(x).any(axis=0)
        x = x[:, some]
        y = y[:, some]
        points, tasks = x.shape
        rho = float(_rho(x, y, np.ones((1, tasks)))[0]) if points >= MIN_POINTS else np.nan
        defined = bool(np.isfinite(rho))
        low = None
        high = None
        if defined and tasks >= _MIN_TASKS:
            low, high = percentile_interval(_rho(x, y, resampled_counts(tasks, np.random.default_rng(0))))
            low, high = (low, high) if high - low > 1e-12 else (None, None)
        return Estimate(mean=rho if defined else None, low=low, high=high, n=points, total=points), tasks


def study_correlation(episodes: Sequence[EpisodeResult], predictor: Predictor = SPARC) -> CorrelationStudy:
    """Compute the points of all models and parts that share tasks with the metric and success.

    Success is standardised within each task of each part: z = (s - mean) / sd over the models that did it, with the
    standard deviation over these models (ddof 0); 0 where all are equal. This removes the difficulty of the tasks.
    Tasks of a single model carry no information and are left out, and so are models that did fewer than half as many
    tasks of a part as another: their means are over different tasks. Episodes without the metric have the worst of all.
    """
    tasks = sorted({(e.part, e.task) for e in episodes})
    names = list(group_by(episodes, lambda e: (e.part, e.model)))
    column = {key: k for k, key in enumerate(tasks)}
    line = {key: k for k, key in enumerate(names)}
    x = np.full((len(names), len(tasks)), np.nan)
    s = np.full((len(names), len(tasks)), np.nan)
    for (part, model, task), means in _means_by_task(episodes, predictor).items():
        cell = line[part, model], column[part, task]
        x[cell], s[cell] = means
    valid = np.isfinite(x) & np.isfinite(s)
    for part in {p for p, _ in names}:
        rows = np.array([p == part for p, _ in names], dtype=bool)
        counts = valid.sum(axis=1)
        valid[rows & (2 * counts < counts[rows].max())] = False
    valid &= valid.sum(axis=0) >= 2
    x[~valid] = np.nan
    z = standardise(np.where(valid, s, np.nan))
    kept = np.flatnonzero(valid.any(axis=1))
    points = [
        CorrelationPoint(
            part=names[k][0],
            model=names[k][1],
            metric=float(np.nanmean(x[k])),
            success=float(np.nanmean(z[k])),
            tasks=int(valid[k].sum()),
        )
        for k in kept
    ]
    return CorrelationStudy(predictor=predictor, points=tuple(points), metric=x[kept], success=z[kept])


def standardise(values: Array) -> Array:
    """Scale columns (P, T) to mean 0 and standard deviation 1 over their finite values; 0 where these are equal."""
    finite = np.isfinite(values)
    n = np.maximum(finite.sum(axis=0), 1)
    centred = values - np.where(finite, values, 0.0).sum(axis=0) / n
    spread = np.sqrt((np.where(finite, centred, 0.0) ** 2).sum(axis=0) / n)
    flat = spread < 1e-12
    return np.asarray(np.where(flat & finite, 0.0, centred / np.where(flat, 1.0, spread)))


def _rho(x: Array, y: Array, weights: Array) -> Array:
    """Compute Spearman's rho (D,) of the points' weighted means over tasks, for weights (D, T) of the tasks.

    Points without any task of weight are left out; NaN where fewer than three remain or one variable is constant.
    """
    from scipy.stats import rankdata

    finite: NDArray[np.float64] = np.isfinite(x).astype(np.float64)
    total = weights @ finite.T
    one, other = (
        np.where(total > 0, weights @ np.where(finite > 0, v, 0.0).T / np.maximum(total, 1.0), np.nan).round(12)
        for v in (x, y)
    )
    a, b = (rankdata(v, axis=1, nan_policy="omit") for v in (one, other))
    n = (total > 0).sum(axis=1)
    a, b = (np.nan_to_num(v - (np.nansum(v, axis=1) / np.maximum(n, 1))[:, None]) for v in (a, b))
    spread = np.sqrt((a**2).sum(axis=1) * (b**2).sum(axis=1))
    defined = (n >= MIN_POINTS) & (spread > 0)
    return np.where(defined, (a * b).sum(axis=1) / np.where(defined, spread, 1.0), np.nan)


def _means_by_task(
    episodes: Sequence[EpisodeResult], predictor: Predictor
) -> dict[tuple[SuitePart, str, str], tuple[float, float]]:
    """Return the means of a metric and of success for each part, model and task.

    Episodes without the metric have the worst of all; the mean is NaN only if the model never has it.
    """
    worst = predictor.worst(episodes)
    measured = {e.model for e in episodes if predictor.value(e) is not None}
    means = {}
    for key, own in group_by(episodes, lambda e: (e.part, e.model, e.task)).items():
        values = [predictor.value(e) for e in own] if key[1] in measured else []
        means[key] = _mean([worst if v is None else v for v in values]), _mean([e.hit for e in own])
    return means


def _mean(values: Sequence[float | None]) -> float:
    numbers = [v for v in values if v is not None]
    return float(np.mean(numbers)) if numbers else float("nan")


def tabulate_correlation(study: CorrelationStudy) -> Table:
    """Build the table of Spearman's rho between a metric and success, of each part and of all."""
    parts = sorted({p.part for p in study.points})
    lines = [(p.title, *study.correlate(p)) for p in parts]
    if len(parts) > 1:
        lines.append(("All", *study.correlate(None)))
    rows: list[dict[str, Value]] = [
        {"part": title, "rho": rho, "points": rho.n, "tasks": tasks} for title, rho, tasks in lines
    ]
    return make_table("correlation", rows, **study.predictor.captions)


def draw_correlation(episodes: Sequence[EpisodeResult], study: CorrelationStudy) -> ReportFigure | None:
    """Draw a metric against success, by model and task and, beside it, task-balanced; None without a point."""
    predictor = study.predictor
    parts = sorted({e.part for e in episodes})
    own_names = {e.model: model_of(e.row) for e in episodes}
    labels = {model: model if len(own_names) <= len(COLOURS) else name for model, name in own_names.items()}
    models = list(dict.fromkeys(labels.values()))
    points = [
        (part, labels[model], metric, success)
        for (part, model, _), (metric, success) in _means_by_task(episodes, predictor).items()
        if np.isfinite(metric) and np.isfinite(success)
    ]
    if not points:
        return None

    def marks(model: str, part: SuitePart) -> dict[str, Any]:
        return {"color": style(models.index(model))[0], "marker": style(parts.index(part))[1], "linewidths": 0}

    figure, axes = new_figure(9.2, 4.2, 1, 2)
    left, right = axes[0]
    for part, model, metric, success in points:
        left.scatter(metric, success, **marks(model, part), s=20, alpha=0.7)
    metric_label = f"mean {predictor.label} of a task ({predictor.side})"
    left.set(ylim=(-0.04, 1.04), xlabel=metric_label, ylabel="success of a task")
    right.set(xlabel=f"task-balanced mean {predictor.label}", ylabel="success, standardised within tasks [sd]")
    right.axhline(0.0, color=FAINT, linewidth=1.0)
    for point in study.points:
        right.scatter(point.metric, point.success, **marks(labels[point.model], point.part), s=42)
    rho, _ = study.correlate(None)
    title = "rho needs three models" if study.points else "needs two models on a task"
    if rho.mean is not None:
        title = f"Spearman's rho {rho.mean:.2f}" + ("" if rho.low is None else f" [{rho.low:.2f}, {rho.high:.2f}]")
    right.set_title(title, fontsize=LABEL_PT)
    for model in dict.fromkeys(m for _, m, *_ in points):
        colour = style(models.index(model))[0]
        left.plot([], [], linestyle="", marker="o", color=colour, markersize=5, label=plain(shorten(model)))
    if len(parts) > 1:
        for k, part in enumerate(parts):
            left.plot([], [], linestyle="", marker=style(k)[1], color=FAINT, markersize=5, label=plain(part.title))
    add_legend(figure, models)
    return make_figure("correlation", figure, **predictor.captions)
