"""Provenance of a result besides its inputs: package versions, weights, code and machine. No clock time, no path."""

import hashlib
import os
import platform
from functools import cache
from importlib import metadata
from pathlib import Path

from kinebench_drake.environment.precision import multiplies_bfloat16, network_precision, processor_fact
from kinebench_drake.io.archive import hash_file
from kinebench_drake.io.jsonl import Json
from kinebench_drake.plugin import BENCHMARK

_TOP = Path(__file__).parents[1]
_PACKAGES = ("numpy", "scipy", "drake", "open3d", "torch", "av", "mani_skill", "sapien")

RUNS = ("kinebench_drake.runs.score", "kinebench_drake.runs.audit", "kinebench_drake.runs.follow", BENCHMARK)
"""Modules that measure samples."""
_NOT_MEASURING = ("api", "cli", "environment", "errors", "executors", "integrations", "report", "results", "stats")
"""Parts of the package on which no number of a row depends: storage, statistics, presentation, distribution of work."""


def versions() -> dict[str, Json]:
    """Return the versions of this package, of Python and of numerical packages, and the precision of the networks.

    Packages that are not installed are None.

    Raises:
        UsageError: the environment names an unknown precision.
    """
    from kinebench_drake import __version__

    result: dict[str, Json] = {
        "kinebench_drake": __version__,
        "python": platform.python_version(),
        "precision": network_precision().value,
    }
    for name in _PACKAGES:
        try:
            result[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            result[name] = None
    return result


@cache
def weights_hash() -> str:
    """Return the SHA-256 of the network weights and calibrations in the package."""
    digest = hashlib.sha256()
    folder = _TOP / "models" / "perception"
    for file in sorted(p for p in folder.iterdir() if p.suffix in (".safetensors", ".json")):
        digest.update(file.name.encode() + b"\0")
        digest.update(bytes.fromhex(hash_file(file)))
    return digest.hexdigest()


@cache
def code_hash(*modules: str) -> str:
    """Return the SHA-256 of the sources that shape a measurement: a row with another hash is computed again.

    They are all but those of `_NOT_MEASURING`; those of the benchmark count for its own modules only.
    """
    benchmark = BENCHMARK.split(".")[1]
    is_episode = any(module.split(".")[1] == benchmark for module in modules)
    digest = hashlib.sha256()
    for part in sorted(_TOP.iterdir()):
        if part.stem in _NOT_MEASURING or (part.name == benchmark and not is_episode):
            continue
        for file in sorted(part.resolve().rglob("*.py")) if part.is_dir() else [part] * (part.suffix == ".py"):
            digest.update(f"{part.name}/{file.relative_to(part.resolve())}".encode() + b"\0")
            digest.update(file.read_bytes() + b"\0")
    return digest.hexdigest()


def host() -> dict[str, Json]:
    """Return a summary of the machine without its owner's names: system, architecture, processor, cores, bfloat16.

    The last says whether the processor multiplies in bfloat16.
    """
    return {
        "system": platform.system(),
        "machine": platform.machine(),
        "cpu": processor_fact("model name") or platform.processor() or None,
        "cores": os.cpu_count(),
        "bfloat16": multiplies_bfloat16(),
    }
