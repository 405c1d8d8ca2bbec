"""Cost of whole runs of `score` and `audit` with one and with several processes, start-up apart from the rest.

The settings take turns, so that other load on the machine affects all of them; ratios are of the same turn.
"""

import hashlib
import json
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
from kinebench_drake.environment.precision import PRECISION_VARIABLE, Precision
from kinebench_drake.errors import KinebenchError, UsageError, count_noun
from kinebench_drake.geometry import Array
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import TIMINGS, read_rows

PROCESSES = (1, 2)
"""Numbers of worker processes that are compared."""
LEAST_VIDEOS = 24
"""Different videos that a measurement needs: times differ from video to video."""
NO_GPU = {"CUDA_VISIBLE_DEVICES": ""}
"""Environment variables of a process that sees no GPU."""
TAIL = 95.0
"""Percentile of the seconds a video that stands for the slow ones."""


class Job(Enum):
    """Command of the program."""

    SCORE = "score"
    AUDIT = "audit"


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """One way to run a job."""

    job: Job
    processes: int
    precision: Precision | None = None
    """Precision of the networks; None: chosen by the program."""

    @property
    def environment(self) -> Mapping[str, str]:
        """Environment variables of its process."""
        return {PRECISION_VARIABLE: self.precision.value} if self.precision else {}

    def __str__(self) -> str:
        precision = f" in {self.precision.value}" if self.precision else ""
        return f"{self.job.value}{precision}, {self.processes} process{'es' if self.processes > 1 else ''}"


