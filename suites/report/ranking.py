"""Models of suite runs for a leaderboard, their success corrected by that of the oracle."""

from collections.abc import Sequence
from dataclasses import replace
from math import isnan
from pathlib import Path

from kinebench_drake.report.leaderboard import ModelEntry, Ranking, tabulate_headlines
from kinebench_drake.report.number import NumberComparison
from kinebench_drake.report.page_parts import make_missing
from kinebench_drake.results.aggregate import Estimate, group_by
from kinebench_drake.suites.report.comparison import compare
from kinebench_drake.suites.report.episode_result import tabulate_episodes
from kinebench_drake.suites.report.pooling import pool_episodes, read_suite_runs

ORACLE = "oracle"
"""World model whose success is the ceiling of all others."""


def rank_models(folders: Sequence[Path]) -> Ranking:
    """Return the models of suite runs with the tables of a leaderboard."""
    own = {run.path: run for run in read_suite_runs(folders)}
    episodes = pool_episodes(list(own.values()))
    oracles = {e.model for e in episodes if own[e.folder].config.get("world_model") == ORACLE}
    numbers, comparison = tabulate_headlines(lambda: compare(episodes))
    entries = []
    for (part, model), some in group_by(episodes, lambda e: (e.part, e.model)).items():
        of = [own[path] for path in dict.fromkeys(e.folder for e in some)]
        corrected, ceiling = _correct([c for c in numbers if c.part == part.title], model, oracles)
        entry = ModelEntry(part=part.title, model=model, runs=of, rows=[e.row for e in some])
        entries.append(replace(entry, corrected=corrected, ceiling=ceiling))
    parts = [comparison, *([] if oracles else [make_missing("ceiling")])]
    return entries, parts, tabulate_episodes(episodes)


def _correct(
    numbers: Sequence[NumberComparison], model: str, oracles: set[str]
) -> tuple[Estimate | None, float | None]:
    """Return success over that of the oracle, and the oracle's success, in the episodes that both have."""
    if model in oracles:
        return None, None
    for c in numbers:
        models = {c.first, c.second}
        if c.paired and c.metric.name == "success" and model in models and models & oracles:
            shares = c.paired
            if c.second == model:
                shares = replace(shares, first=shares.second, second=shares.first)
            ratio = shares.ratio()
            ceiling = shares.rates[1]
            low, high = (None if isnan(end) else end for end in (ratio.low, ratio.high))
            return Estimate(
                mean=None if isnan(ratio.value) else ratio.value, low=low, high=high, n=shares.n, total=shares.n
            ), ceiling
    return None, None
