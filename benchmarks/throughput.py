"""What whole runs of `score` and `audit` cost with one process and with several, start-up apart from the rest.

The settings take turns, so that whatever else the machine does meets them all; ratios are of the same turn.
"""

import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np

from benchmarks.feasible import BENCHMARK_FRAMES
from benchmarks.markdown import table
from benchmarks.tracks import Recipe, Set, make
from benchmarks.watched import Memory, watch
from kinebench_drake.errors import UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.results.provenance import host
from kinebench_drake.results.store import TIMINGS

HEADING = "## Whole runs"
"""Heading of the section that is written into the document."""
PROCESSES = (1, 2)
"""Numbers of worker processes that are compared."""
_NO_GPU = {"CUDA_VISIBLE_DEVICES": ""}


class Job(Enum):
    """What is run."""

    SCORE = "score"
    AUDIT = "audit"


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """A way to run a job."""

    job: Job
    processes: int
    gpu: bool = False
    """Whether the networks compute on a GPU."""

    def __str__(self) -> str:
        gpu = " on the GPU" if self.gpu else ""
        return f"{self.job.value}, {self.processes} process{'es' if self.processes > 1 else ''}{gpu}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Turn:
    """What one run cost."""

    begins_s: float
    """Until the first sample is begun: interpreter, libraries, robot, input folder [s]."""
    first_s: float
    """How much longer a process takes over its first sample than over others: networks and meshes are loaded [s]."""
    sample_s: float
    """Time from one finished sample to the next once every process has finished one [s]."""
    peak: Memory

    @classmethod
    def read(cls, finished_s: Sequence[float], took_s: Sequence[float], processes: int, peak: Memory) -> "Turn":
        """Take a run apart.

        Args:
            finished_s: (N,) when each sample was finished since the program was started [s], in that order.
            took_s: (N,) how long each took [s], in the same order.
            processes: how many worked; fewer than there are samples.
            peak: the most memory that each held.
        """
        first, others = took_s[:processes], took_s[processes:]
        return cls(
            begins_s=finished_s[0] - took_s[0],
            first_s=float(np.median(first) - np.median(others)),
            sample_s=(finished_s[-1] - finished_s[processes - 1]) / len(others),
            peak=peak,
        )


Throughput = Mapping[Setting, Sequence[Turn]]
"""Each setting with its turns, in the order of the table."""


def settings(gpu: bool) -> list[Setting]:
    """All ways that are compared."""
    scores = [Setting(job=Job.SCORE, processes=n) for n in PROCESSES]
    on_gpu = [Setting(job=Job.SCORE, processes=n, gpu=True) for n in PROCESSES] if gpu else []
    return [*scores, *on_gpu, *(Setting(job=Job.AUDIT, processes=n) for n in PROCESSES)]


def measure(
    video: Path, work: Path, *, videos: int, tracks: int, turns: int, gpu: bool, note: Callable[[str], None]
) -> Throughput:
    """Run every setting `turns` times, in turn.

    Args:
        video: the video whose copies are scored.
        work: empty folder for input and results.
        videos: copies of the video in a run.
        tracks: trajectories in an audit.
        turns: how often everything is run.
        gpu: whether there is a GPU to compare.
        note: told what is done.

    Raises:
        UsageError: there are not more samples than processes.
        KinebenchError: a run failed.
    """
    if min(videos, tracks) <= max(PROCESSES):
        raise UsageError(f"{min(videos, tracks)} samples are too few, expected more than {max(PROCESSES)} of each kind")
    inputs = {Job.SCORE: work / "videos", Job.AUDIT: work / "tracks"}
    copies(video, [inputs[Job.SCORE] / f"copy-{k:04d}.mp4" for k in range(videos)])
    for _ in make(Recipe(set=Set.FEASIBLE, seed=0), tracks, inputs[Job.AUDIT]):
        pass
    found: dict[Setting, list[Turn]] = {setting: [] for setting in settings(gpu)}
    for turn in range(turns):
        for setting, done in found.items():
            note(f"turn {turn + 1} of {turns}: {setting}")
            done.append(_run(setting, inputs[setting.job], work / "out"))
    return found


def copies(video: Path, names: Sequence[Path]) -> None:
    """Put one file in a folder under several names: one copy, and links to it."""
    first, *others = names
    first.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(video, first)
    for name in others:
        os.link(first, name)


def _run(setting: Setting, source: Path, out: Path) -> Turn:
    options = ["--frame-period", "0.2"] if setting.job is Job.SCORE else []
    arguments = [setting.job.value, str(source), "--out", str(out), "--jobs", str(setting.processes), *options]
    run = watch([*arguments, "--overwrite"], environment=None if setting.gpu else _NO_GPU)
    took_s = [json.loads(line)["wall_s"] for line in (out / TIMINGS).read_text().splitlines()]
    return Turn.read(run.finished_s, took_s, setting.processes, run.peak)


def section(found: Throughput, *, videos: int, tracks: int) -> str:
    """The document's section."""
    machine = host()
    turns = len(next(iter(found.values())))
    head = (
        *("run", "until the first is begun, s", "the first longer by, s", "s a sample", "samples an hour"),
        *("times one process", "memory, MB"),
    )
    return "\n".join(
        [
            HEADING,
            "",
            f"Written by `python -m benchmarks throughput` on {machine['cpu']} ({machine['cores']} "
            f"cores); wall times of the real program, median (least to most) of {turns} turns. `score`: {videos} "
            f"copies of a rendered video of 384x384; `audit`: {tracks} trajectories of about {BENCHMARK_FRAMES} "
            "frames. Paid once a process: the time until its first sample is begun (interpreter, libraries, robot) "
            "and what the first takes longer than the others (networks and meshes are loaded, and kept). A sample: "
            "from one finished to the next, once every process has finished one. Times one process: samples an hour "
            "beside those of one process in the same turn; one process of `score` takes more than a core, as the "
            "networks look at frames while those before are fitted. Memory: the most that was resident, libraries "
            "included, of the process started and of each of its workers.",
            "",
            *table(head, _rows(found)),
            "",
        ]
    )


def _rows(found: Throughput) -> Iterator[list[str]]:
    for setting, turns in found.items():
        sample_s = np.array([turn.sample_s for turn in turns])
        single = [turn.sample_s for turn in found[Setting(job=setting.job, processes=1)]]
        peak = turns[0].peak
        for turn in turns[1:]:
            peak = peak.joined(turn.peak)
        yield [
            str(setting),
            spread(np.array([turn.begins_s for turn in turns]), 1),
            spread(np.array([turn.first_s for turn in turns]), 1),
            spread(sample_s, 2),
            f"{3600.0 / np.median(sample_s):.0f}",
            spread(np.array(single) / sample_s, 2),
            " + ".join(f"{mb:.0f}" for mb in (peak.main_mb, *peak.workers_mb)),
        ]


def spread(values: Array, digits: int) -> str:
    """Median, least and most."""
    return f"{np.median(values):z.{digits}f} ({values.min():z.{digits}f} to {values.max():z.{digits}f})"
