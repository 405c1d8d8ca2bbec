"""What `kinebench-drake doctor --fix` mends: the native libraries and the clash over `cv2`.

Only the environment that this Python belongs to (`sys.prefix`) is changed, never the system or another environment.
"""

import importlib
import importlib.metadata
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from kinebench_drake.environment import cv2_shim as stand_in
from kinebench_drake.environment import doctor
from kinebench_drake.errors import SetupError

Say = Callable[[str], None]
"""Takes a line for the user."""

NATIVE_SCRIPT = Path(__file__).with_name("native.sh")
_ELSEWHERE = ("PIP_TARGET", "PIP_PREFIX", "PIP_ROOT", "PIP_USER", "PIP_PYTHON")
"""Settings that would have pip install into another place than this environment."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Repair:
    """Something that can be mended."""

    title: str
    """What is mended, a line."""
    changes: Callable[[], list[str]]
    """Tells what will change, a line each; changes nothing. Raises SetupError where it cannot be mended here."""
    perform: Callable[[Say], None]
    """Mends it; raises SetupError."""


def needed(checks: Sequence[doctor.Check]) -> list[Repair]:
    """The repairs that failed checks call for, and the one that `pip check` would call for."""
    failed = {check.name for check in checks if not check.ok}
    repairs = []
    if failed.intersection(doctor.NATIVE_CHECKS):
        repairs.append(Repair(title="Native libraries", changes=_native_changes, perform=_mend_native))
    clash = doctor.CV2_CHECK in failed
    if clash or _version(stand_in.NAME) is None:
        repairs.append(
            Repair(
                title="cv2 from opencv-python-headless alone",
                changes=lambda: _cv2_changes(clash),
                perform=lambda say: _mend_cv2(clash, say),
            )
        )
    return repairs


def mend(checks: Sequence[doctor.Check], say: Say, *, dry_run: bool = False) -> bool:
    """Announce what is needed, and do it; a repair that fails does not keep the others from being done.

    Args:
        checks: What `doctor.run_checks()` found.
        say: Takes the lines that tell what is going on.
        dry_run: Announce only.

    Returns:
        Whether something was changed.

    Raises:
        SetupError: this Python belongs to no environment, or to one that cannot be written to; nothing was changed.
    """
    repairs = needed(checks)
    if repairs:
        _require_environment()
    changed = False
    for repair in repairs:
        say(f"==> {repair.title}, in {sys.prefix}")
        try:
            for change in repair.changes():
                say(f"    {change}")
            if not dry_run:
                changed = True
                repair.perform(lambda line: say(f"    {line}"))
        except SetupError as error:
            say(f"    not mended: {error}")
    return changed


def _require_environment() -> None:
    """A virtual or conda environment that can be written to."""
    prefix = Path(sys.prefix)
    conda = (prefix / "conda-meta").is_dir() and not (prefix / "condabin").is_dir()  # its base has the latter
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


def _mend_native(say: Say) -> None:
    _run(["bash", str(NATIVE_SCRIPT), sys.executable, "--anew"], say)


def _version(distribution: str) -> str | None:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None


def _removed() -> list[str]:
    """The distributions of this environment that brought a `cv2`; pip leaves those of other places alone."""
    return [
        name
        for name in doctor.cv2_owners()
        if Path(str(importlib.metadata.distribution(name).locate_file("")))
        .resolve()
        .is_relative_to(Path(sys.prefix).resolve())
    ]


def _cv2_changes(clash: bool) -> list[str]:
    changes = []
    if clash:
        changes += [f"remove {name} {_version(name)}" for name in _removed()]
        changes.append(f"install {_headless()[0]}, downloaded before anything is removed")
    if _needs_stand_in():
        changes.append(f"install a stand-in for {stand_in.NAME} {stand_in.VERSION}: metadata, no code")
    return changes


def _needs_stand_in() -> bool:
    return _version(stand_in.NAME) is None or stand_in.NAME in doctor.cv2_owners()


def _headless() -> list[str]:
    """What to ask pip for: the version that is here if it will do, else any that this package can use."""
    required = next(
        (line for line in importlib.metadata.requires("kinebench-drake") or [] if line.startswith(stand_in.HEADLESS)),
        stand_in.HEADLESS,
    )
    version = _version(stand_in.HEADLESS)
    return [required] if version is None else [f"{required},=={version}", required]


def _mend_cv2(clash: bool, say: Say) -> None:
    if find_spec("pip") is None:
        raise SetupError(f"this environment has no pip; `{sys.executable} -m ensurepip` brings it, then try again")
    with tempfile.TemporaryDirectory() as folder:
        wheels = [str(stand_in.write_wheel(Path(folder)))] if _needs_stand_in() else []
        if clash:
            wheels.append(_download(_headless(), Path(folder), say))
            removed = _removed()
            if removed:
                _run(_pip("uninstall", "--yes", *removed), say)
        _run(_pip("install", "--no-index", "--no-deps", "--force-reinstall", *wheels), say)
    importlib.invalidate_caches()


def _download(requirements: Sequence[str], folder: Path, say: Say) -> str:
    """The wheel of the first requirement that pip can fetch."""
    place = folder / "downloaded"
    for requirement in requirements:
        try:
            _run(_pip("download", "--no-deps", "--only-binary=:all:", "--dest", str(place), requirement), say)
        except SetupError as error:
            reason = str(error)
        else:
            return str(next(place.glob("*.whl")))
    raise SetupError(
        f"{stand_in.HEADLESS} cannot be downloaded ({reason}), nothing was changed; "
        "is the network up and pip's index reachable? Then run `kinebench-drake doctor --fix` again"
    )


def _pip(command: str, *arguments: str) -> list[str]:
    pip = [sys.executable, "-P", "-m", "pip", "--disable-pip-version-check", "--no-input", "--quiet"]
    return [*pip, command, *arguments]


def _run(command: Sequence[str], say: Say) -> None:
    """Run a command that says what it does line by line; its last line is the reason where it fails."""
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
