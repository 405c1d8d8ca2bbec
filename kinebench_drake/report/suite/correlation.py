"""Do smoother models succeed more often? Task-balanced SPARC against success standardised within tasks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.report.suite.episode import EpisodePart, EpisodeResult, group
from kinebench_drake.stats import percentile_interval, resampled_counts

LEAST_POINTS = 3
"""Two points are always in perfect order."""
LEAST_TASKS = 2
"""One task leaves nothing to draw from."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """One model on one part."""

    part: EpisodePart
    model: str
    sparc: float
    """Mean over tasks of the mean SPARC of their episodes."""
    success: float
    """Mean over tasks of success standardised within tasks [standard deviations]."""
    tasks: int
    """Tasks that have both."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Correlation:
    """Spearman's rank correlation of some points."""

    rho: float | None
    """None with fewer than three points, or where one of the two is the same for all."""
    low: float | None
    """Lower end of the 95 % interval; None where there are too few tasks."""
    high: float | None
    points: int
    tasks: int


@dataclass(frozen=True, slots=True, kw_only=True)
class SparcStudy:
    """Points with what stands behind them."""

    points: tuple[Point, ...]
    sparc: Array
    """(P, T) mean SPARC of each point and task; NaN where it was not measured."""
    success: Array
    """(P, T) standardised success; NaN as above."""

    def correlation(self, part: EpisodePart | None = None, seed: int = 0) -> Correlation:
        """Spearman's rho (Am. J. Psychology 15, 1904) over the points, of one part or of all.

        The percentile interval is over 2000 draws of tasks with replacement, the same for all points: it tells what
        other tasks of the sort might have given. Draws in which rho is not defined are passed over.
        """
        chosen = np.array([part in (None, p.part) for p in self.points], dtype=bool)
        x, y = self.sparc[chosen], self.success[chosen]
        some = np.isfinite(x).any(axis=0)
        x, y = x[:, some], y[:, some]
        points, tasks = x.shape
        whole = float(_rho(x, y, np.ones((1, tasks)))[0]) if points >= LEAST_POINTS else np.nan
        if not np.isfinite(whole):
            return Correlation(rho=None, low=None, high=None, points=points, tasks=tasks)
        if tasks < LEAST_TASKS:
            return Correlation(rho=whole, low=None, high=None, points=points, tasks=tasks)
        low, high = percentile_interval(_rho(x, y, resampled_counts(tasks, np.random.default_rng(seed))))
        return Correlation(rho=whole, low=low, high=high, points=points, tasks=tasks)


def study_sparc(episodes: Sequence[EpisodeResult]) -> SparcStudy:
    """Points of all models and parts that have success and SPARC of a task in common.

    Success is standardised within each task of each part: z = (s - mean) / sd over the models that did it, with the
    standard deviation over these models (ddof 0); 0 where all do alike. What makes one task harder than another is thus
    taken out, and what is left is who does better at it. Tasks that one model alone did tell nothing and are left out,
    and so are models that did fewer than half as many tasks of a part as another: their means are of something else.
    """
    tasks = sorted({(e.part, e.task) for e in episodes})
    names = list(group(episodes, lambda e: (e.part, e.model)))
    column = {key: k for k, key in enumerate(tasks)}
    line = {key: k for k, key in enumerate(names)}
    x, s = np.full((len(names), len(tasks)), np.nan), np.full((len(names), len(tasks)), np.nan)
    for (part, model, task), own in group(episodes, lambda e: (e.part, e.model, e.task)).items():
        at = line[part, model], column[part, task]
        x[at] = _mean(own, lambda e: e.metric("sparc"))
        s[at] = _mean(own, lambda e: e.hit)
    known = np.isfinite(x) & np.isfinite(s)
    for part in {p for p, _ in names}:
        rows = np.array([p == part for p, _ in names], dtype=bool)
        counts = known.sum(axis=1)
        known[rows & (2 * counts < counts[rows].max())] = False
    known &= known.sum(axis=0) >= 2
    x[~known], z = np.nan, standardise(np.where(known, s, np.nan))
    kept = np.flatnonzero(known.any(axis=1))
    points = [
        Point(
            part=names[k][0],
            model=names[k][1],
            sparc=float(np.nanmean(x[k])),
            success=float(np.nanmean(z[k])),
            tasks=int(known[k].sum()),
        )
        for k in kept
    ]
    return SparcStudy(points=tuple(points), sparc=x[kept], success=z[kept])


def standardise(values: Array) -> Array:
    """Columns (P, T) with mean 0 and standard deviation 1 over their known values; 0 where those are all alike."""
    known = np.isfinite(values)
    n = np.maximum(known.sum(axis=0), 1)
    centred = values - np.where(known, values, 0.0).sum(axis=0) / n
    spread = np.sqrt((np.where(known, centred, 0.0) ** 2).sum(axis=0) / n)
    flat = spread < 1e-12
    return np.asarray(np.where(flat & known, 0.0, centred / np.where(flat, 1.0, spread)))


def _rho(x: Array, y: Array, weights: Array) -> Array:
    """Spearman's rho (D,) of the points' weighted means over tasks, for weights (D, T) of the tasks.

    Points without any task of weight are left out; NaN where fewer than three are left or one side is flat.
    """
    from scipy.stats import rankdata

    known: NDArray[np.float64] = np.isfinite(x).astype(np.float64)
    total = weights @ known.T
    one, other = (
        np.where(total > 0, weights @ np.where(known > 0, v, 0.0).T / np.maximum(total, 1.0), np.nan).round(12)
        for v in (x, y)
    )
    a, b = (rankdata(v, axis=1, nan_policy="omit") for v in (one, other))
    n = (total > 0).sum(axis=1)
    a, b = (np.nan_to_num(v - (np.nansum(v, axis=1) / np.maximum(n, 1))[:, None]) for v in (a, b))
    spread = np.sqrt((a**2).sum(axis=1) * (b**2).sum(axis=1))
    told = (n >= LEAST_POINTS) & (spread > 0)
    return np.where(told, (a * b).sum(axis=1) / np.where(told, spread, 1.0), np.nan)


def _mean(episodes: Sequence[EpisodeResult], value: Callable[[EpisodeResult], float | None]) -> float:
    values = [v for v in map(value, episodes) if v is not None]
    return float(np.mean(values)) if values else float("nan")
