"""Cost of whole runs of `score` and `audit` with one and with several processes, start-up apart from the rest.

The settings take turns, so that other load on the machine affects all of them; ratios are of the same turn.
"""

import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import reduce
from pathlib import Path

import numpy as np

from benchmarks import markdown
from benchmarks.feasible import BENCHMARK_FRAMES
from benchmarks.process import ProcessMemory, run_program, spread
from benchmarks.record import machine_text
from benchmarks.trajectory_sets import Recipe, TrajectorySet, write_set
from kinebench_drake.errors import UsageError
from kinebench_drake.results.store import TIMINGS

PROCESSES = (1, 2)
"""Numbers of worker processes that are compared."""
NO_GPU = {"CUDA_VISIBLE_DEVICES": ""}
"""Environment variables of a process that sees no GPU."""


class Job(Enum):
    """Command of the program."""

    SCORE = "score"
    AUDIT = "audit"


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """One way to run a job."""

    job: Job
    processes: int

    def __str__(self) -> str:
        return f"{self.job.value}, {self.processes} process{'es' if self.processes > 1 else ''}"


@dataclass(frozen=True, slots=True, kw_only=True)
class RunCost:
    """Cost of one run."""

    start_up_s: float
    """Time until the first sample begins: interpreter, libraries, robot, input folder [s]."""
    first_s: float
    """Additional time of a process's first sample: networks and meshes are loaded [s]."""
    sample_s: float
    """Time from one finished sample to the next once every process has finished one [s]."""
    peak: ProcessMemory

    @classmethod
    def from_times(
        cls, finished_s: Sequence[float], wall_s: Sequence[float], processes: int, peak: ProcessMemory
    ) -> "RunCost":
        """Separate start-up, first samples and further samples.

        Args:
            finished_s: (N,) times from the start of the program to the end of each sample [s], ascending.
            wall_s: (N,) duration of each sample [s], in the same order.
            processes: number of workers; fewer than samples.
            peak: peak memory.
        """
        first, others = wall_s[:processes], wall_s[processes:]
        return cls(
            start_up_s=finished_s[0] - wall_s[0],
            first_s=float(np.median(first) - np.median(others)),
            sample_s=(finished_s[-1] - finished_s[processes - 1]) / len(others),
            peak=peak,
        )


RunCosts = Mapping[Setting, Sequence[RunCost]]
"""Costs of each setting, one a turn, in the order of the table."""


def measure(video: Path, work: Path, *, videos: int, tracks: int, turns: int, log: Callable[[str], None]) -> RunCosts:
    """Run every setting `turns` times, in turn, without a GPU, in the empty folder `work`.

    A run of `score` has `videos` copies of `video`, one of `audit` `tracks` trajectories.

    Raises:
        UsageError: there are not more samples than processes.
        KinebenchError: a run failed.
    """
    if min(videos, tracks) <= max(PROCESSES):
        raise UsageError(f"{min(videos, tracks)} samples are too few, expected more than {max(PROCESSES)} of each kind")
    inputs = {Job.SCORE: work / "videos", Job.AUDIT: work / "tracks"}
    link_copies(video, [inputs[Job.SCORE] / f"copy-{k:04d}.mp4" for k in range(videos)])
    for _ in write_set(Recipe(set=TrajectorySet.FEASIBLE, seed=0), tracks, inputs[Job.AUDIT]):
        pass
    settings = (Setting(job=job, processes=n) for job in Job for n in PROCESSES)
    costs: dict[Setting, list[RunCost]] = {setting: [] for setting in settings}
    for turn in range(turns):
        for setting, runs in costs.items():
            log(f"turn {turn + 1} of {turns}: {setting}")
            runs.append(run_cost(setting, inputs[setting.job], work / "out", NO_GPU))
    return costs


def link_copies(video: Path, paths: Sequence[Path]) -> None:
    """Copy one file to the first path and hard-link the others to it."""
    first, *others = paths
    first.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(video, first)
    for path in others:
        os.link(first, path)


def run_cost(setting: Setting, source: Path, out: Path, environment: Mapping[str, str]) -> RunCost:
    """Run one setting on a folder of samples, more than processes, with additional environment variables.

    Raises:
        KinebenchError: the run failed.
    """
    options = ["--frame-period", "0.2"] if setting.job is Job.SCORE else []
    arguments = [setting.job.value, str(source), "--out", str(out), "--jobs", str(setting.processes), *options]
    run = run_program([*arguments, "--overwrite"], environment=environment)
    wall_s = [json.loads(line)["wall_s"] for line in (out / TIMINGS).read_text().splitlines()]
    return RunCost.from_times(run.finished_s, wall_s, setting.processes, run.peak)


def figures(costs: RunCosts) -> dict[str, float]:
    """Return the medians of each setting."""
    units = {"start-up, s": "start_up_s", "first sample, s": "first_s", "s a sample": "sample_s"}
    return {
        f"{setting}: {name}": float(np.median([getattr(run, key) for run in runs]))
        for setting, runs in costs.items()
        for name, key in units.items()
    }


def section(costs: RunCosts, *, videos: int, tracks: int) -> str:
    """Return the section of the document."""
    turns = len(next(iter(costs.values())))
    head = (
        *("run", "start-up and first sample, s", "s a sample"),
        *("times one process", "memory, MB"),
    )
    return markdown.section(
        "Whole runs",
        f"`python -m benchmarks throughput` on {machine_text()}: wall times, median (minimum to maximum) of {turns} "
        f"turns. `score`: {videos} copies of a video of 384x384. `audit`: {tracks} trajectories of about "
        f"{BENCHMARK_FRAMES} frames. Start-up and the first sample's additional time are paid once a process. One "
        "process of `score` uses more than one core. Memory: peak of the main process and of each worker.",
        markdown.table(head, _rows(costs)),
    )


def _rows(costs: RunCosts) -> Iterator[list[str]]:
    for setting, runs in costs.items():
        sample_s = np.array([run.sample_s for run in runs])
        single = [run.sample_s for run in costs[Setting(job=setting.job, processes=1)]]
        peak = reduce(ProcessMemory.maximum, (run.peak for run in runs))
        yield [
            str(setting),
            f"{np.median([run.start_up_s for run in runs]):.1f} + {np.median([run.first_s for run in runs]):.1f}",
            spread(sample_s, 2),
            spread(np.array(single) / sample_s, 2),
            " + ".join(f"{mb:.0f}" for mb in (peak.main_mb, *peak.workers_mb)),
        ]
