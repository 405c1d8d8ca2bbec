"""Runs that are killed, or interrupted, at moments drawn at random and begun again: what comes of them in the end."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np
from numpy.random import Generator

from kinebench_drake.errors import InputError, KinebenchError
from kinebench_drake.grounding.video import read_video
from kinebench_drake.mp4 import write_video
from kinebench_drake.results import RUN, TIMINGS, read_rows
from kinebench_drake.validation.tracks import Recipe, Set, make

_PATIENCE_S = 600.0
_TRACKS, _CLIPS, _FRAMES = 12, 2, 8
_MOST = 6  # stops of one run, after which it may come to its end
_ADVICE = "; run the same command again, without --overwrite, to go on"
_GOES_ON = re.compile(rf"interrupted with (\d+) of (\d+) samples finished{_ADVICE}")
_NOT_BEGUN = re.compile(rf": interrupted$|interrupted before any sample was begun{_ADVICE}")
_INTERRUPTED = (130, -signal.SIGINT)


class Stop(Enum):
    """How a run is stopped."""

    ALL = "kill -9 of all its processes"
    ONE = "kill -9 of its main process"
    INTERRUPT = "interrupt"


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """A command that is stopped, and what it comes to if it is not."""

    name: str
    arguments: tuple[str, ...]
    whole: Path
    """Its output folder when nobody stopped it."""
    wall_s: float
    """Time that it took then [s]."""
    workers: int
    """Processes that work on its samples."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stopped:
    """One run that was stopped."""

    job: str
    stop: Stop
    at_s: float
    before: int
    """Samples finished when it was stopped."""
    after: int
    """And when it had ended."""
    fault: str = ""
    """What was not as it should be."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finished:
    """A run that came to its end after some stops."""

    job: str
    stops: int
    fault: str = ""
    """In what its output differs from that of the run that nobody stopped."""


def make_jobs(videos: Path, out: Path, jobs: int) -> list[Job]:
    """Make inputs and run the commands once without a stop.

    Args:
        videos: folder with videos, of which the first frames are taken.
        out: where inputs and outputs go.
        jobs: worker processes of each run.

    Raises:
        KinebenchError: a run failed by itself.
    """
    tracks, clips = out / "tracks", out / "clips"
    for _ in make(Recipe(set=Set.FEASIBLE, seed=0), _TRACKS, tracks):
        pass
    clips.mkdir(parents=True, exist_ok=True)
    for path in sorted(videos.glob("*.mp4"))[:_CLIPS]:
        write_video(clips / path.name, read_video(path).frames[:_FRAMES], 5.0)
    if (videos / "camera.json").is_file():
        shutil.copyfile(videos / "camera.json", clips / "camera.json")
    found = []
    for name, source in (("audit", tracks), ("score", clips)):
        whole = out / f"{name}-whole"
        arguments = (name, str(source), "--jobs", str(jobs))
        begin = time.monotonic()
        process = _start(arguments, whole)
        _, told = process.communicate(timeout=_PATIENCE_S)
        if process.returncode:
            raise KinebenchError(f"{name} failed by itself: {told[-500:]}")
        wall_s = time.monotonic() - begin
        found.append(Job(name=name, arguments=arguments, whole=whole, wall_s=wall_s, workers=jobs))
    return found


def torment(
    jobs: Sequence[Job], stops: Sequence[Stop], count: int, seed: int, out: Path
) -> Iterator[Stopped | Finished]:
    """Stop runs until so many stops have hit, each time going on where the run was stopped; in the end let all finish.

    Args:
        jobs: commands, taken in turn.
        stops: ways of stopping, drawn at random.
        count: stops.
        seed: of the moments.
        out: where outputs go.
    """
    signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # what a shell starts behind is deaf to it, and so its heirs
    rng = np.random.default_rng(seed)
    hits, number = 0, 0
    while hits < count:
        job = jobs[0] if rng.random() < 0.75 else jobs[-1]
        folder, here = out / f"{job.name}-{number:03d}", 0
        number += 1
        groups: list[int] = []
        while True:
            last = hits >= count or here >= _MOST
            process = _start(job.arguments, folder)
            groups.append(process.pid)
            told = None if last else _stop(process, job, stops[int(rng.integers(len(stops)))], folder, rng)
            if told is None:  # it was not stopped, or had ended before
                _, said = process.communicate(timeout=_PATIENCE_S)
                fault = _difference(job.whole, folder) if process.returncode == 0 else f"it failed: {said[-300:]}"
                yield Finished(job=job.name, stops=here, fault=fault or _left(groups))
                break
            hits, here = hits + 1, here + 1
            yield told


def _start(arguments: Sequence[str], out: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "kinebench_drake", *arguments, "--out", str(out)]
    quiet = subprocess.DEVNULL
    return subprocess.Popen(command, stdout=quiet, stderr=subprocess.PIPE, text=True, start_new_session=True)


def _stop(process: subprocess.Popen[str], job: Job, stop: Stop, folder: Path, rng: Generator) -> Stopped | None:
    """Stop a run at a moment of its time; None if it had ended before."""
    moment_s = float(rng.uniform(0.0, 1.1 * job.wall_s))
    begin = time.monotonic()
    if stop is Stop.INTERRUPT:  # as long as Python itself begins, it answers an interrupt in its own way
        while process.poll() is None and not _has_begun(folder) and time.monotonic() - begin < _PATIENCE_S:
            time.sleep(0.05)
        moment_s *= 0.5
    with suppress(subprocess.TimeoutExpired):
        process.wait(moment_s)
        return None
    before = _count(folder)
    number = signal.SIGINT if stop is Stop.INTERRUPT else signal.SIGKILL
    os.kill(process.pid, number) if stop is Stop.ONE else os.killpg(process.pid, number)
    _, said = process.communicate(timeout=_PATIENCE_S)
    after = _count(folder)
    fault = _answer(process.returncode, said, before, after, job.workers) if stop is Stop.INTERRUPT else ""
    return Stopped(job=job.name, stop=stop, at_s=time.monotonic() - begin, before=before, after=after, fault=fault)


def _has_begun(folder: Path) -> bool:
    return (folder / RUN).is_file()


def _count(folder: Path) -> int:
    """Samples that are finished and on disk."""
    try:
        return len(read_rows(folder))
    except InputError:
        return 0


def _answer(status: int, said: str, before: int, after: int, workers: int) -> str:
    """What is wrong with how an interrupt was answered; nothing if all is well."""
    if after - before > workers + 1:  # one may have been finished between the count and the interrupt
        return f"{after - before} samples were finished after the interrupt, by {workers} workers"
    if status == 0:
        return ""  # all samples were at hand or finished: the run came to its end
    if "Traceback" in said:
        return f"a traceback: {said[-300:]}"
    last = said.rstrip().rsplit("\n", 1)[-1]
    if _NOT_BEGUN.search(last) and status in _INTERRUPTED and after == before:
        return ""  # the program was still being loaded, or looked what there is to do
    told = _GOES_ON.search(last)
    if status != 130 or told is None:
        return f"status {status}, last words {said[-200:]!r}"
    if int(told[1]) != after:
        return f"told of {told[1]} finished samples, {after} are there"
    finishing = "being finished" in said
    return "" if after > before or not finishing or after == int(told[2]) else "the sample at hand was not finished"


def _difference(whole: Path, folder: Path) -> str:
    """In what two output folders differ, save the wall times; nothing if in nothing."""
    one, other = (
        {p.relative_to(f).as_posix(): p for p in f.rglob("*") if p.is_file() and p.name != TIMINGS}
        for f in (whole, folder)
    )
    if unlike := sorted(set(one) ^ set(other)):
        return f"files: {', '.join(unlike[:5])}"
    changed = [name for name in sorted(one) if one[name].read_bytes() != other[name].read_bytes()]
    return f"content of {', '.join(changed[:5])}" if changed else ""


def _left(groups: Sequence[int]) -> str:
    """Processes that outlive their run; nothing if there are none, or they end within seconds."""
    give_up = time.monotonic() + 60.0
    for group in groups:
        while _lives(group):
            if time.monotonic() > give_up:
                return f"processes of group {group} are left"
            time.sleep(0.2)
    return ""


def _lives(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True
