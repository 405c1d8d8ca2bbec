"""Models compared, two by two, on the episodes that both did."""

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

from kinebench_drake.errors import UsageError
from kinebench_drake.report.number import (
    ModelComparison,
    NumberComparison,
    RowsPair,
    compare_numbers,
    tabulate_numbers,
)
from kinebench_drake.results.aggregate import group_by
from kinebench_drake.suites.report.episode_result import EpisodeResult, list_models
from kinebench_drake.suites.report.pooling import pool_episodes, read_suite_runs, spec_warnings
from kinebench_drake.suites.report.suite_page import write_page


def read_comparison(paths: Sequence[Path]) -> ModelComparison:
    """Compare the models of some suite runs on the episodes they share."""
    runs = read_suite_runs(paths)
    episodes = pool_episodes(runs)
    numbers = compare(episodes)
    models = group_by(episodes, lambda e: e.model).items()
    return ModelComparison(
        rows={model: [e.row for e in own] for model, own in models},
        numbers=numbers,
        warnings=spec_warnings(runs),
        write_page=lambda out, leads: write_page(
            "Comparison of models", runs, episodes, out, [tabulate_numbers(numbers)], leads
        ),
    )


def compare(episodes: Sequence[EpisodeResult]) -> list[NumberComparison]:
    """Compare every two models on every part: all shared tasks together, then each.

    Raises:
        UsageError: there are not two models, or no two share an episode.
    """
    models = list_models(episodes)
    if len(models) < 2:
        raise UsageError(
            f"all episodes are of one model, {', '.join(models)}: there is nothing to compare; name folders of two "
            "models, or runs distinguished with `suite run --tag KEY=VALUE`"
        )
    own = {model: group_by(some, lambda e: e.key) for model, some in group_by(episodes, lambda e: e.model).items()}
    numbers: list[NumberComparison] = []
    for first, second in combinations(own, 2):
        shared = [(own[first][key], own[second][key]) for key in own[first] if key in own[second]]
        for part, pairs in sorted(group_by(shared, lambda pair: pair[0][0].part).items()):
            rows: list[RowsPair] = [([e.row for e in one], [e.row for e in other]) for one, other in pairs]
            numbers += compare_numbers(rows, first, second, part.title)
    if not numbers:
        raise UsageError(
            f"no two of {', '.join(models)} share an episode (the same suite, split, task, seed, pool and variant): "
            "there is nothing to compare"
        )
    return numbers
