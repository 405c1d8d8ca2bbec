"""Runs over many samples into an output folder, as the commands make them."""

import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from os import PathLike
from typing import Any, TypeAlias

from kinebench_drake.errors import KinebenchError, name_arguments
from kinebench_drake.runs import audit, score
from kinebench_drake.runs.audit import AuditConfig
from kinebench_drake.runs.benchmark_registry import load_benchmark
from kinebench_drake.runs.config import ScoreConfig
from kinebench_drake.runs.runner import NullRunObserver, RunObserver, RunSummary

PathName: TypeAlias = str | PathLike[str]


@contextmanager
def own_arguments() -> Iterator[None]:
    """Word the messages of errors for callers of the interface."""
    try:
        yield
    except KinebenchError as error:
        error.args = (name_arguments(str(error)),)
        raise


@own_arguments()
def score_videos(source: PathName, *, out: PathName, observer: RunObserver | None = None, **options: Any) -> RunSummary:
    """Score videos as `kinebench-drake score` does: tracks, kinematic metrics, verdicts, a report.

    A video that cannot be measured raises nothing: it becomes a row with the reason. Finished rows that `out` already
    holds are kept. With `jobs` above 1 a script needs the guard `if __name__ == "__main__":`, as processes are spawned.

    Args:
        source: video, folder of videos or frame folders, dataset, npy, npz or HDF5 file, or manifest (docs/formats.md).
        out: output folder, created if absent.
        observer: receives warnings and progress; None: warnings are Python warnings.
        **options: fields of `ScoreConfig`, which are the options of the command; None for the default.

    Returns:
        All rows of the output folder by id, counts of their statuses, the share that is feasible, the report's path.

    Raises:
        UsageError: an argument, the input or the output folder cannot be used.
        SetupError: something is missing on this machine, or the disk is full. Finished samples are kept.

    Example:
        summary = score_videos("videos", out="results", frame_period_s=0.2)
        for row in summary.rows:
            print(row.id, row.status.value, row.feasible, row.metrics["sparc"])
    """
    options |= {"source": source, "out": out}
    return score.score_videos(ScoreConfig(**_without_none(options)), observer or Warner())


@own_arguments()
def audit_trajectories(
    source: PathName, *, out: PathName, observer: RunObserver | None = None, **options: Any
) -> RunSummary:
    """Judge trajectories as `kinebench-drake audit` does: verdicts, margins, a report.

    `out`, `jobs`, broken samples and the return value are as in `score_videos`.

    Args:
        source: file or dataset of trajectories, a folder of them, or an output folder (docs/formats.md).
        out: output folder, created if absent.
        observer: receives warnings and progress; None: warnings are Python warnings.
        **options: fields of `AuditConfig`, which are the options of the command; None for the default.

    Raises:
        UsageError: an argument, the input or the output folder cannot be used.
        SetupError: something is missing on this machine, or the disk is full. Finished samples are kept.

    Example:
        summary = audit_trajectories("dataset", out="audited", jobs=2)
        print(summary.feasible, [row.id for row in summary.rows if row.feasible is False])
    """
    options |= {"source": source, "out": out}
    return audit.audit_trajectories(AuditConfig(**_without_none(options)), observer or Warner())


@own_arguments()
def run_suite(
    suite: int, *, world_model: str, out: PathName, observer: RunObserver | None = None, **options: Any
) -> RunSummary:
    """Run a world model on a suite in closed loop, as `kinebench-drake suite run` does.

    An episode that fails raises nothing: it becomes a row with the reason. `out` and `jobs` work as in `score_videos`.

    Args:
        suite: number of the suite, 0 to 3.
        world_model: spec of the world model: "oracle", "still", "http://...", "folder:DIR", "module:Class", ...
            (docs/worldmodels.md).
        out: output folder, created if absent.
        observer: receives warnings and progress; None: warnings are Python warnings.
        **options: fields of `SuiteConfig`, which are the options of the command; None for the default.

    Returns:
        All rows of the output folder by id, counts of their statuses, the shares that are feasible and successful, the
        report's path. Its rows have `success`, `progress`, `rounds`, `verdict` and `cause`.

    Raises:
        UsageError: an argument or the output folder cannot be used.
        SetupError: something is missing on this machine, or the disk is full. Finished samples are kept.

    Example:
        summary = run_suite(0, world_model="oracle", tasks=["StackCube-v1"], episodes=2, out="ceiling")
        print(summary.success.mean, [row.verdict for row in summary.rows])
    """
    options |= {"suite": suite, "world_model": world_model, "out": out}
    return load_benchmark().run(_without_none(options), observer or Warner())


class Warner(NullRunObserver):
    """An observer that turns warnings into Python warnings."""

    def warn(self, message: str) -> None:
        """Warn the caller of the interface function."""
        warnings.warn(name_arguments(message), stacklevel=5)


def _without_none(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options that are not None."""
    return {name: value for name, value in options.items() if value is not None}
