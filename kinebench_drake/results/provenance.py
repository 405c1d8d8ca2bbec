"""Provenance of a result besides its inputs: package versions, weights, code and machine. No clock time, no path."""

import hashlib
import os
import platform
from functools import cache
from importlib import metadata
from pathlib import Path

from kinebench_drake.environment.precision import multiplies_bfloat16, network_precision, processor_fact
from kinebench_drake.environment.sources import trace_sources
from kinebench_drake.io.archive import hash_file
from kinebench_drake.io.jsonl import Json
from kinebench_drake.plugin import BENCHMARK

_TOP = Path(__file__).parents[1]
_PACKAGES = ("numpy", "scipy", "drake", "open3d", "torch", "av", "mani_skill", "sapien")

RUNS = ("kinebench_drake.runs.score", "kinebench_drake.runs.audit", "kinebench_drake.runs.follow", BENCHMARK)
"""Modules that measure samples."""
_NOT_MEASURING = ("report", "results", "executors", "environment", "cli", "errors", "stats")
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
    """Return the SHA-256 of the code that shapes a measurement: a row with another hash is computed again.

    It is that of the syntax trees, without docstrings and comments, of all modules that measuring modules reach.
    """
    digest = hashlib.sha256()
    for source in trace_sources(*modules):
        if source.name.split(".")[1:2] not in [[part] for part in _NOT_MEASURING]:
            digest.update(f"{source.name} {source.code}\n".encode())
    return digest.hexdigest()


@cache
def report_hash() -> str:
    """Return the SHA-256 of the sources, templates and captions that shape statistics and reports."""
    digest = hashlib.sha256()
    patterns = ("*.py", "*/*.py", "report/*.j2", "report/*.toml", "report/*.csv")
    for file in sorted(file for pattern in patterns for file in _TOP.glob(pattern)):
        digest.update(file.relative_to(_TOP).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
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
