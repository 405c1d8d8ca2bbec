"""Metric depth in files: from a sensor, a simulator or another estimator."""

import importlib.util
import sys
from functools import lru_cache
from pathlib import Path
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError, SetupError, UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.overrides.arrays import (
    holds_truth,
    open_archive,
    pick,
    png_files,
    read_npy,
    read_pngs,
    true_depth,
)
from kinebench_drake.plugin import is_class_name, load_class
from kinebench_drake.types import ExternalDepth

_NEAR_M, _FAR_M = 0.02, 50.0  # no scene with a robot in view has a median depth beyond


def depth_files(entry: Path) -> list[Path]:
    """The files that `read_depth` reads."""
    return png_files(entry) if entry.is_dir() else [entry]


def read_depth(entry: Path, *, exact: bool = False) -> ExternalDepth:
    """Depth of every frame along the camera's axis; what is not positive and finite is unknown.

    Args:
        entry: npz with `depth_m`, `depth_mm` or `depth`, npy, folder of one 16-bit png a frame, or the truth of a
            demonstration, which is exact. Where the name does not tell, whole numbers are millimetres, others metres.
        exact: whether the depth can be trusted to a few millimetres.

    Raises:
        InputError: it cannot be read, or is no depth in metres.
    """
    if entry.is_dir():
        pictures = read_pngs(entry)
        if pictures.ndim != 3 or pictures.dtype.itemsize < 2:
            raise InputError(f"{entry.name}/: the pictures have 8 bits or colours, expected 16-bit grey in millimetres")
        return ExternalDepth(depth_m=_metres(pictures, "depth_mm", entry), exact=exact)
    if entry.suffix == ".npy":
        return ExternalDepth(depth_m=_metres(read_npy(entry), "depth", entry), exact=exact)
    with open_archive(entry) as archive:
        if holds_truth(archive):
            return ExternalDepth(depth_m=true_depth(archive), exact=True)
        name, array = pick(archive, ("depth_m", "depth_mm", "depth"), entry)
        return ExternalDepth(depth_m=_metres(array, name, entry), exact=exact)


def known_depth(depth_m: Array, source: str) -> Array:
    """Depth with 0 where it is unknown.

    Args:
        depth_m: (T, H, W) along the camera's axis [m].
        source: what messages call it.

    Raises:
        InputError: nothing is known, or it cannot be in metres.
    """
    seen = np.isfinite(depth_m) & (depth_m > 0)
    if not seen.any():
        raise InputError(f"{source}: no depth is known in any frame; expected metres, positive before the camera")
    median = float(np.median(depth_m[seen]))
    if not _NEAR_M <= median <= _FAR_M:
        raise InputError(f"{source}: the median depth is {median:.4g} m; is it in another unit than said?")
    return np.where(seen, depth_m, 0.0)


def _metres(array: NDArray[np.generic], name: str, entry: Path) -> Array:
    if array.dtype.kind not in "iuf":
        raise InputError(f"{entry.name}: the depth is {array.dtype}, expected numbers")
    whole_mm = name == "depth_mm" or (name == "depth" and array.dtype.kind in "iu")
    return known_depth(array.astype(np.float64) / (1000.0 if whole_mm else 1.0), entry.name)


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
            from kinebench_drake.grounding.overrides.moge import MogeDepth

            return MogeDepth(Path(spec.removeprefix(_MOGE)))
        return cast(DepthSource, _class_of(spec)())
    except Exception as error:  # another program's code, which may raise anything
        raise SetupError(f"--depth {spec}: cannot be made ready ({type(error).__name__}: {error})") from error


def estimate_depth(spec: str, frames: NDArray[np.uint8], camera: Camera, *, exact: bool = False) -> ExternalDepth:
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
    return ExternalDepth(depth_m=known_depth(depth_m, f"--depth {depth_source_name(spec)}"), exact=exact)


def _class_of(spec: str) -> type:
    return load_class(spec, option="--depth", method="depth", arguments="frames, camera")


def _is_there(module: str) -> bool:
    try:
        return module in sys.modules or importlib.util.find_spec(module) is not None
    except (ImportError, ValueError):
        return False
