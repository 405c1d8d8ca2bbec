"""Models compared, two by two, on the episodes that both did; and with direct execution of the expert's track."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

from kinebench_drake.errors import UsageError
from kinebench_drake.report.number import (
    ALL_TASKS,
    NumberComparison,
    RowsPair,
    compare_numbers,
    motionless_lines,
    verdict_lines,
)
from kinebench_drake.results.aggregate import OUTCOMES
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.suites.report.episode_result import EpisodeResult, group_by, list_models
from kinebench_drake.suites.report.pooling import SuiteRun, pool_episodes, read_suite_runs

if TYPE_CHECKING:
    from kinebench_drake.suites.closed_loop.tolerance import ToleranceAttempt
    from kinebench_drake.suites.composition import Episode

DIRECT = "expert's true track"
"""Label of direct execution in place of a model's name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelComparison:
    """Comparison of all pairs of models of some runs."""

    runs: Sequence[SuiteRun]
    episodes: Sequence[EpisodeResult]
    numbers: Sequence[NumberComparison]
    """Outcomes and headline numbers on the shared episodes."""

    @property
    def leads(self) -> list[str]:
        """The better of every two models on every part, in success, then in executable videos; motionless samples."""
        models = group_by(self.episodes, lambda e: e.model).items()
        return [*verdict_lines(self.numbers), *motionless_lines({model: [e.row for e in own] for model, own in models})]


def read_comparison(paths: Sequence[Path]) -> ModelComparison:
    """Compare the models of some suite runs on the episodes they share."""
    runs = read_suite_runs(paths)
    episodes = pool_episodes(runs)
    return ModelComparison(runs=runs, episodes=episodes, numbers=compare(episodes))


def read_ceiling(
    paths: Sequence[Path], execute: "Callable[[Sequence[Episode]], Iterable[ToleranceAttempt]]"
) -> ModelComparison:
    """Compare each model of some suite runs with direct execution of the expert's true track: each task's ceiling.

    Args:
        paths: output folders of `suite run`.
        execute: executes the expert's track in each of some episodes, in any order.

    Raises:
        UsageError: the folders cannot be used or pooled, or a row lacks its seed, pool or variant.
        KinebenchError: a worker died.
    """
    runs = read_suite_runs(paths)
    episodes = pool_episodes(runs)
    if DIRECT in list_models(episodes):
        raise UsageError(f"a model is named {DIRECT!r}, which is the label of direct execution; give it another name")
    compositions = {e.key: _compose(e) for e in episodes}
    unique = {episode.id: episode for episode in compositions.values()}
    attempts = {attempt.episode.id: attempt for attempt in execute(list(unique.values()))}
    once = {key: own[0] for key, own in group_by(episodes, lambda e: e.key).items()}
    direct = [_direct_result(e, attempts[compositions[key].id]) for key, e in once.items()]
    numbers = [c for c in compare([*episodes, *direct]) if c.second == DIRECT and c.metric.name in OUTCOMES]
    return ModelComparison(runs=runs, episodes=[*episodes, *direct], numbers=numbers)


def _compose(result: EpisodeResult) -> "Episode":
    """Compose the episode that a row names."""
    from kinebench_drake.suites.catalog import EpisodeSpec
    from kinebench_drake.suites.composition import Pool
    from kinebench_drake.suites.families.task import TaskVariant

    extra = result.row.extra
    try:
        seed = int(str(extra["seed"]))
        pool = Pool(extra["pool"])
        variant = TaskVariant(extra["variant"])
    except (KeyError, ValueError) as error:
        raise UsageError(f"{result.folder}: row {result.row.id} does not identify its episode ({error})") from None
    return EpisodeSpec(task=result.task, seed=seed, pool=pool, variant=variant).episode()


def _direct_result(result: EpisodeResult, attempt: "ToleranceAttempt") -> EpisodeResult:
    """Convert a direct execution into the result of a model; `result` is a model's in the same episode."""
    labels = {name: result.row.extra[name] for name in ("seed", "pool", "variant")}
    cause = None if attempt.success else {"verdict": None, "text": attempt.reason}
    row = SampleRow(
        id=result.row.episode,
        video="",
        task=result.task,
        model=DIRECT,
        status=Status.OK,
        reason=None,
        content_hash="",
        extra={**labels, "success": attempt.success, "progress": attempt.progress, "cause": cause},
    )
    return EpisodeResult(part=result.part, model=DIRECT, folder=None, row=row)


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


def ceiling_lines(numbers: Sequence[NumberComparison]) -> Iterator[str]:
    """Format each model's share of the successes of direct execution, all tasks together."""
    for c in numbers:
        if c.task == ALL_TASKS and c.metric.name == "success" and c.difference.n:
            own, ceiling = (c.difference.n * (mean.mean or 0.0) for mean in c.means)
            share = f", {own / ceiling:.1%} of it" if ceiling else ""
            done = f"success in {own:g} of {c.difference.n}, direct execution in {ceiling:g}"
            yield f"{c.first}, {c.part}: {done}{share}"
