"""The samples of one task or one model, summed up."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from kinebench_drake.aggregate import Aggregate, aggregate, by_key
from kinebench_drake.report.sample import RANK, verdict_of
from kinebench_drake.row import SampleRow


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """Samples that share a task or a model."""

    name: str
    total: Aggregate
    verdicts: Mapping[str, int]
    """Samples of each verdict that occurs, the worst verdict first."""


def group_rows(rows: Sequence[SampleRow], key: str, seed: int = 0) -> list[Group]:
    """Groups of rows by their `task` or `model`, sorted by name; rows without one are left out."""
    found = []
    for name, group in by_key(rows, key).items():
        told = [verdict_of(row) for row in group]
        verdicts = {verdict: told.count(verdict) for verdict in RANK if verdict in told}
        found.append(Group(name=name, total=aggregate(group, seed), verdicts=verdicts))
    return found
