"""The real program in processes of its own, watched from outside: when samples end, and what memory is held."""

import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from kinebench_drake.errors import KinebenchError

_FINISHED = re.compile(r"\[(\d+)/\d+\] ")
_WORKER = "spawn_main"
"""What the command line of a worker process has in it; its helper processes have not."""
_LOOK_S = 0.2
"""How often memory is looked at [s]."""
_TOLD = 8
"""Last lines of a program that failed, which are told."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Memory:
    """Resident memory of a run's processes, libraries included [MB]."""

    main_mb: float
    """The process that was started."""
    workers_mb: tuple[float, ...]
    """Each of its worker processes, the oldest first; none where it does the work itself."""

    def joined(self, other: "Memory") -> "Memory":
        """The larger of both, process by process."""
        n = max(len(self.workers_mb), len(other.workers_mb))
        a, b = ((*m.workers_mb, *[0.0] * (n - len(m.workers_mb))) for m in (self, other))
        return Memory(main_mb=max(self.main_mb, other.main_mb), workers_mb=tuple(map(max, a, b)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Watched:
    """A run that ended well."""

    wall_s: float
    """From the start of its process to its end."""
    finished_s: tuple[float, ...]
    """When each sample was finished, from the start of the process [s]."""
    memory: Mapping[int, Memory]
    """What was held when so many samples were finished."""
    peak: Memory
    """The most that each process held."""


def watch(
    arguments: Sequence[str],
    *,
    reads: Callable[[int], bool] = lambda finished: False,
    environment: Mapping[str, str] | None = None,
    finished: Callable[[int], None] = lambda number: None,
) -> Watched:
    """Run `kinebench-drake` with some arguments to its end.

    Args:
        arguments: what stands behind the program's name.
        reads: whether to note the memory when so many samples are finished.
        environment: variables besides this process's own.
        finished: called with the number of samples finished, each time one is.

    Raises:
        KinebenchError: the program failed.
    """
    start = time.monotonic()
    process = subprocess.Popen(
        [sys.executable, "-m", "kinebench_drake", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, **(environment or {})},
    )
    peaks = _Peaks(process)
    ends: list[float] = []
    memory: dict[int, Memory] = {}
    said: list[str] = []
    try:
        peaks.start()
        for line in process.stdout or ():
            said = [*said[1 - _TOLD :], line.strip()]
            if _FINISHED.match(line):
                ends.append(time.monotonic() - start)
                if reads(len(ends)):
                    memory[len(ends)] = held(process.pid, "VmRSS") or peaks.most
                finished(len(ends))
        code = process.wait()
    finally:
        process.kill()
        process.wait()
        peaks.join()
    if code:
        raise KinebenchError(f"`kinebench-drake {' '.join(arguments)}` ended with status {code}: {' '.join(said)}")
    return Watched(wall_s=time.monotonic() - start, finished_s=tuple(ends), memory=memory, peak=peaks.most)


def held(pid: int, field: str) -> Memory | None:
    """Memory of a process and of its workers as the kernel counts it; None where the process is gone.

    Args:
        pid: the process.
        field: "VmRSS", what is resident now, or "VmHWM", the most that ever was.
    """
    main = _status_mb(pid, field)
    workers = [_status_mb(child, field) for child in children(pid) if _WORKER in command_line(child)]
    return None if main is None else Memory(main_mb=main, workers_mb=tuple(mb for mb in workers if mb is not None))


def children(pid: int) -> list[int]:
    """Processes that a process started, the oldest first."""
    found: list[int] = []
    for listing in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            found += map(int, listing.read_text().split())
        except OSError:
            continue
    return sorted(found)


def command_line(pid: int) -> str:
    """What a process was started as, or calls itself; empty where it is gone."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_text().replace("\0", " ").strip()
    except OSError:
        return ""


def _status_mb(pid: int, field: str) -> float | None:
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return None
    found = re.search(rf"^{field}:\s+(\d+) kB$", status, flags=re.MULTILINE)
    return int(found[1]) / 1024.0 if found else None


class _Peaks(threading.Thread):
    """Looks at a process and its workers until it ends; the kernel itself remembers what is between two looks."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        super().__init__(daemon=True)
        self._process = process
        self.most = Memory(main_mb=0.0, workers_mb=())

    def run(self) -> None:
        while self._process.poll() is None:
            seen = held(self._process.pid, "VmHWM")
            if seen is not None:
                self.most = self.most.joined(seen)
            time.sleep(_LOOK_S)
