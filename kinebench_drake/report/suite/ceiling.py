"""Runs beside the direct execution of the expert's own true track in the same episodes: each task's ceiling."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from kinebench_drake.closed_loop.tolerance import ToleranceAttempt, run_attempts
from kinebench_drake.errors import UsageError
from kinebench_drake.executors.base import Executor
from kinebench_drake.executors.progress import Observer
from kinebench_drake.report.suite.comparison import ALL, Compared, compare, comparison_table
from kinebench_drake.report.suite.episode import EpisodeResult
from kinebench_drake.report.suite.folders import gather, models_of, read_folders
from kinebench_drake.report.suite.writing import ModelComparison
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.suites.split import Pool
from kinebench_drake.suites.suite import EpisodeSpec
from kinebench_drake.suites.tasks.card import TaskVariant

DIRECT = "expert's true track"
"""Stands for direct execution in the place of a model's name."""


def read_ceiling(paths: Sequence[Path], engine: Executor, observer: Observer, seed: int = 0) -> ModelComparison:
    """Execute the expert's true track in every episode of some suite runs, and compare each model with it.

    Args:
        paths: output folders of `suite run`.
        engine: where episodes are executed.
        observer: receiver of progress reports.
        seed: of the intervals' resampling.

    Raises:
        UsageError: the folders cannot be used or put together, or a row does not tell its episode.
        KinebenchError: a worker died.
    """
    folders = read_folders(paths)
    episodes = gather(folders)
    if DIRECT in models_of(episodes):
        raise UsageError(f"a model is called {DIRECT!r}, as direct execution is; give it another name")
    draws = {e.key: _draw(e) for e in episodes}
    attempts = run_attempts(engine, [draw.episode() for draw in dict.fromkeys(draws.values())], (), observer)
    attempt_of = {attempt.episode.id: attempt for attempt in attempts}
    once = {e.key: e for e in episodes}
    direct = [_direct(e, attempt_of[draws[key].id]) for key, e in once.items()]
    compared = [c for c in compare([*episodes, *direct], seed) if c.second == DIRECT]
    return ModelComparison(
        folders=tuple(folders),
        episodes=(*episodes, *direct),
        compared=tuple(compared),
        table=comparison_table(compared),
    )


def share_lines(compared: Sequence[Compared]) -> Iterator[str]:
    """What part of the ceiling each model reaches, all tasks together, to print."""
    for c in compared:
        if c.task == ALL and c.paired is not None:
            own, most = c.paired.both + c.paired.first_only, c.paired.both + c.paired.second_only
            share = f", {own / most:.1%} of it" if most else ""
            yield f"{c.first}, {c.part.title}: success in {own} of {c.paired.n}, direct execution in {most}{share}"


def _draw(episode: EpisodeResult) -> EpisodeSpec:
    extra = episode.row.extra
    try:
        seed, pool, variant = int(str(extra["seed"])), Pool(extra["pool"]), TaskVariant(extra["variant"])
    except (KeyError, ValueError) as error:
        raise UsageError(f"{episode.folder}: row {episode.row.id} does not tell its episode ({error})") from None
    return EpisodeSpec(task=episode.task, seed=seed, pool=pool, variant=variant)


def _direct(episode: EpisodeResult, attempt: ToleranceAttempt) -> EpisodeResult:
    """An execution as an episode of a model; `episode` is one that a model did."""
    known = {name: episode.row.extra[name] for name in ("seed", "pool", "variant")}
    cause = None if attempt.success else {"verdict": None, "text": attempt.reason}
    row = SampleRow(
        id=episode.row.id,
        video="",
        task=episode.task,
        model=DIRECT,
        status=Status.OK,
        reason=None,
        content_hash="",
        extra={**known, "success": attempt.success, "progress": attempt.progress, "cause": cause},
    )
    return EpisodeResult(part=episode.part, model=DIRECT, folder=None, row=row)
