"""Registry of the benchmark: what commands that meet its runs and rows need of `suites`, which is loaded by name."""

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, cast

from kinebench_drake.plugin import BENCHMARK

if TYPE_CHECKING:  # `doctor` must answer where numerical libraries are damaged
    import click

    from kinebench_drake.environment.doctor import Check
    from kinebench_drake.geometry import Array
    from kinebench_drake.report.leaderboard import Ranking
    from kinebench_drake.report.number import ModelComparison
    from kinebench_drake.results.row import SampleRow
    from kinebench_drake.runs.runner import RunObserver, RunSummary


@dataclass(frozen=True, slots=True, kw_only=True)
class Benchmark:
    """Functions of the benchmark by which other parts of the program handle its runs and rows."""

    commands: "Callable[[], click.Group]"
    """Returns the command group `suite`."""
    run: "Callable[[Mapping[str, object], RunObserver], RunSummary]"
    """Runs a suite with the options of `suite run`."""
    check: "Callable[[], Check]"
    """Checks whether this machine can render scenes."""
    start_q: "Callable[[str, int], Array | None]"
    """Returns the joint positions (9,) at the start of the episode of a task and a seed: seven of the arm [rad], two of
    the fingers [m]; None for a task that is not one of the benchmark."""
    compare: "Callable[[Sequence[Path]], ModelComparison]"
    """Compares the models of suite runs."""
    rank: "Callable[[Sequence[Path]], Ranking]"
    """Returns the models of suite runs with the tables of a leaderboard."""
    list_files: "Callable[[Path, Mapping[str, SampleRow]], Mapping[str, Sequence[Path]]]"
    """Lists the files besides artifacts in an output folder, by the id of their episode."""
    write_requests: Callable[[Path, Sequence[Mapping[str, object]]], None]
    """Writes to an output folder the manifest of the videos that episodes wait for."""


def load_benchmark() -> Benchmark:
    """Load the functions of the benchmark."""
    return cast(Benchmark, importlib.import_module(BENCHMARK).BENCHMARK)
