"""One episode of a suite run as reports see it: which it was, who did it, and what came of it."""

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from kinebench_drake.io.jsonl import dump, finite
from kinebench_drake.report.suite.table import Column, Table, Value
from kinebench_drake.results.aggregate import robust_normalize
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.types import Json

COST = "manipulability_cost_mean"
"""Metric that is put on the scale of all episodes of a report."""
Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class EpisodePart:
    """What a run was about: episodes of different parts are never put together."""

    suite: int
    """Number of the suite."""
    split: str
    """Name of its split."""
    variant: str = "plain"
    """Version of the scenes."""

    @property
    def title(self) -> str:
        """Its name for a reader, such as "Suite 2 (unseen)"; the split "test" and plain scenes are not named."""
        told = [text for text, usual in ((self.split, "test"), (self.variant, "plain")) if text != usual]
        return f"Suite {self.suite}" + (f" ({', '.join(told)})" if told else "")

    @property
    def slug(self) -> str:
        """Its name in file names, such as "suite2_unseen"."""
        return "_".join([f"suite{self.suite}", *(t for t in (self.split, self.variant) if t not in ("test", "plain"))])


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeResult:
    """One episode, done once by one model."""

    part: EpisodePart
    model: str
    """Name of the model, with whatever else tells its run from others of the same model."""
    folder: Path | None
    """Output folder of the run; None where there was none."""
    row: SampleRow
    """Its line in the folder, or as one would be."""
    cost_scaled: float | None = None
    """`manipulability_cost_mean` on the scale of all episodes reported, 0..1; see `scale_costs`."""

    @property
    def task(self) -> str:
        """Plain task id."""
        return self.row.task or "unnamed"

    @property
    def key(self) -> tuple[EpisodePart, str, str]:
        """What makes two models' episodes the same one: part, task, seed, pool and variant."""
        extra = self.row.extra
        return self.part, self.task, dump(finite([extra.get(name) for name in ("seed", "pool", "variant")]))

    @property
    def success(self) -> bool | None:
        """Whether the goal was met; None where it could not be told: the row is no success and no failure."""
        told = self.row.extra.get("success")
        return told if isinstance(told, bool) and self.row.status is Status.OK else None

    @property
    def hit(self) -> float | None:
        """Success as a number, 0 or 1."""
        return None if self.success is None else float(self.success)

    @property
    def progress(self) -> float | None:
        """Share of the task's steps done, 0..1; None where it could not be told."""
        return self._number(self.row.extra.get("progress"))

    @property
    def rounds(self) -> float | None:
        """Clips asked for; None where it could not be told."""
        return self._number(self.row.extra.get("rounds"))

    @property
    def verdict(self) -> str | None:
        """Cause of a failure; None for a success, or where none was found."""
        told = self.row.extra.get("verdict")
        return told if isinstance(told, str) and self.success is False else None

    def metric(self, name: str) -> float | None:
        """A metric, a truth value as 0 or 1; None where it was not measurable."""
        return self._number(self.row.metrics.get(name))

    def _number(self, value: Json) -> float | None:
        known = isinstance(value, bool | int | float) and self.row.status is Status.OK
        return float(value) if known and isinstance(value, bool | int | float) and np.isfinite(value) else None


def scale_costs(episodes: Iterable[EpisodeResult]) -> list[EpisodeResult]:
    """Put the manipulability costs of all episodes on one scale from their 10th to their 90th percentile.

    0 is the 10th percentile or less, 1 the 90th or more; see `normalization.robust_normalize`. Fewer than two costs
    span no scale, and nothing is scaled.
    """
    given = list(episodes)
    costs = np.array([np.nan if (c := e.metric(COST)) is None else c for e in given], dtype=np.float64)
    if np.isfinite(costs).sum() < 2:
        return given
    scaled = robust_normalize(costs)
    return [replace(e, cost_scaled=float(v) if np.isfinite(v) else None) for e, v in zip(given, scaled, strict=True)]


def group(episodes: Iterable[EpisodeResult], key: Callable[[EpisodeResult], Key]) -> dict[Key, list[EpisodeResult]]:
    """Episodes by a key, in the order in which the keys turn up."""
    groups: dict[Key, list[EpisodeResult]] = {}
    for episode in episodes:
        groups.setdefault(key(episode), []).append(episode)
    return groups


_METRICS = ("sparc", "sparc_rotation", "ldlj", "manipulability_mean", COST, "ik_success_rate", "tracked_fraction")
_KEYS = (
    *("part", "suite", "split", "variant", "pool", "task", "seed", "model", "folder", "id", "status", "reason"),
    *("success", "progress", "rounds", "verdict", "manipulability_cost_scaled", *_METRICS),
)


def episode_table(episodes: Sequence[EpisodeResult]) -> Table:
    """All episodes, a row each."""
    return Table(
        name="episodes",
        title="Episodes",
        note="",
        columns=tuple(Column(key=key, label=key) for key in _KEYS),
        rows=tuple(_row(e) for e in episodes),
        latex=False,
    )


def _row(e: EpisodeResult) -> tuple[Value, ...]:
    success = None if e.success is None else int(e.success)
    extra, folder = e.row.extra, e.folder.resolve().name if e.folder else None
    return (
        *(e.part.title, e.part.suite, e.part.split, _plain(extra.get("variant")), _plain(extra.get("pool")), e.task),
        *(_plain(extra.get("seed")), e.model, folder, e.row.id, e.row.status.value, e.row.reason),
        *(success, e.progress, e.rounds, e.verdict, e.cost_scaled, *(e.metric(name) for name in _METRICS)),
    )


def _plain(value: Json) -> Value:
    return value if isinstance(value, str | int | float) else None
