"""Depth estimators as plug-ins: MoGe-2, or any class that a user names."""

import importlib.util
import sys
from functools import lru_cache
from pathlib import Path
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import SetupError, UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.known import GivenDepth
from kinebench_drake.grounding.sources.depth import known_depth
from kinebench_drake.plugin import is_class_name, load_class

_MOGE = "moge:"


class DepthSource(Protocol):
    """Another program's metric depth. A class that is named on the command line is made without arguments."""

    def depth(self, frames: NDArray[np.uint8], camera: Camera) -> NDArray[np.floating]:
        """Depth (T, H, W) along the camera's axis [m] of frames (T, H, W, 3) in RGB; 0 or not finite where unknown.

        Args:
            frames: the whole video.
            camera: what it was taken with, at the size of its frames.
        """
        ...


def is_depth_source(spec: str) -> bool:
    """Whether `spec` has the form `moge:CHECKPOINT` or `module:Class`."""
    return spec.startswith(_MOGE) or is_class_name(spec)


def depth_source_name(spec: str) -> str:
    """The spec as results name it: a checkpoint by its last name only."""
    return _MOGE + Path(spec.removeprefix(_MOGE)).name if spec.startswith(_MOGE) else spec


def check_depth_source(spec: str) -> None:
    """Hold a spec against this machine without loading a network.

    Raises:
        UsageError: there is no such checkpoint, package, module or class; the message says what to do.
    """
    if spec.startswith(_MOGE):
        checkpoint = Path(spec.removeprefix(_MOGE))
        if not checkpoint.is_file():
            raise UsageError(
                f"--depth {spec}: there is no file {checkpoint}; expected a MoGe-2 checkpoint, such as model.pt of "
                "Ruicheng/moge-2-vits-normal on Hugging Face"
            )
        if not _is_there("moge.model.v2"):
            raise UsageError(
                f"--depth {spec}: MoGe-2 is not installed; pip install git+https://github.com/microsoft/MoGe.git"
            )
    elif is_depth_source(spec):
        _class_of(spec)
    else:
        raise UsageError(f"--depth {spec}: expected moge:CHECKPOINT or module:Class")


def depth_source_files(spec: str) -> list[Path]:
    """What a plug-in consists of, as far as that can be told: the checkpoint, or the file of the class's module."""
    if spec.startswith(_MOGE):
        return [Path(spec.removeprefix(_MOGE))]
    file = getattr(sys.modules[_class_of(spec).__module__], "__file__", None)
    return [Path(file)] if file else []


@lru_cache(maxsize=4)
def load_depth_source(spec: str) -> DepthSource:
    """The estimator that `moge:CHECKPOINT` or `module:Class` names; once a process.

    Raises:
        UsageError: there is none.
        SetupError: it cannot be made ready.
    """
    check_depth_source(spec)
    try:
        if spec.startswith(_MOGE):
            from kinebench_drake.grounding.sources.moge import MogeDepth

            return MogeDepth(Path(spec.removeprefix(_MOGE)))
        return cast(DepthSource, _class_of(spec)())
    except Exception as error:  # another program's code, which may raise anything
        raise SetupError(f"--depth {spec}: cannot be made ready ({type(error).__name__}: {error})") from error


def estimate_depth(spec: str, frames: NDArray[np.uint8], camera: Camera, *, exact: bool = False) -> GivenDepth:
    """Depth of a video by a plug-in.

    Args:
        spec: `moge:CHECKPOINT` or `module:Class`.
        frames: (T, H, W, 3) RGB.
        camera: what they were taken with, at their size.
        exact: whether the depth can be trusted to a few millimetres.

    Raises:
        InputError: what the plug-in gives is no depth in metres.
        UsageError: there is no such plug-in.
        SetupError: it cannot be made ready.
    """
    depth_m: Array = np.asarray(load_depth_source(spec).depth(frames, camera), dtype=np.float64)
    return GivenDepth(depth_m=known_depth(depth_m, f"--depth {depth_source_name(spec)}"), exact=exact)


def _class_of(spec: str) -> type:
    return load_class(spec, option="--depth", method="depth", arguments="frames, camera")


def _is_there(module: str) -> bool:
    try:
        return module in sys.modules or importlib.util.find_spec(module) is not None
    except (ImportError, ValueError):
        return False
