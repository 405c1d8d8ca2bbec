"""Provenance of a result besides its inputs: package versions, weights, code and machine. No clock time, no path."""

import hashlib
import os
import platform
from functools import cache
from importlib import metadata
from pathlib import Path

from kinebench_drake.types import Json

_TOP = Path(__file__).parents[1]
_PACKAGES = ("numpy", "scipy", "drake", "open3d", "torch", "av", "mani_skill", "sapien")

MEASURING = (
    *("camera.py", "geometry.py", "segments.py", "types.py", "io/*.py", "datasets/**/*.py", "models/**/*.py"),
    *("kinematics/*.py", "metrics/*.py", "grounding/*.py", "grounding/anomaly/*.py", "grounding/framing/*.py"),
    *("grounding/overrides/*.py", "grounding/registration/*.py", "calibration/*.py", "evaluation/*.py"),
    "closed_loop/*.py",
    *("suites/*.py", "suites/assets/*.py", "suites/experts/*.py", "suites/faults/*.py", "suites/tasks/*.py"),
    "suites/worldmodels/*.py",
)
"""Sources that shape a measurement, as patterns below the package: changed code invalidates stored rows."""
NOT_MEASURING = (
    # Imported by measuring code, but no number depends on them: storage, presentation, distribution of the work.
    *("__init__.py", "errors.py", "plugin.py", "stats.py", "environment/*.py", "executors/*.py", "report/*.py"),
    *("results/*.py", "evaluation/resume.py", "evaluation/runner.py", "evaluation/suite.py"),
    *("evaluation/thumbnail.py", "io/atomic.py", "grounding/overlay.py"),
    # In the folders of measuring code, but not used by it.
    *("io/figure.py", "evaluation/merge.py", "closed_loop/tolerance.py", "suites/contact_sheet.py"),
    *("calibration/articulated.py", "calibration/calibrate.py", "calibration/observability.py"),
    *("calibration/overlay.py", "calibration/result.py", "calibration/solve.py", "calibration/states.py"),
    *("suites/demos.py", "suites/expert_check.py", "suites/demo_config.py", "suites/selection.py"),
)
"""Exceptions from `MEASURING`."""


def versions() -> dict[str, Json]:
    """Return the versions of this package, of Python and of numerical packages; None for those not installed."""
    from kinebench_drake import __version__

    result: dict[str, Json] = {"kinebench_drake": __version__, "python": platform.python_version()}
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
        with file.open("rb") as data:
            digest.update(hashlib.file_digest(data, "sha256").digest())
    return digest.hexdigest()


def sources(patterns: tuple[str, ...]) -> set[Path]:
    """Return the files of the package that match one of the patterns."""
    return {file for pattern in patterns for file in _TOP.glob(pattern)}


@cache
def code_hash() -> str:
    """Return the SHA-256 of the sources that shape a measurement: a row with another hash is computed again."""
    digest = hashlib.sha256()
    for file in sorted(sources(MEASURING) - sources(NOT_MEASURING)):
        digest.update(file.relative_to(_TOP).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()


@cache
def report_hash() -> str:
    """Return the SHA-256 of the sources and templates that shape statistics and reports."""
    digest = hashlib.sha256()
    for file in sorted(sources(("*.py", "*/*.py", "report/*.j2"))):
        digest.update(file.relative_to(_TOP).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()


def host() -> dict[str, Json]:
    """Return a summary of the machine without its owner's names: system, architecture, processor, cores, bfloat16.

    The last says whether the processor multiplies in bfloat16 (AVX-512 BF16): the networks then do, with slightly other
    results than in single precision.
    """
    return {
        "system": platform.system(),
        "machine": platform.machine(),
        "cpu": _cpu("model name") or platform.processor() or None,
        "cores": os.cpu_count(),
        "bfloat16": "avx512_bf16" in _cpu("flags").split(),
    }


def _cpu(fact: str) -> str:
    """Return what Linux says of the first processor; empty on other systems."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return ""
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith(fact)), "")
