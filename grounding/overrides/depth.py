"""Metric depth from files or from another program: a sensor, a simulator, MoGe-2, or a plug-in class."""

import importlib.util
import sys
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError, SetupError, UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.overrides.files import (
    errors_naming,
    is_demo_truth,
    pick,
    read_pngs,
    true_depth,
)
from kinebench_drake.grounding.priors import ExternalDepth
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.npz import open_npz, read_npy
from kinebench_drake.plugin import is_class_name, load_class

_NEAR_M = 0.02
"""Least median depth of a scene with a robot [m]."""
_FAR_M = 50.0
"""Greatest median depth of a scene with a robot [m]."""
_MOGE = "moge:"


def read_depth(entry: Path, *, exact: bool = False) -> ExternalDepth:
    """Read the depth of every frame along the camera's axis; values that are not positive and finite are unknown.

    Args:
        entry: npz with `depth_m`, `depth_mm` or `depth`, npy, folder of one 16-bit png per frame, or the ground truth
            of a demonstration, which is exact. In `depth` and npy, whole numbers are millimetres, others metres.
        exact: True if the depth is accurate to a few millimetres.

    Raises:
        InputError: it cannot be read, or is no depth in metres.
    """
    with errors_naming(entry):
        if entry.is_dir():
            images = read_pngs(entry)
            if images.ndim != 3 or images.dtype.itemsize < 2:
                raise InputError("the images have 8 bits or colours, expected 16-bit grey in millimetres")
            return ExternalDepth(depth_m=_metres(images, "depth_mm"), exact=exact)
        if entry.suffix == ".npy":
            return ExternalDepth(depth_m=_metres(read_npy(entry), "depth"), exact=exact)
        with open_npz(entry) as archive:
            if is_demo_truth(archive):
                return ExternalDepth(depth_m=true_depth(archive), exact=True)
            name, array = pick(archive, ("depth_m", "depth_mm", "depth"))
            return ExternalDepth(depth_m=_metres(array, name), exact=exact)


def _metres(array: NDArray[np.generic], name: str) -> Array:
    if array.dtype.kind not in "iuf":
        raise InputError(f"the depth is {array.dtype}, expected numbers")
    whole_mm = name == "depth_mm" or (name == "depth" and array.dtype.kind in "iu")
    return _checked_depth(array.astype(np.float64) / (1000.0 if whole_mm else 1.0))


def _checked_depth(depth_m: Array) -> Array:
    """Return depth (T, H, W) [m] with 0 where it is unknown.

    Raises:
        InputError: all of it is unknown, or it cannot be in metres.
    """
    valid = np.isfinite(depth_m) & (depth_m > 0)
    if not valid.any():
        raise InputError("no depth is known in any frame; expected metres, positive before the camera")
    median = float(np.median(depth_m[valid]))
    if not _NEAR_M <= median <= _FAR_M:
        raise InputError(f"the median depth is {median:.4g} m; expected metres (another unit?)")
    return np.where(valid, depth_m, 0.0)


class DepthSource(Protocol):
    """Metric depth of another program; a class named on the command line is created without arguments."""

    def depth(self, frames: NDArray[np.uint8], camera: Camera) -> NDArray[np.floating]:
        """Estimate depth (T, H, W) along the camera's axis [m]; 0 or not finite where unknown.

        Args:
            frames: (T, H, W, 3) RGB, the whole video.
            camera: camera of the frames, at their size.
        """
        ...


