"""Native libraries that wheels expect from the system, loaded from the environment if the system lacks them.

native.sh beside this module unpacks Debian packages (Mesa's software Vulkan driver, libusb, ...) below `sys.prefix`,
without changing the system, and writes one list of libraries per purpose. This module loads the lists before the module
that needs them: the dynamic linker then finds each library by name, without LD_LIBRARY_PATH or a restart.
"""

import ctypes
import os
import sys
import warnings
from functools import cache
from pathlib import Path
from typing import Any

from kinebench_drake.errors import SetupError

ROOT = Path(sys.prefix) / "share" / "kinebench_drake" / "native"
"""Folder of unpacked libraries; `open3d.txt`, `vulkan.txt`, ... list those to load, as paths relative to it."""

RENDER_VARIABLE = "KINEBENCH_DRAKE_RENDER"
"""Environment variable; `cpu` selects the software driver although an NVIDIA driver is installed."""

DRIVER_FOLDERS = (Path("/usr/share/vulkan/icd.d"), Path("/etc/vulkan/icd.d"))
NVIDIA_CONTROL = Path("/dev/nvidiactl")
_DRIVER_VARIABLES = ("VK_DRIVER_FILES", "VK_ICD_FILENAMES")


# of malloc.h
_M_TRIM_THRESHOLD = -1
_M_MMAP_THRESHOLD = -3
_M_ARENA_MAX = -8
_KEPT_BYTES = 1 << 28
_LARGEST_BYTES = 1 << 25


def _listed(purpose: str) -> list[Path]:
    """Return the libraries that were unpacked for a purpose; empty if the system has them all."""
    listing = ROOT / f"{purpose}.txt"
    return [ROOT / line for line in listing.read_text().splitlines() if line] if listing.is_file() else []


def _preload(purpose: str) -> None:
    """Load the libraries of `ROOT/purpose.txt`, in any order that their dependencies allow."""
    waiting = _listed(purpose)
    while waiting:
        failed = []
        reason = ""
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
def share_heap() -> None:
    """Let all threads use one heap that keeps what is freed; without effect where the C library is not glibc.

    By default an array of some MB is mapped anew each time, page by page, and what one thread frees no other one uses.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_ARENA_MAX, 1)
        mallopt(_M_MMAP_THRESHOLD, _LARGEST_BYTES)
        mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)


@cache
def prepare_drake() -> None:
    """Make `import pydrake` work on a system without GLib.

    native.sh arranges that this is called whenever the environment's Python starts; modules import pydrake as usual.

    Raises:
        SetupError: an unpacked library cannot be loaded.
    """
    _preload("drake")


@cache
def load_open3d() -> Any:
    """Import Open3D, also on a system without libusb, libGL or libEGL, with one thread.

    Its thread pool (TBB) adds in an order that depends on timing. It has as many threads as the process may use cores
    when it is loaded; with one, sums are reproducible to the bit.
    """
    _preload("open3d")
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    try:
        import open3d
    finally:
        os.sched_setaffinity(0, cores)
    return open3d


def has_nvidia_vulkan() -> bool:
    """Return whether an NVIDIA Vulkan driver and device are present."""
    return NVIDIA_CONTROL.exists() and any(
        driver for folder in DRIVER_FOLDERS for driver in folder.glob("*nvidia*.json")
    )


def ignore_vulkan_warning() -> None:
    """Hide SAPIEN's warning that it takes its own Vulkan loader: the unpacked driver works with it."""
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")


@cache
def prepare_vulkan() -> str:
    """Select the Vulkan driver and return SAPIEN's render backend, "gpu" or "cpu"; call before importing sapien.

    Order of preference: a driver named by the user (VK_DRIVER_FILES or VK_ICD_FILENAMES), an NVIDIA driver, the
    unpacked software driver (Mesa lavapipe), any other driver of the system.
    """
    _preload("vulkan")
    ignore_vulkan_warning()
    drivers = [os.environ[name] for name in _DRIVER_VARIABLES if os.environ.get(name)]
    if drivers:
        return "gpu" if "nvidia" in drivers[0] else "cpu"
    if os.environ.get(RENDER_VARIABLE) != "cpu" and has_nvidia_vulkan():
        return "gpu"
    driver = ROOT / "lavapipe.json"
    if driver.is_file():
        for name in _DRIVER_VARIABLES:
            os.environ[name] = str(driver)
    return "cpu"


def damage() -> str | None:
    """Return which of the unpacked libraries cannot be loaded, and why; None if all are or there are none.

    A truncated library can crash the process that loads it: call this in a separate process.
    """
    try:
        for purpose in ("drake", "open3d", "vulkan"):
            _preload(purpose)
    except SetupError as error:
        return str(error)
    return None
