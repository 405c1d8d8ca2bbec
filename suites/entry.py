"""Functions of the benchmark in the registry through which other parts of the program reach it; each loads its own."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kinebench_drake.runs.benchmark_registry import Benchmark

if TYPE_CHECKING:
    import click

    from kinebench_drake.environment.doctor import Check
    from kinebench_drake.geometry import Array
    from kinebench_drake.report.leaderboard import Ranking
    from kinebench_drake.report.number import ModelComparison
    from kinebench_drake.results.row import SampleRow
    from kinebench_drake.runs.runner import RunObserver, RunSummary


def _commands() -> "click.Group":
    from kinebench_drake.suites.commands.suite import suite

    return suite


def _run(options: Mapping[str, Any], observer: "RunObserver") -> "RunSummary":
    from kinebench_drake.suites.runs.episodes import run_suite
    from kinebench_drake.suites.runs.suite_config import SuiteConfig

    return run_suite(SuiteConfig(**options), observer)


def _check() -> "Check":
    from kinebench_drake.suites.vulkan import check_vulkan

    return check_vulkan()


def _start_q(task: str, seed: int) -> "Array | None":
    from kinebench_drake.suites.start import START_WIDTH_M, start_q

    return start_q(task, seed) if task in START_WIDTH_M else None


def _compare(folders: Sequence[Path]) -> "ModelComparison":
    from kinebench_drake.suites.report.comparison import read_comparison

    return read_comparison(folders)


def _rank(folders: Sequence[Path]) -> "Ranking":
    from kinebench_drake.suites.report.ranking import rank_models

    return rank_models(folders)


def _list_files(out: Path, rows: "Mapping[str, SampleRow]") -> dict[str, list[Path]]:
    from kinebench_drake.suites.runs.requests import list_files

    return list_files(out, rows)


def _write_requests(out: Path, requests: Sequence[Mapping[str, object]]) -> None:
    from kinebench_drake.suites.runs.requests import write_requests

    write_requests(out, requests)


BENCHMARK = Benchmark(
    commands=_commands,
    run=_run,
    check=_check,
    start_q=_start_q,
    compare=_compare,
    rank=_rank,
    list_files=_list_files,
    write_requests=_write_requests,
)