SETTINGS = (
    *(Setting(job=Job.SCORE, processes=n, precision=precision) for precision in Precision for n in PROCESSES),
    *(Setting(job=Job.AUDIT, processes=n) for n in PROCESSES),
)
"""Settings that are measured, in the order of the table."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunCost:
    """Cost of one run; the first sample of each process belongs to the start-up, which loads networks and meshes."""

    start_up_s: float
    """Time until every process has finished its first sample [s]."""
    wall_s: Array
    """Duration of each further sample in its process [s], in the order in which they finish."""
    sample_s: float
    """Time from one finished sample to the next after the start-up [s]."""
    peak: ProcessMemory

    @classmethod
    def from_samples(cls, samples: Sequence["FinishedSample"], processes: int, peak: ProcessMemory) -> "RunCost":
        """Separate start-up and further samples.

        Args:
            samples: samples in the order in which they finished; those that could not be read do not count.
            processes: number of workers.
            peak: peak memory.

        Raises:
            KinebenchError: there are no more samples than workers.
        """
        measured = [sample for sample in samples if sample.status is not Status.ERROR]
        if len(measured) <= processes:
            readable = f"{len(measured)} of {len(samples)} samples could be read"
            raise KinebenchError(f"{readable}, expected more than {processes}")
        start_up_s = measured[processes - 1].finished_s
        further = measured[processes:]
        return cls(
            start_up_s=start_up_s,
            wall_s=np.array([sample.wall_s for sample in further]),
            sample_s=(further[-1].finished_s - start_up_s) / len(further),
            peak=peak,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class FinishedSample:
    """A sample of a run."""

    finished_s: float
    """Time from the start of the program to the end of the sample [s]."""
    wall_s: float
    """Duration of the sample in its process [s]."""
    status: Status


RunCosts = Mapping[Setting, Sequence[RunCost]]
"""Costs of each setting, one a turn, in the order of the table."""


def measure(videos: Path, work: Path, *, tracks: int, turns: int, log: Callable[[str], None]) -> RunCosts:
    """Run every setting `turns` times, in turn, without a GPU, in the folder `work`.

    Args:
        videos: output folder of `suite demos`; its videos are scored.
        work: folder for trajectories and results.
        tracks: trajectories of a run of `audit`.
        turns: runs of each setting.
        log: called with each step.

    Raises:
        UsageError: there are too few different videos.
        KinebenchError: a run failed.
    """
    different = len({hashlib.sha256(path.read_bytes()).digest() for path in videos.glob("*.mp4")})
    if different < LEAST_VIDEOS:
        counted = count_noun(different, "different video")
        raise UsageError(f"{videos}: holds {counted}, expected {LEAST_VIDEOS} or more")
    inputs = {Job.SCORE: videos, Job.AUDIT: work / "tracks"}
    for _ in write_set(Recipe(set=TrajectorySet.FEASIBLE, seed=0), tracks, inputs[Job.AUDIT]):
        pass
    costs: dict[Setting, list[RunCost]] = {setting: [] for setting in SETTINGS}
    for turn in range(turns):
        for setting, runs in costs.items():
            log(f"turn {turn + 1} of {turns}: {setting}")
            runs.append(run_cost(setting, inputs[setting.job], work / "out"))
    return costs


def run_cost(setting: Setting, source: Path, out: Path) -> RunCost:
    """Run one setting on a folder of samples, more than processes, without a GPU.

    Raises:
        KinebenchError: the run failed, or few samples could be read.
    """
    options = ["--frame-period", "0.2"] if setting.job is Job.SCORE else []
    arguments = [setting.job.value, str(source), "--out", str(out), "--jobs", str(setting.processes), *options]
    run = run_program([*arguments, "--overwrite"], environment={**NO_GPU, **setting.environment})
    rows = read_rows(out)
    timings = [json.loads(line) for line in (out / TIMINGS).read_text().splitlines()]
    samples = [
        FinishedSample(finished_s=end_s, wall_s=timing["wall_s"], status=rows[timing["id"]].status)
        for end_s, timing in zip(run.finished_s, timings, strict=True)
    ]
    return RunCost.from_samples(samples, setting.processes, run.peak)


def video_seconds(costs: RunCosts) -> dict[Setting, Array]:
    """Return the seconds of each video in the only worker, the median of the turns, by setting of `score`."""
    return {
        setting: np.median([run.wall_s for run in runs], axis=0)
        for setting, runs in costs.items()
        if setting.job is Job.SCORE and setting.processes == 1
    }


def summarize_seconds(seconds: Array) -> dict[str, float]:
    """Return mean, median, 95th percentile, maximum, and the mean relative to that of the faster half."""
    faster = np.sort(seconds)[: len(seconds) // 2]
    return {
        "mean": float(np.mean(seconds)),
        "median": float(np.median(seconds)),
        f"{TAIL:.0f}th percentile": float(np.percentile(seconds, TAIL)),
        "maximum": float(np.max(seconds)),
        "mean / mean of the faster half": float(np.mean(seconds) / np.mean(faster)),
    }


def figures(costs: RunCosts) -> dict[str, float]:
    """Return the medians of each setting, and what the seconds of the videos come to."""
    medians = {
        f"{setting}: {name}": float(np.median([getattr(run, key) for run in runs]))
        for setting, runs in costs.items()
        for name, key in (("start-up, s", "start_up_s"), ("s a sample", "sample_s"))
    }
    videos = {
        f"{setting}, s a video: {name}": value
        for setting, seconds in video_seconds(costs).items()
        for name, value in summarize_seconds(seconds).items()
    }
    return medians | videos


def section(costs: RunCosts, *, tracks: int) -> str:
    """Return the section of the document."""
    turns = len(next(iter(costs.values())))
    seconds = {setting: summarize_seconds(values) for setting, values in video_seconds(costs).items()}
    videos = 1 + len(next(iter(video_seconds(costs).values())))
    return markdown.section(
        "Whole runs",
        f"`python -m benchmarks throughput` on {machine_text()}: wall times, median (minimum to maximum) of "
        f"{count_noun(turns, 'turn')}. `score`: {videos} different held-out renderings of 384x384. `audit`: {tracks} "
        f"trajectories of about {BENCHMARK_FRAMES} frames. Start-up ends when each process has finished its first "
        "sample. One process of `score` uses more than one core. Memory: peak of the main process and of each worker.",
        markdown.table(("run", "start-up, s", "s a sample", "times one process", "memory, MB"), _rows(costs)),
        "Seconds a video after the start-up, in the only worker, each the median of the turns:",
        markdown.table(
            ("run", *next(iter(seconds.values()))),
            ([str(setting), *(f"{value:.2f}" for value in row.values())] for setting, row in seconds.items()),
        ),
    )


def _rows(costs: RunCosts) -> Iterator[list[str]]:
    for setting, runs in costs.items():
        sample_s = np.array([run.sample_s for run in runs])
        single = [run.sample_s for run in costs[Setting(job=setting.job, processes=1, precision=setting.precision)]]
        peak = reduce(ProcessMemory.maximum, (run.peak for run in runs))
        yield [
            str(setting),
            f"{np.median([run.start_up_s for run in runs]):.1f}",
            spread(sample_s, 2),
            spread(np.array(single) / sample_s, 2),
            " + ".join(f"{mb:.0f}" for mb in (peak.main_mb, *peak.workers_mb)),
        ]
