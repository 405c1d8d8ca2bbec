"""Overrides of grounding stages: masks, depth and poses of other programs, and where they are read from.

Depth comes from files or from another program: a sensor, a simulator, or a plug-in class.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError, SetupError, UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.overrides.files import (
    array_files,
    errors_naming,
    is_demo_truth,
    pick,
    pose_files,
    read_masks,
    read_pngs,
    read_poses,
    true_depth,
)
from kinebench_drake.grounding.priors import NO_PRIORS, ExternalDepth, Priors
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.npz import open_npz, read_npy
from kinebench_drake.plugin import is_class_name, load_class
from kinebench_drake.track import InitialState

_NEAR_M = 0.02
"""Least median depth of a scene with a robot [m]."""
_FAR_M = 50.0
"""Greatest median depth of a scene with a robot [m]."""
TRUTH = "truth"
TRACKS = "tracks"
"""Subfolder of a demonstration folder, and of the output folder of another run."""
_POSE_PLACES = (TRUTH, TRACKS)


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


@dataclass(frozen=True, slots=True)
class DepthPlugIn:
    """Depth estimator of another program by its name on the command line; picklable, unlike the estimator."""

    spec: str
    """`module:Class` or `FILE.py:Class`."""

    @property
    def files(self) -> list[Path]:
        """File of the class's module, if it has one."""
        file = getattr(sys.modules[self.load_class().__module__], "__file__", None)
        return [Path(file)] if file else []

    @lru_cache(maxsize=4)  # noqa: B019 - once per process, for few specs
    def load(self) -> DepthSource:
        """Create the estimator, once per process.

        Raises:
            UsageError: it does not exist.
            SetupError: it cannot be created.
        """
        kind = self.load_class()
        try:
            return cast(DepthSource, kind())
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
        with errors_naming(f"$depth {self.spec}"):
            return ExternalDepth(depth_m=_checked_depth(depth_m), exact=exact)

    def load_class(self) -> type:
        """Import the class, without creating the estimator.

        Raises:
            UsageError: module or class does not exist.
        """
        if not is_class_name(self.spec):
            raise UsageError(f"$depth {self.spec}: expected a folder, module:Class or FILE.py:Class")
        return load_class(self.spec, argument="depth", method="depth", arguments="frames, camera")


def find_entry(folder: Path, names: Sequence[str], places: Sequence[str] = (TRUTH,)) -> Path:
    """Find the file `NAME.npz` or `NAME.npy` or the folder `NAME/` of a video by its names, the preferred one first.

    Subfolders `places` precede the folder itself, which may hold the videos under the same names.

    Raises:
        InputError: there is none.
    """
    for name in names:
        for place in (*places, ""):
            for file in (folder / place / f"{name}.npz", folder / place / f"{name}.npy"):
                if file.is_file():
                    return file
            if (folder / place / name).is_dir():
                return folder / place / name
    expected = " or ".join(f"{name}.npz, {name}.npy, {name}/" for name in names)
    where = " and ".join(f"{place}/" for place in places)
    raise InputError(
        f"{folder.resolve().name} has nothing for this video: looked for {expected} in it and in its {where}"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Overrides:
    """Sources of masks, depth and poses named on the command line; picklable, unlike their content."""

    masks: Path | None = None
    """Folder of masks."""
    depth: str | None = None
    """Folder of depth, `module:Class` or `FILE.py:Class`."""
    poses: Path | None = None
    """Folder of poses."""
    depth_exact: bool = False
    """True if the depth is accurate to a few millimetres."""

    def __post_init__(self) -> None:
        """Check that all sources exist.

        Raises:
            UsageError: one does not exist, or `depth_exact` is set without `depth`.
        """
        if self.depth_exact and self.depth is None:
            raise UsageError("$depth_exact says how good the depth of $depth is; give that as well")
        for name, folder in (("masks", self.masks), ("poses", self.poses)):
            if folder is not None and not folder.is_dir():
                raise UsageError(f"${name} {folder}: there is no such folder")
        if self._plug_in is not None:
            self._plug_in.load_class()

    @property
    def folders(self) -> dict[str, Path]:
        """Folders of the overrides by stage: their images are no videos."""
        depth = Path(self.depth) if self.depth is not None and Path(self.depth).is_dir() else None
        named = {"masks": self.masks, "depth": depth, "poses": self.poses}
        return {stage: folder for stage, folder in named.items() if folder is not None}

    @property
    def names(self) -> dict[str, str]:
        """Source of each replaced stage, for results: without absolute paths."""
        names = {stage: folder.resolve().name for stage, folder in self.folders.items()}
        if self._plug_in is not None:
            names["depth"] = self._plug_in.spec
        return dict(sorted(names.items()))

    def files(self, video: Sequence[str]) -> list[Path]:
        """Return the files that `priors` reads for a video, in a fixed order; `video` as in `priors`."""
        files: list[Path] = []
        try:
            for stage, folder in self.folders.items():
                is_pose = stage == "poses"
                entry = find_entry(folder, video, _POSE_PLACES if is_pose else (TRUTH,))
                files += pose_files(folder, entry) if is_pose else array_files(entry)
        except InputError:
            return files  # the video becomes an error row, which is never reused
        return files if self._plug_in is None else [*files, *self._plug_in.files]

    def priors(self, video: Sequence[str], frames: Frames, camera: Camera, first: InitialState | None = None) -> Priors:
        """Read the priors of a video by its names, the preferred one first.

        Its frames (T, H, W, 3) and their camera, at their size, are the input of a plug-in; `first` is the state of the
        robot in the first one.

        Raises:
            InputError: a source has nothing for the video, does not fit it or is broken; the message names the stage.
            SetupError: the plug-in cannot be created.
        """
        priors = NO_PRIORS
        mask = None
        depth = None
        if self.masks is not None:
            with errors_naming("$masks"):
                mask = read_masks(find_entry(self.masks, video))
        if "depth" in self.folders:
            with errors_naming("$depth"):
                depth = read_depth(find_entry(self.folders["depth"], video), exact=self.depth_exact)
        if self.poses is not None:
            with errors_naming("$poses"):
                priors = read_poses(self.poses, find_entry(self.poses, video, _POSE_PLACES), len(frames))
        if self._plug_in is not None:
            depth = self._plug_in.estimate(frames, camera, exact=self.depth_exact)
        priors = replace(priors, initial_state=first, mask=mask, depth=depth)
        priors.check_shapes(*frames.shape[:3])
        return priors

    @property
    def _plug_in(self) -> DepthPlugIn | None:
        return None if self.depth is None or "depth" in self.folders else DepthPlugIn(self.depth)
