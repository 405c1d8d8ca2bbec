"""Memory of a run over very many samples, size and time of its report, and time of a second run."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from itertools import cycle, islice
from pathlib import Path

import numpy as np

from benchmarks import markdown
from benchmarks.process import ProcessRun, run_program
from benchmarks.record import machine_text
from kinebench_drake.errors import UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.io.container import write_video
from kinebench_drake.io.reader import read_video
from kinebench_drake.results.store import REPORT, SAMPLES

STEP = 20
"""Memory is recorded each time that so many more samples are finished."""
SETTLED = 0.25
"""Share of the samples after which growth is measured: before, caches fill."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamingResult:
    """Measurements of one long run."""

    samples: int
    frames: int
    """Frames of each video."""
    jobs: int
    run: ProcessRun
    rows_mb: float
    """Size of samples.jsonl [MB]."""
    report_mb: float
    """Size of report.html [MB]."""
    report_s: float
    """Time of `kinebench-drake report` [s]."""
    again_s: float
    """Time of the same run once more, with all samples finished [s]."""


def cut_videos(videos: Path, out: Path, count: int, frames: int) -> None:
    """Fill a folder with short videos: pieces of a folder's videos, hard-linked under several names if too few.

    Raises:
        UsageError: there is no piece of that length.
    """
    out.mkdir(parents=True)
    pieces = []
    for path in sorted(videos.glob("*.mp4")):
        video = read_video(path)
        for start in range(0, len(video.frames) - frames + 1, frames):
            pieces.append(out / f"{path.stem}-{start:03d}.mp4")
            write_video(pieces[-1], video.frames[start : start + frames], video.fps or 1.0)
            if len(pieces) == count:
                return
    if not pieces:
        raise UsageError(f"{videos}: holds no mp4 of {frames} frames or more")
    for k, piece in enumerate(islice(cycle(pieces), count - len(pieces))):
        os.link(piece, out / f"{piece.stem}-{k:05d}.mp4")


def measure(
    videos: Path, work: Path, *, samples: int, frames: int, jobs: int, log: Callable[[str], None]
) -> StreamingResult:
    """Score very many short videos, cut from a folder's, in the folder `work`, which must hold none yet.

    Raises:
        UsageError: nothing can be cut from the videos.
        KinebenchError: the run failed.
    """
    source = work / "videos"
    out = work / "results"
    cut_videos(videos, source, samples, frames)
    arguments = ["score", str(source), "--out", str(out), "--jobs", str(jobs), "--frame-period", "0.2"]
    run = run_program(
        arguments,
        reads_memory=lambda finished: finished % STEP == 0,
        on_finished=lambda finished: None if finished % 100 else log(f"{finished} of {samples}"),
    )
    log("the report")
    report_s = run_program(["report", str(out)]).wall_s
    log("the same run once more")
    return StreamingResult(
        samples=samples,
        frames=frames,
        jobs=jobs,
        run=run,
        rows_mb=(out / SAMPLES).stat().st_size / 2**20,
        report_mb=(out / REPORT).stat().st_size / 2**20,
        report_s=report_s,
        again_s=run_program(arguments).wall_s,
    )


def growth(run: ProcessRun, after: float) -> tuple[float, Array]:
    """Fit the growth of the main process and of each worker (W,) [MB per 1,000 samples] by a straight line.

    Readings after a worker has left, there being no more work, are not used.

    Args:
        run: with two memory readings beyond `after` at least.
        after: number of finished samples from which on readings are used.
    """
    workers = worker_count(run)
    counts = [n for n, memory in sorted(run.memory.items()) if n >= after and len(memory.workers_mb) == workers]
    values = np.array([[run.memory[n].main_mb, *run.memory[n].workers_mb] for n in counts])
    slopes = np.polyfit(np.array(counts) / 1000.0, values, 1)[0]
    return float(slopes[0]), np.asarray(slopes[1:])


def worker_count(run: ProcessRun) -> int:
    """Return the number of workers that a run had."""
    return max(len(memory.workers_mb) for memory in run.memory.values())


def figures(result: StreamingResult) -> dict[str, float]:
    """Return growth and peak of the main process, size and times of report and second run."""
    return {
        "main process, MB per 1,000 samples": growth(result.run, SETTLED * result.samples)[0],
        "peak of the main process, MB": result.run.peak.main_mb,
        "report.html, MB": result.report_mb,
        "report, s": result.report_s,
        "second run, s": result.again_s,
    }


def section(result: StreamingResult) -> str:
    """Return the section of the document."""
    main, workers = growth(result.run, SETTLED * result.samples)
    last = result.run.memory[max(result.run.memory)]
    return markdown.section(
        "Memory over many samples",
        f"`python -m benchmarks streaming` on {machine_text()}: `score` of {result.samples} videos of {result.frames} "
        f"frames with `--jobs {result.jobs}`. In the end the main process holds {last.main_mb:.0f} MB.",
        f"Growth per 1,000 samples after the first {SETTLED * result.samples:.0f}: main process {main:z.1f} MB"
        + (f", workers {' and '.join(f'{mb:z.1f} MB' for mb in workers)}" if len(workers) else "")
        + f". Peak of the main process, report included: {result.run.peak.main_mb:.0f} MB. `report.html` has "
        f"{result.report_mb:.1f} MB and is written again in {result.report_s:.1f} s. The same run once more takes "
        f"{result.again_s:.1f} s.",
    )
