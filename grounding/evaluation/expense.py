"""What a grounding costs: time on the clock, time of the processor, memory."""

import resource
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import TypeVar

Value = TypeVar("Value")
_RSS_UNIT_MB = 2**20 if sys.platform == "darwin" else 2**10  # of ru_maxrss in a megabyte


@dataclass(frozen=True, slots=True, kw_only=True)
class Expense:
    """What the grounding of one clip cost."""

    wall_s: float
    """Time on the clock, decoding included [s]."""
    cpu_s: float
    """Time of the processor, all threads together [s]: tells more than the clock on a busy machine."""
    peak_mb: float
    """Most memory that the process has held so far [MiB]."""

    def to_json(self) -> dict[str, float]:
        """A JSON object of it."""
        return {name: round(value, 3) for name, value in asdict(self).items()}


def metered(work: Callable[[], Value]) -> tuple[Value, Expense]:
    """What `work` returns, and what it cost."""
    wall, cpu = time.perf_counter(), time.process_time()
    value = work()
    return value, Expense(
        wall_s=time.perf_counter() - wall,
        cpu_s=time.process_time() - cpu,
        peak_mb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _RSS_UNIT_MB,
    )
