"""What a run over very many samples holds in memory while it goes on, and what its report and a second run cost."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import cycle, islice
from pathlib import Path

import numpy as np

from benchmarks.markdown import table
from benchmarks.watched import Memory, watch
from kinebench_drake.errors import UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.io.container import write_video
from kinebench_drake.io.reader import read_video
from kinebench_drake.results.provenance import host
from kinebench_drake.results.store import REPORT, SAMPLES

HEADING = "## Memory over many samples"
"""Heading of the section that is written into the document."""
STEP = 20
"""Memory is noted each time that so many more samples are finished."""
SETTLED = 0.25
"""Share of the samples after which growth is told: before, caches fill."""
_SHOWN = (0.05, 0.25, 0.5, 0.75, 0.99, 1.0)  # parts of a run that the table shows; at the very end workers are gone


@dataclass(frozen=True, slots=True, kw_only=True)
class Streaming:
    """What one long run came to."""

    samples: int
    frames: int
    """Of each video."""
    jobs: int
    wall_s: float
    memory: Mapping[int, Memory]
    """What was resident when so many samples were finished."""
    peak: Memory
    rows_mb: float
    """Size of samples.jsonl [MB]."""
    report_mb: float
    """Size of report.html [MB]."""
    report_s: float
    """Time of `kinebench-drake report` [s]."""
    again_s: float
    """Time of the same run once more, all of it finished [s]."""


def cut(videos: Path, out: Path, count: int, frames: int) -> None:
    """Fill a folder with short videos: pieces of a folder's videos, each under several names where they are too few.

    Raises:
        UsageError: there is no piece of that length.
    """
    out.mkdir(parents=True)
    pieces = []
    for path in sorted(videos.glob("*.mp4")):
        film = read_video(path)
        for start in range(0, len(film.frames) - frames + 1, frames):
            pieces.append(out / f"{path.stem}-{start:03d}.mp4")
            write_video(pieces[-1], film.frames[start : start + frames], film.fps or 1.0)
            if len(pieces) == count:
                return
    if not pieces:
        raise UsageError(f"{videos}: holds no mp4 of {frames} frames or more")
    for k, piece in enumerate(islice(cycle(pieces), count - len(pieces))):
        os.link(piece, out / f"{piece.stem}-{k:05d}.mp4")


def measure(
    videos: Path, work: Path, *, samples: int, frames: int, jobs: int, note: Callable[[str], None]
) -> Streaming:
    """Score very many short videos.

    Args:
        videos: folder of the mp4 that they are cut out of.
        work: folder for input and results, in which there is neither yet.
        samples: how many.
        frames: frames of each.
        jobs: worker processes.
        note: told what is done.

    Raises:
        UsageError: nothing can be cut out of the videos.
        KinebenchError: the run failed.
    """
    source, out = work / "videos", work / "results"
    cut(videos, source, samples, frames)
    arguments = ["score", str(source), "--out", str(out), "--jobs", str(jobs), "--frame-period", "0.2"]

    def tell(finished: int) -> None:
        if finished % 100 == 0:
            note(f"{finished} of {samples}")

    run = watch(arguments, reads=lambda finished: finished % STEP == 0, finished=tell)
    note("the report")
    report_s = watch(["report", str(out)]).wall_s
    note("the same run once more")
    return Streaming(
        samples=samples,
        frames=frames,
        jobs=jobs,
        wall_s=run.wall_s,
        memory=run.memory,
        peak=run.peak,
        rows_mb=(out / SAMPLES).stat().st_size / 2**20,
        report_mb=(out / REPORT).stat().st_size / 2**20,
        report_s=report_s,
        again_s=watch(arguments).wall_s,
    )


def growth(memory: Mapping[int, Memory], after: float) -> tuple[float, Array]:
    """Growth of the main process and of each worker (W,) [MB per 1,000 samples], by a straight line of least squares.

    Readings do not count for which a worker has gone home already, there being nothing left to do.

    Args:
        memory: what was held when so many samples were finished; two readings beyond `after` at least.
        after: number of samples from which on readings count.
    """
    crew = _crew(memory)
    counts = [count for count, held in sorted(memory.items()) if count >= after and len(held.workers_mb) == crew]
    values = np.array([[memory[count].main_mb, *memory[count].workers_mb] for count in counts])
    slopes = np.polyfit(np.array(counts) / 1000.0, values, 1)[0]
    return float(slopes[0]), np.asarray(slopes[1:])


def _crew(memory: Mapping[int, Memory]) -> int:
    """How many workers there were."""
    return max(len(held.workers_mb) for held in memory.values())


def section(found: Streaming) -> str:
    """The document's section."""
    machine = host()
    shown = [min(found.memory, key=lambda count: abs(count - part * found.samples)) for part in _SHOWN]
    main, workers = growth(found.memory, SETTLED * found.samples)
    rows = []
    for count in dict.fromkeys(shown):
        held = [f"{mb:.0f}" for mb in (found.memory[count].main_mb, *found.memory[count].workers_mb)]
        rows.append([f"{count}", *(held if len(held) == 1 + len(workers) else (held[0], *["gone"] * len(workers)))])
    return "\n".join(
        [
            HEADING,
            "",
            f"Written by `python -m benchmarks streaming` on {machine['cpu']} ({machine['cores']} "
            f"cores): `score` of {found.samples} videos of {found.frames} frames with `--jobs {found.jobs}`. Resident "
            "memory when so many samples were finished, libraries included [MB].",
            "",
            *table(("samples", "main process", *(f"worker {k + 1}" for k in range(len(workers)))), rows),
            "",
            f"Growth per 1,000 samples, of a straight line through the readings every {STEP} samples after the first "
            f"{SETTLED * found.samples:.0f}: main process {main:z.1f} MB (it holds the rows, "
            f"{found.rows_mb:.1f} MB of JSON in the end)"
            + (f", workers {' and '.join(f'{mb:z.1f} MB' for mb in workers)}" if len(workers) else "")
            + f". The most that the main process held, report included: {found.peak.main_mb:.0f} MB. `report.html`: "
            f"{found.report_mb:.1f} MB, written anew in {found.report_s:.1f} s (start of the program included). The "
            f"same run once more, when all is finished: {found.again_s:.1f} s.",
            "",
        ]
    )
