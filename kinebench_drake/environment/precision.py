"""Precision of the networks: chosen by the processor, or forced by an environment variable."""

import os
from enum import Enum
from pathlib import Path

from kinebench_drake.errors import UsageError

PRECISION_VARIABLE = "KINEBENCH_DRAKE_PRECISION"
"""Environment variable that forces the precision: float32 or bfloat16."""
_GPU_DEVICES = (Path("/dev/nvidiactl"), Path("/dev/dxg"))  # without them torch, which is slow to load, finds no GPU


class Precision(Enum):
    """Number format in which the networks compute."""

    FLOAT32 = "float32"
    BFLOAT16 = "bfloat16"


def network_precision() -> Precision:
    """Return the precision of the networks.

    The precision that the environment variable names; without it bfloat16 on a processor that multiplies in it, where
    that halves the time, else float32. On a GPU it is float32.

    Raises:
        UsageError: the variable names no precision.
    """
    forced = os.environ.get(PRECISION_VARIABLE)
    if forced:
        try:
            return Precision(forced)
        except ValueError:
            choices = " or ".join(precision.value for precision in Precision)
            raise UsageError(f"{PRECISION_VARIABLE} is {forced!r:.40}, expected {choices}") from None
    return Precision.BFLOAT16 if multiplies_bfloat16() and not _has_gpu() else Precision.FLOAT32


def multiplies_bfloat16() -> bool:
    """Return whether the processor multiplies in bfloat16 (AVX-512 BF16)."""
    return "avx512_bf16" in processor_fact("flags").split()


def processor_fact(name: str) -> str:
    """Return what Linux states of the first processor, such as "flags"; empty on other systems."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return ""
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith(name)), "")


def _has_gpu() -> bool:
    if not any(device.exists() for device in _GPU_DEVICES):
        return False
    import torch  # slow to load

    return torch.cuda.is_available()
