"""A process in which inputs are read: watched for time and memory, replaced when it dies."""

import multiprocessing
import os
import resource
import shutil
import signal
import traceback
import warnings
from dataclasses import dataclass
from enum import Enum
from multiprocessing.connection import Connection
from pathlib import Path

from kinebench_drake.errors import KinebenchError
from kinebench_drake.validation.fuzz.arrays import MARK

PATIENCE_S = 60.0
"""Longest time that an input of some kilobytes may take [s]."""
MOST_BYTES = 2**30
"""Most memory that reading one may add."""
MOST_SIGNS = 2000
"""Longest message."""
_ADDRESSES = 8 * 2**30  # beyond what the libraries take; a request for more fails instead of filling the machine
_START_S = 300.0


class Fate(Enum):
    """What became of an input."""

    READ = "read"
    REFUSED = "refused"
    TRACEBACK = "traceback"
    MESSAGE = "message"
    """Refused, but not in one plain line."""
    MEMORY = "memory"
    HANG = "hang"
    CRASH = "crash"
    LOADED = "code ran"
    """What was pickled in it was loaded."""

    @property
    def good(self) -> bool:
        """Whether that is as it should be."""
        return self in (Fate.READ, Fate.REFUSED)


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What became of an input, and what was told."""

    fate: Fate
    told: str = ""


class Worker:
    """A process that reads; started anew after it hung or died."""

    def __init__(self, home: Path) -> None:
        """`home` is where it runs and where inputs are put."""
        self._home = home
        self._process: multiprocessing.process.BaseProcess | None = None
        self._pipe: Connection | None = None

    def read(self, kind: int, folder: Path) -> Outcome:
        """Read the input in a folder as one of a kind, by its number."""
        pipe = self._pipe or self._start()
        pipe.send((kind, folder))
        if not pipe.poll(PATIENCE_S):
            self.close()
            return Outcome(fate=Fate.HANG, told=f"no end after {PATIENCE_S:g} s")
        try:
            outcome: Outcome = pipe.recv()
        except (EOFError, ConnectionResetError):
            code = self.close()
            return Outcome(fate=Fate.CRASH, told=f"the process ended with {code}")
        if outcome.fate is Fate.MEMORY:
            self.close()  # its high-water mark hides what comes after
        return outcome

    def close(self) -> int | None:
        """End the process; returns how it ended."""
        process, pipe, self._process, self._pipe = self._process, self._pipe, None, None
        if process is None or pipe is None:
            return None
        pipe.close()
        process.join(0.5)
        code = process.exitcode
        process.kill()
        process.join()
        return code

    def _start(self) -> Connection:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, self._home), daemon=True)
        self._process.start()
        theirs.close()
        if not self._pipe.poll(_START_S) or self._pipe.recv() is not None:
            raise KinebenchError("the reading process does not start")
        return self._pipe


def _serve(pipe: Connection, home: Path) -> None:
    """Body of the process."""
    from kinebench_drake.validation.fuzz.kinds import KINDS

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.chdir(home)
    os.dup2(os.open(os.devnull, os.O_RDWR), 2)  # what native libraries remark
    warnings.simplefilter("ignore")
    for kind in KINDS[:1]:
        kind.trees()  # loads what encodes, too: what is loaded later would count as an input's memory
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + _ADDRESSES,) * 2)
    pipe.send(None)
    try:
        while (asked := pipe.recv()) is not None:
            pipe.send(_watched(KINDS[asked[0]].read, asked[1], home))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return


def _watched(read: object, folder: Path, home: Path) -> Outcome:
    before = _peak_bytes()
    outcome = _outcome(read, folder)
    added = _peak_bytes() - before
    if (home / MARK).exists() or (folder / MARK).exists():
        shutil.rmtree(home / MARK, ignore_errors=True)
        return Outcome(fate=Fate.LOADED, told="a pickled object was loaded")
    if added > MOST_BYTES and outcome.fate.good:
        return Outcome(fate=Fate.MEMORY, told=f"{added / 2**20:.0f} MiB more; {outcome.told}")
    return outcome


def _outcome(read: object, folder: Path) -> Outcome:
    try:
        read(folder)  # type: ignore[operator]
    except KinebenchError as error:
        text = str(error)
        plain = text.isprintable() and 0 < len(text) <= MOST_SIGNS
        return Outcome(fate=Fate.REFUSED if plain else Fate.MESSAGE, told=text)
    except BaseException:
        return Outcome(fate=Fate.TRACEBACK, told=traceback.format_exc())
    return Outcome(fate=Fate.READ)


def _peak_bytes() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
