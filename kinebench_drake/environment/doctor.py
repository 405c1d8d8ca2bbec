"""Checks of this machine: what works, and how to fix what does not."""

import importlib.metadata
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from kinebench_drake.environment import native
from kinebench_drake.io.files import cache_folder

FIX = "`kinebench-drake doctor --fix`"
CLONE = "in a clone: delete .venv, run setup/install.sh"
WEIGHTS = Path(__file__).parents[1] / "models" / "perception"
CV2_OWNERS = ("opencv-python", "opencv-python-headless", "opencv-contrib-python", "opencv-contrib-python-headless")
NATIVE_CHECKS = ("native libraries", "Drake", "Open3D", "Vulkan device")
"""Names of the checks that fail if native libraries are missing or damaged."""
CV2_CHECK = "cv2"
PROBE_TIMEOUT_S = 120.0


@dataclass(frozen=True, slots=True)
class Check:
    """Outcome of one check."""

    name: str
    """Subject of the check."""
    ok: bool
    """True if it works."""
    detail: str
    """Version or device, or the reason why it does not work."""
    fix: str
    """How to fix it if it does not work."""


class _BrokenError(Exception):
    """Raised by a check whose subject does not work; the message is the detail."""


def run_checks() -> list[Check]:
    """Check everything that a run needs; takes some seconds, as the large libraries are really loaded.

    Libraries that could crash are loaded in separate processes.
    """
    return [
        check("native libraries", _native, FIX),
        check("Drake", _drake, f"{FIX}; a damaged package: {_reinstall('drake')}"),
        check("torch", _torch, f"{_reinstall('torch')}; {CLONE}"),
        check("Open3D", _open3d, f"{FIX}; a damaged package: {_reinstall('open3d')}"),
        check(CV2_CHECK, _cv2, FIX),
        check(
            "perception weights",
            _weights,
            "install kinebench-drake's wheel again; in a clone, restore models/perception/ from the repository",
        ),
        check("cache folder", _cache_folder, "set XDG_CACHE_HOME to a folder that you can write to"),
    ]


def render(checks: Sequence[Check]) -> str:
    """Format the checks as a table, each failure followed by its fix, with a summary line."""
    width = max((len(check.name) for check in checks), default=0)
    lines = []
    for check in checks:
        lines.append(f"{'ok' if check.ok else 'FAIL':<5} {check.name:<{width}}  {check.detail}".rstrip())
        if not check.ok:
            lines.append(f"{'':<5} {'':<{width}}  fix: {check.fix}")
    failed = sum(not check.ok for check in checks)
    lines.append(f"{failed} of {len(checks)} checks failed." if failed else f"All {len(checks)} checks passed.")
    return "\n".join(lines)


def check(name: str, run: Callable[[], str], fix: str) -> Check:
    """Return the outcome of a check; `run` returns its detail or raises why it fails."""
    try:
        return Check(name, True, run(), fix)
    except Exception as error:  # any failure on this machine is a result
        return Check(name, False, _one_line(error), fix)


def _one_line(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return lines[0] if lines else type(error).__name__


def probe(code: str) -> str:
    """Run code in a new interpreter; return its last line of output, or raise with the last line of its errors."""
    try:
        # -P: a file in the working directory must not shadow a library of the same name.
        command = [sys.executable, "-P", "-c", code]
        done = subprocess.run(command, capture_output=True, text=True, timeout=PROBE_TIMEOUT_S)
    except subprocess.TimeoutExpired as error:
        raise _BrokenError(f"no answer within {PROBE_TIMEOUT_S:.0f} s") from error
    if done.returncode < 0:
        raise _BrokenError(f"crashed with signal {-done.returncode}")
    if done.returncode:
        raise _BrokenError((done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1])
    return done.stdout.strip().splitlines()[-1]


def _reinstall(package: str) -> str:
    return f"`python -m pip install --force-reinstall --no-deps {package}`"


def _native() -> str:
    """Load each library that was unpacked below the environment."""
    damage = probe("from kinebench_drake.environment import native\nprint(native.damage())")
    if damage != "None":
        raise _BrokenError(damage)
    wanted = native.ROOT / "wanted.txt"
    return f"unpacked: {', '.join(wanted.read_text().split())}" if wanted.is_file() else "none unpacked"


def _drake() -> str:
    probe(
        "from kinebench_drake.environment import native\n"
        "native.prepare_drake()\n"
        "from pydrake.multibody.plant import MultibodyPlant\n"
        "MultibodyPlant(0.0).Finalize()\n"
        "print('loaded')"
    )
    return importlib.metadata.version("drake")


def _torch() -> str:
    return probe(
        "import torch\n"
        "gpu = torch.cuda.is_available()\n"
        "torch.ones(2, device='cuda' if gpu else 'cpu').sum().item()\n"
        "device = torch.cuda.get_device_name() if gpu else f'CPU, {torch.get_num_threads()} threads'\n"
        "print(f'{torch.__version__} on {device}')"
    )


def _open3d() -> str:
    return probe(
        "from kinebench_drake.environment import native\n"
        "open3d = native.load_open3d()\n"
        "open3d.t.geometry.RaycastingScene()\n"
        "print(open3d.__version__)"
    )


def cv2_owners() -> list[str]:
    """Return the names of the installed distributions that contain a module `cv2`."""
    owners = []
    for name in CV2_OWNERS:
        try:
            files = importlib.metadata.files(name) or []
        except importlib.metadata.PackageNotFoundError:
            continue
        if any(file.parts[0] == "cv2" for file in files):
            owners.append(name)
    return owners


def _cv2() -> str:
    """Check that only opencv-python-headless owns `cv2`: two owners would overwrite each other's files."""
    owners = cv2_owners()
    if owners != ["opencv-python-headless"]:
        raise _BrokenError(f"cv2 comes from {' and '.join(owners) or 'nowhere'}, expected opencv-python-headless alone")
    return f"{probe('import cv2; print(cv2.__version__)')}, opencv-python-headless alone"


def _weights() -> str:
    from safetensors.numpy import load_file

    files = sorted(WEIGHTS.glob("*.safetensors"))
    if not files:
        raise _BrokenError(f"no *.safetensors in {WEIGHTS}")
    networks = []
    for file in files:
        try:
            parameters = sum(array.size for array in load_file(file).values())
        except Exception as error:  # safetensors raises various errors for a truncated file or a Git LFS pointer
            raise _BrokenError(f"{file.name} cannot be read ({_one_line(error)})") from error
        networks.append(f"{file.stem} ({parameters / 1e6:.1f} M parameters)")
    return ", ".join(networks)


def _cache_folder() -> str:
    folder = cache_folder()
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=folder):
        return str(folder)
