"""Every episode as a table, for files."""

from collections.abc import Sequence

from kinebench_drake.row import Json
from kinebench_drake.suite_report.episode import COST, Episode
from kinebench_drake.suite_report.table import Column, Table, Value

_METRICS = ("sparc", "sparc_rotation", "ldlj", "manipulability_mean", COST, "ik_success_rate", "tracked_fraction")
_KEYS = (
    *("part", "suite", "split", "variant", "pool", "task", "seed", "model", "folder", "id", "status", "reason"),
    *("success", "progress", "rounds", "verdict", "manipulability_cost_scaled", *_METRICS),
)


def episode_table(episodes: Sequence[Episode]) -> Table:
    """All episodes, a row each."""
    return Table(
        name="episodes",
        title="Episodes",
        note="",
        columns=tuple(Column(key=key, label=key) for key in _KEYS),
        rows=tuple(_row(e) for e in episodes),
        latex=False,
    )


def _row(e: Episode) -> tuple[Value, ...]:
    success = None if e.success is None else int(e.success)
    extra, folder = e.row.extra, e.folder.resolve().name if e.folder else None
    return (
        *(e.part.title, e.part.suite, e.part.split, _plain(extra.get("variant")), _plain(extra.get("pool")), e.task),
        *(_plain(extra.get("seed")), e.model, folder, e.row.id, e.row.status.value, e.row.reason),
        *(success, e.progress, e.rounds, e.verdict, e.cost_scaled, *(e.metric(name) for name in _METRICS)),
    )


def _plain(value: Json) -> Value:
    return value if isinstance(value, str | int | float) else None
