"""Repairs of `kinebench-drake doctor --fix`: native libraries and the conflict over `cv2`.

Only the environment of this Python (`sys.prefix`) is changed, never the system or another environment.
"""

import importlib
import importlib.metadata
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path

from kinebench_drake.environment import cv2_shim, doctor
from kinebench_drake.errors import SetupError

Say = Callable[[str], None]
"""Prints a line for the user."""

NATIVE_SCRIPT = Path(__file__).with_name("native.sh")
_ELSEWHERE = ("PIP_TARGET", "PIP_PREFIX", "PIP_ROOT", "PIP_USER", "PIP_PYTHON")
"""Environment variables that would make pip install outside this environment."""


def repair_environment(checks: Sequence[doctor.Check], say: Say, *, dry_run: bool = False) -> bool:
    """Announce the repairs for failed checks, and the one that `pip check` would require, and make them.

    A repair that fails does not stop the others.

    Args:
        checks: results of `doctor.run_checks()`.
        say: prints progress.
        dry_run: announce only.

    Returns:
        True if something was changed.

    Raises:
        SetupError: this Python belongs to no environment, or to one that is not writable; nothing was changed.
    """
    failed = {check.name for check in checks if not check.ok}
    conflict = doctor.CV2_CHECK in failed
    repairs = list[tuple[str, Callable[[], list[str]], Callable[[Say], None]]]()  # title, planned changes, the repair
    if failed.intersection(doctor.NATIVE_CHECKS):
        repairs.append(("Native libraries", _native_changes, _repair_native))
    if conflict or _version(cv2_shim.NAME) is None:
        title = "cv2 from opencv-python-headless alone"
        repairs.append((title, lambda: _cv2_changes(conflict), lambda say: _repair_cv2(conflict, say)))
    if repairs:
        _require_environment()
    changed = False
    for title, plan, perform in repairs:
        say(f"==> {title}, in {sys.prefix}")
        try:
            for change in plan():
                say(f"    {change}")
            if not dry_run:
                changed = True
                perform(lambda line: say(f"    {line}"))
        except SetupError as error:
            say(f"    not repaired: {error}")
    return changed


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


def _native_changes() -> list[str]:
    lines: list[str] = []
    _run(["bash", str(NATIVE_SCRIPT), sys.executable, "--plan"], lines.append)
    return lines


def _repair_native(say: Say) -> None:
    _run(["bash", str(NATIVE_SCRIPT), sys.executable, "--anew"], say)


def _version(distribution: str) -> str | None:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None


def _removable() -> list[str]:
    """Return the distributions in this environment that contain a `cv2`; pip leaves others alone."""
    return [
        name
        for name in doctor.cv2_owners()
        if Path(str(importlib.metadata.distribution(name).locate_file("")))
        .resolve()
        .is_relative_to(Path(sys.prefix).resolve())
    ]


def _cv2_changes(conflict: bool) -> list[str]:
    changes = []
    if conflict:
        changes += [f"remove {name} {_version(name)}" for name in _removable()]
        changes.append(f"install {_headless()[0]}, downloaded before anything is removed")
    if _needs_shim():
        changes.append(f"install a shim for {cv2_shim.NAME} {cv2_shim.VERSION}: metadata, no code")
    return changes


def _needs_shim() -> bool:
    return _version(cv2_shim.NAME) is None or cv2_shim.NAME in doctor.cv2_owners()


def _headless() -> list[str]:
    """Return requirements for pip in order of preference: the installed version, then any compatible one."""
    required = next(
        (line for line in importlib.metadata.requires("kinebench-drake") or [] if line.startswith(cv2_shim.HEADLESS)),
        cv2_shim.HEADLESS,
    )
    version = _version(cv2_shim.HEADLESS)
    return [required] if version is None else [f"{required},=={version}", required]


def _repair_cv2(conflict: bool, say: Say) -> None:
    if find_spec("pip") is None:
        raise SetupError(f"this environment has no pip; `{sys.executable} -m ensurepip` installs it, then try again")
    with tempfile.TemporaryDirectory() as folder:
        wheels = [str(cv2_shim.write_wheel(Path(folder)))] if _needs_shim() else []
        if conflict:
            wheels.append(_download(_headless(), Path(folder), say))
            removable = _removable()
            if removable:
                _run(_pip("uninstall", "--yes", *removable), say)
        _run(_pip("install", "--no-index", "--no-deps", "--force-reinstall", *wheels), say)
    importlib.invalidate_caches()


def _download(requirements: Sequence[str], folder: Path, say: Say) -> str:
    """Download the wheel of the first requirement that pip can fetch; return its path."""
    place = folder / "downloaded"
    for requirement in requirements:
        try:
            _run(_pip("download", "--no-deps", "--only-binary=:all:", "--dest", str(place), requirement), say)
        except SetupError as error:
            reason = str(error)
        else:
            return str(next(place.glob("*.whl")))
    raise SetupError(
        f"{cv2_shim.HEADLESS} cannot be downloaded ({reason}), nothing was changed; "
        "is the network up and pip's index reachable? Then run `kinebench-drake doctor --fix` again"
    )


def _pip(command: str, *arguments: str) -> list[str]:
    pip = [sys.executable, "-P", "-m", "pip", "--disable-pip-version-check", "--no-input", "--quiet"]
    return [*pip, command, *arguments]


def _run(command: Sequence[str], say: Say) -> None:
    """Run a command and pass on its output line by line; if it fails, its last line is the reason."""
    environment = {name: value for name, value in os.environ.items() if name not in _ELSEWHERE}
    last = ""
    try:
        with subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            encoding="utf-8",
            errors="replace",
            env=environment,
        ) as process:
            for line in process.stdout or ():
                if last:
                    say(last)
                last = line.strip().removeprefix("==> ")
    except OSError as error:
        raise SetupError(f"{command[0]} cannot be started ({error.strerror}); install it, then try again") from None
    if process.returncode:
        reason = last.removeprefix("setup: ").removeprefix("ERROR: ") or f"exit status {process.returncode}"
        raise SetupError(reason)
    if last:
        say(last)
