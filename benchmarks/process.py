"""The program in a process of its own, measured from outside: finish time of each sample, memory of its processes."""

import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinebench_drake.errors import KinebenchError
from kinebench_drake.geometry import Array

FINISHED = re.compile(r"\[(\d+)/\d+\] ")
"""Begin of the program's log line for a finished sample."""
WORKER = "spawn_main"
"""Part of the command line of a worker process that helper processes lack."""
PEAK_INTERVAL_S = 0.2
"""Time between two readings of the peak memory [s]."""
QUOTED_LINES = 8
"""Last lines of the output of a program that failed, quoted in the error."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessMemory:
    """Resident memory of a run's processes, libraries included [MB]."""

    main_mb: float
    """The main process."""
    workers_mb: tuple[float, ...]
    """Its worker processes, the oldest first; none where the main process does the work itself."""

    def maximum(self, other: "ProcessMemory") -> "ProcessMemory":
        """Return the larger of both, process by process."""
        n = max(len(self.workers_mb), len(other.workers_mb))
        a, b = ((*m.workers_mb, *[0.0] * (n - len(m.workers_mb))) for m in (self, other))
        return ProcessMemory(main_mb=max(self.main_mb, other.main_mb), workers_mb=tuple(map(max, a, b)))


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessRun:
    """Measurements of a run that succeeded."""

    finished_s: tuple[float, ...]
    """Time from the start of the process to the end of each sample [s]."""
    peak: ProcessMemory
    """Peak resident memory of each process."""


def run_program(
    arguments: Sequence[str],
    *,
    environment: Mapping[str, str] | None = None,
) -> ProcessRun:
    """Run `kinebench-drake` and measure it.

    Args:
        arguments: of the program.
        environment: variables in addition to those of this process.

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
    peaks = _PeakMemory(process)
    finished_s: list[float] = []
    last_lines: list[str] = []
    try:
        peaks.start()
        for line in process.stdout or ():
            last_lines = [*last_lines[1 - QUOTED_LINES :], line.strip()]
            if FINISHED.match(line):
                finished_s.append(time.monotonic() - start)
        code = process.wait()
    finally:
        process.kill()
        process.wait()
        peaks.join()
    if code:
        command = f"kinebench-drake {' '.join(arguments)}"
        raise KinebenchError(f"`{command}` ended with status {code}: {' '.join(last_lines)}")
    return ProcessRun(finished_s=tuple(finished_s), peak=peaks.peak)


def read_memory(pid: int) -> ProcessMemory | None:
    """Read the peak memory so far of a process and of its workers from /proc; None if the process has ended."""
    main = _status_mb(pid)
    workers = [_status_mb(child) for child in children(pid) if WORKER in command_line(child)]
    if main is None:
        return None
    return ProcessMemory(main_mb=main, workers_mb=tuple(mb for mb in workers if mb is not None))


def children(pid: int) -> list[int]:
    """Return the child processes of a process, the oldest first."""
    pids: list[int] = []
    for listing in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            pids += map(int, listing.read_text().split())
        except OSError:
            continue
    return sorted(pids)


def command_line(pid: int) -> str:
    """Return the command line of a process, or the title that it has set; empty if it has ended."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_text().replace("\0", " ").strip()
    except OSError:
        return ""


def _status_mb(pid: int) -> float | None:
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return None
    match = re.search(r"^VmHWM:\s+(\d+) kB$", status, flags=re.MULTILINE)
    return int(match[1]) / 1024.0 if match else None


class _PeakMemory(threading.Thread):
    """Reads the peak memory of a process and its workers at intervals until the process ends."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        super().__init__(daemon=True)
        self._process = process
        self.peak = ProcessMemory(main_mb=0.0, workers_mb=())

    def run(self) -> None:
        while self._process.poll() is None:
            memory = read_memory(self._process.pid)
            if memory is not None:
                self.peak = self.peak.maximum(memory)
            time.sleep(PEAK_INTERVAL_S)


def spread(values: Array, digits: int) -> str:
    """Format values as median (minimum to maximum)."""
    return f"{np.median(values):z.{digits}f} ({values.min():z.{digits}f} to {values.max():z.{digits}f})"