class MogeDepth:
    """Depth by a checkpoint of MoGe-2, given the camera's field of view; on a GPU if there is one."""

    def __init__(self, checkpoint: Path) -> None:
        """Load the network from the file `checkpoint`, such as model.pt."""
        import torch
        from moge.model.v2 import MoGeModel

        self._device = "cuda" if torch.cuda.is_available() else "cpu"
        self._model = MoGeModel.from_pretrained(str(checkpoint)).to(self._device).eval()

    def depth(self, frames: NDArray[np.uint8], camera: Camera) -> NDArray[np.floating]:
        """Estimate depth (T, H, W) of frames (T, H, W, 3) [m]; 0 where the network finds no surface."""
        import torch

        fov_x_deg = float(np.degrees(2.0 * np.arctan(camera.width / (2.0 * camera.fx))))
        depth_m = np.zeros(frames.shape[:3], np.float32)
        for i, frame in enumerate(frames):
            image = torch.from_numpy(frame / np.float32(255.0)).permute(2, 0, 1).to(self._device)
            output = self._model.infer(image, fov_x=fov_x_deg, use_fp16=self._device == "cuda")
            depth_m[i] = np.nan_to_num(output["depth"].float().cpu().numpy(), nan=0.0, posinf=0.0)  # inf: no surface
        return depth_m


@dataclass(frozen=True, slots=True)
class DepthPlugIn:
    """Depth estimator of another program by its name on the command line; picklable, unlike the estimator."""

    spec: str
    """`moge:CHECKPOINT` or `module:Class`."""

    @property
    def checkpoint(self) -> Path | None:
        """Checkpoint of MoGe-2; None for a class."""
        return Path(self.spec.removeprefix(_MOGE)) if self.spec.startswith(_MOGE) else None

    @property
    def name(self) -> str:
        """The spec for results: a checkpoint by its file name only."""
        return self.spec if self.checkpoint is None else _MOGE + self.checkpoint.name

    @property
    def files(self) -> list[Path]:
        """Files that shape the depth, as far as known: the checkpoint, or the file of the class's module."""
        if self.checkpoint is not None:
            return [self.checkpoint]
        file = getattr(sys.modules[self._load_class().__module__], "__file__", None)
        return [Path(file)] if file else []

    def check(self) -> None:
        """Check that everything the spec names exists, without loading a network.

        Raises:
            UsageError: checkpoint, package, module or class does not exist.
        """
        if self.checkpoint is None:
            self._load_class()
        elif not self.checkpoint.is_file():
            raise UsageError(
                f"$depth {self.spec}: there is no file {self.checkpoint}; expected a MoGe-2 checkpoint, such as "
                "model.pt of Ruicheng/moge-2-vits-normal on Hugging Face"
            )
        elif not _is_importable("moge.model.v2"):
            raise UsageError(
                f"$depth {self.spec}: MoGe-2 is not installed; pip install git+https://github.com/microsoft/MoGe.git"
            )

    @lru_cache(maxsize=4)  # noqa: B019 - once per process, for few specs
    def load(self) -> DepthSource:
        """Create the estimator, once per process.

        Raises:
            UsageError: it does not exist.
            SetupError: it cannot be created.
        """
        self.check()
        try:
            return cast(DepthSource, self._load_class()()) if self.checkpoint is None else MogeDepth(self.checkpoint)
        except Exception as error:  # another program's code, which may raise anything
            raise SetupError(f"$depth {self.spec}: cannot be created ({type(error).__name__}: {error})") from error

    def estimate(self, frames: Frames, camera: Camera, *, exact: bool = False) -> ExternalDepth:
        """Estimate the depth of a video, as `DepthSource.depth`; `exact` if it is accurate to a few millimetres.

        Raises:
            InputError: the output of the plug-in is no depth in metres.
            UsageError: the plug-in does not exist.
            SetupError: it cannot be created.
        """
        depth_m: Array = np.asarray(self.load().depth(np.asarray(frames), camera), dtype=np.float64)
        with errors_naming(f"$depth {self.name}"):
            return ExternalDepth(depth_m=_checked_depth(depth_m), exact=exact)

    def _load_class(self) -> type:
        if not is_class_name(self.spec):
            raise UsageError(f"$depth {self.spec}: expected a folder, moge:CHECKPOINT or module:Class")
        return load_class(self.spec, argument="depth", method="depth", arguments="frames, camera")


def _is_importable(module: str) -> bool:
    try:
        return module in sys.modules or importlib.util.find_spec(module) is not None
    except (ImportError, ValueError):
        return False
