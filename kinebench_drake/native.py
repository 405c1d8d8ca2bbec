"""Native libraries that wheels expect from the system: found beside the environment when the system lacks them.

The set-up script unpacks Debian packages (Mesa's software Vulkan driver, libusb, ...) under `sys.prefix`, without
touching the system, and writes one list of libraries a purpose. The lists are loaded here, before the module that
needs them: the dynamic linker then finds each by its name, without LD_LIBRARY_PATH or a restart.
"""

import ctypes
import os
import sys
from functools import cache
from pathlib import Path

from kinebench_drake.errors import SetupError

ROOT = Path(sys.prefix) / "share" / "kinebench_drake" / "native"
"""Where the set-up script unpacks libraries; `open3d.txt` and `vulkan.txt` there list what to load (paths below it)."""

_NVIDIA_DRIVERS = ("/usr/share/vulkan/icd.d/nvidia_icd.json", "/etc/vulkan/icd.d/nvidia_icd.json")


def _preload(purpose: str) -> None:
    """Load the libraries of `ROOT/purpose.txt`, in whatever order their dependencies allow."""
    listing = ROOT / f"{purpose}.txt"
    waiting = [ROOT / line for line in listing.read_text().split()] if listing.is_file() else []
    while waiting:
        failed, reason = [], ""
        for library in waiting:
            try:
                ctypes.CDLL(str(library))
            except OSError as error:
                failed.append(library)
                reason = str(error)
        if len(failed) == len(waiting):
            raise SetupError(f"cannot load {failed[0].name} ({reason}); run setup/install.sh again")
        waiting = failed


@cache
def prepare_open3d() -> None:
    """Make `import open3d` work on a system without libusb; call before importing it.

    Raises:
        SetupError: an unpacked library cannot be loaded.
    """
    _preload("open3d")


def has_nvidia_vulkan() -> bool:
    """Whether an NVIDIA Vulkan driver is installed with a device to drive."""
    return Path("/dev/nvidiactl").exists() and any(Path(p).is_file() for p in _NVIDIA_DRIVERS)


@cache
def prepare_vulkan() -> str:
    """Make SAPIEN render; call before importing sapien or mani_skill. Returns their render backend: "gpu" or "cpu".

    An NVIDIA driver or VK_DRIVER_FILES set by the user goes before the unpacked software driver (Mesa lavapipe).

    Raises:
        SetupError: an unpacked library cannot be loaded.
    """
    if has_nvidia_vulkan():
        return "gpu"
    driver = ROOT / "lavapipe.json"
    if driver.is_file() and "VK_DRIVER_FILES" not in os.environ:
        _preload("vulkan")
        os.environ["VK_DRIVER_FILES"] = os.environ["VK_ICD_FILENAMES"] = str(driver)
    return "cpu"
