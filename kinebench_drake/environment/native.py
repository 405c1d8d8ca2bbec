"""Native libraries that wheels expect from the system: found beside the environment when the system lacks them.

The set-up script, native.sh beside this module, unpacks Debian packages (Mesa's software Vulkan driver, libusb, ...)
under `sys.prefix`, without touching the system, and writes one list of libraries a purpose. The lists are loaded here,
before the module that needs them: the dynamic linker then finds each by its name, without LD_LIBRARY_PATH or a restart.
"""

import ctypes
import json
import os
import sys
import warnings
from functools import cache
from pathlib import Path

from kinebench_drake.errors import SetupError

ROOT = Path(sys.prefix) / "share" / "kinebench_drake" / "native"
"""Where the set-up script unpacks libraries; `open3d.txt`, `vulkan.txt`, ... list what to load, as paths below it."""

RENDER_VARIABLE = "KINEBENCH_DRAKE_RENDER"
"""Set to `cpu` to render with the software driver although an NVIDIA driver is installed."""

_DRIVER_FOLDERS = (Path("/usr/share/vulkan/icd.d"), Path("/etc/vulkan/icd.d"))
_NVIDIA_CONTROL = Path("/dev/nvidiactl")
_DRIVER_VARIABLES = ("VK_DRIVER_FILES", "VK_ICD_FILENAMES")


def _listed(purpose: str) -> list[Path]:
    """Libraries that the set-up script unpacked for a purpose; none where the system has them all."""
    listing = ROOT / f"{purpose}.txt"
    return [ROOT / line for line in listing.read_text().splitlines() if line] if listing.is_file() else []


def _preload(purpose: str) -> None:
    """Load the libraries of `ROOT/purpose.txt`, in whatever order their dependencies allow."""
    waiting = _listed(purpose)
    while waiting:
        failed, reason = [], ""
        for library in waiting:
            try:
                ctypes.CDLL(str(library))
            except OSError as error:
                failed.append(library)
                reason = str(error)
        if len(failed) == len(waiting):
            raise SetupError(
                f"cannot load {failed[0].name} ({reason}); `kinebench-drake doctor --fix` unpacks it again"
            )
        waiting = failed


@cache
def prepare_drake() -> None:
    """Make `import pydrake` work on a system without GLib.

    The set-up script has this called whenever the environment's Python starts, so modules import pydrake as usual.

    Raises:
        SetupError: an unpacked library cannot be loaded.
    """
    _preload("drake")


@cache
def prepare_open3d() -> None:
    """Make `import open3d` work on a system without libusb, libGL or libEGL; call before importing it.

    Raises:
        SetupError: an unpacked library cannot be loaded.
    """
    _preload("open3d")


def has_nvidia_vulkan() -> bool:
    """Whether an NVIDIA Vulkan driver is installed with a device to drive."""
    return _NVIDIA_CONTROL.exists() and any(
        driver for folder in _DRIVER_FOLDERS for driver in folder.glob("*nvidia*.json")
    )


@cache
def prepare_vulkan() -> str:
    """Make SAPIEN render; call before importing sapien or mani_skill. Returns their render backend: "gpu" or "cpu".

    A driver named by the user (VK_DRIVER_FILES or VK_ICD_FILENAMES) goes before an NVIDIA driver, that before the
    unpacked software driver (Mesa lavapipe), that before what else the system has.

    Raises:
        SetupError: an unpacked library cannot be loaded.
    """
    _preload("vulkan")
    # The set-up's driver needs no newer loader than the one SAPIEN brings, so this says nothing that users must act on.
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
    chosen = [os.environ[name] for name in _DRIVER_VARIABLES if os.environ.get(name)]
    if chosen:
        return "gpu" if "nvidia" in chosen[0] else "cpu"
    if os.environ.get(RENDER_VARIABLE) != "cpu" and has_nvidia_vulkan():
        return "gpu"
    driver = ROOT / "lavapipe.json"
    if driver.is_file():
        for name in _DRIVER_VARIABLES:
            os.environ[name] = str(driver)
    return "cpu"


def damage() -> str | None:
    """What is wrong with the unpacked libraries; None where they are whole or there are none. Loads them all.

    A torn library can crash the process that loads it: ask in a process of its own.
    """
    if not ROOT.exists():
        return None
    if not (ROOT / "wanted.txt").is_file():
        return f"{ROOT} was never finished"
    for purpose in ("drake", "open3d", "vulkan", "tcmalloc"):
        for library in _listed(purpose):
            if not library.is_file():
                return f"{library.relative_to(ROOT)} is missing in {ROOT}"
    driver = ROOT / "lavapipe.json"
    if "mesa" in (ROOT / "wanted.txt").read_text().split():
        try:
            library = Path(json.loads(driver.read_text())["ICD"]["library_path"])
        except (OSError, ValueError, KeyError, TypeError):
            return f"{driver} cannot be read"
        if not (library.is_file() and library.is_relative_to(ROOT)):
            return f"{driver} names {library}: the environment was moved or copied"
    try:
        for purpose in ("drake", "open3d", "vulkan"):
            _preload(purpose)
    except SetupError as error:
        return str(error)
    return None


def allocator() -> Path | None:
    """The unpacked tcmalloc, for LD_PRELOAD of a training process; None where the set-up script found none."""
    return next(iter(_listed("tcmalloc")), None)
