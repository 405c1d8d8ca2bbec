"""Repairs of `kinebench-drake doctor --fix`, as commands: native libraries, and the conflict over `cv2`.

Only the environment of this Python (`sys.prefix`) is changed, never the system or another environment.
"""

import importlib.metadata
import os
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from kinebench_drake.environment import cv2_shim, doctor
from kinebench_drake.errors import SetupError

NATIVE_SCRIPT = Path(__file__).with_name("native.sh")
_PIP = (sys.executable, "-P", "-m", "pip", "--disable-pip-version-check", "--no-input", "--quiet")
_ELSEWHERE = ("PIP_TARGET", "PIP_PREFIX", "PIP_ROOT", "PIP_USER", "PIP_PYTHON")
"""Environment variables that would make pip install outside this environment."""


def repair_environment(checks: Sequence[doctor.Check], say: Callable[[str], None]) -> bool:
    """Print and run the commands that repair failed checks; a repair that fails does not stop the others.

    Args:
        checks: results of `doctor.run_checks()`.

    Returns:
        True if something was changed.
    """
    failed = {check.name for check in checks if not check.ok}
    environment = {name: value for name, value in os.environ.items() if name not in _ELSEWHERE}
    with tempfile.TemporaryDirectory() as folder:
        native = [["bash", str(NATIVE_SCRIPT), sys.executable, "--anew"]]
        repairs = [native] if failed.intersection(doctor.NATIVE_CHECKS) else []
        repairs += [_cv2_commands(Path(folder))] if doctor.CV2_CHECK in failed else []
        if repairs:
            _require_environment()
        for commands in repairs:
            for command in commands:
                say(f"==> {shlex.join(command)}")
                if subprocess.run(command, env=environment).returncode:
                    say("    failed")
                    break
    return bool(repairs)


def _require_environment() -> None:
    """Raise SetupError unless this is a virtual or conda environment that is writable."""
    prefix = Path(sys.prefix)
    conda = (prefix / "conda-meta").is_dir() and not (prefix / "condabin").is_dir()  # its base has both
    if sys.prefix == sys.base_prefix and not conda:
        raise SetupError(
            f"{prefix} is no virtual environment, and --fix changes no other Python; "
            "make one with `python3 -m venv FOLDER` and install kinebench-drake there"
        )
    if not os.access(prefix, os.W_OK):
        raise SetupError(
            f"{prefix} cannot be written to; run `kinebench-drake doctor --fix` as its owner, or make your own"
        )


def _cv2_commands(folder: Path) -> list[list[str]]:
    """Return commands that leave one owner of `cv2`, downloaded before anything is removed, and the shim."""
    required = importlib.metadata.requires("kinebench-drake") or []
    headless = next((line for line in required if line.startswith(cv2_shim.HEADLESS)), cv2_shim.HEADLESS)
    cv2_shim.write_wheel(folder)
    wheels = ["--no-index", "--find-links", str(folder), "--no-deps", "--force-reinstall"]
    return [
        [*_PIP, "download", "--no-deps", "--only-binary=:all:", "--dest", str(folder), headless],
        [*_PIP, "uninstall", "--yes", *doctor.CV2_OWNERS],
        [*_PIP, "install", *wheels, cv2_shim.HEADLESS, cv2_shim.NAME],
    ]
