"""What a result came from besides its inputs: versions, weights and the machine. Holds no clock time and no path."""

import hashlib
import os
import platform
from functools import cache
from importlib import metadata
from pathlib import Path

from kinebench_drake.types import Json

_PACKAGES = ("numpy", "scipy", "drake", "open3d", "torch", "av", "mani_skill", "sapien")

_NOT_MEASURING = ("cli", "report", "suite_report")


def versions() -> dict[str, Json]:
    """Versions of this package, of Python and of what the numbers depend on; None where not installed."""
    from kinebench_drake import __version__

    found: dict[str, Json] = {"kinebench_drake": __version__, "python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = None
    return found


@cache
def weights_hash() -> str:
    """SHA-256 over the networks' weights and calibrations that lie in the package."""
    digest = hashlib.sha256()
    folder = Path(__file__).parents[1] / "models" / "perception"
    for file in sorted(p for p in folder.iterdir() if p.suffix in (".safetensors", ".json")):
        digest.update(file.name.encode() + b"\0")
        with file.open("rb") as data:
            digest.update(hashlib.file_digest(data, "sha256").digest())
    return digest.hexdigest()


@cache
def code_hash() -> str:
    """SHA-256 over the package's own sources, those of the command line and the reports left out.

    It stands for the code's version where results are recognised: changed code computes anew.
    """
    digest = hashlib.sha256()
    top = Path(__file__).parents[1]
    files = []
    for root, folders, names in os.walk(top, followlinks=True):  # grounding, models and suites may be links
        if Path(root) == top:
            folders[:] = [name for name in folders if name not in _NOT_MEASURING]
        files += [Path(root) / name for name in names if name.endswith(".py")]
    for file in sorted(files):
        digest.update(file.relative_to(top).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()


def host() -> dict[str, Json]:
    """The machine in few words: system, processor, cores; nothing that names its owner."""
    return {"system": platform.system(), "machine": platform.machine(), "cpu": _cpu(), "cores": os.cpu_count()}


def _cpu() -> str | None:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or None
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), None)
