"""Metric depth in files: from a sensor, a simulator or another estimator."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.known import GivenDepth
from kinebench_drake.grounding.sources.arrays import open_archive, pick, png_files, read_npy, read_pngs
from kinebench_drake.grounding.sources.truth import holds_truth, true_depth

_NEAR_M, _FAR_M = 0.02, 50.0  # no scene with a robot in view has a median depth beyond


def depth_files(entry: Path) -> list[Path]:
    """The files that `read_depth` reads."""
    return png_files(entry) if entry.is_dir() else [entry]


def read_depth(entry: Path, *, exact: bool = False) -> GivenDepth:
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
        return GivenDepth(depth_m=_metres(pictures, "depth_mm", entry), exact=exact)
    if entry.suffix == ".npy":
        return GivenDepth(depth_m=_metres(read_npy(entry), "depth", entry), exact=exact)
    with open_archive(entry) as archive:
        if holds_truth(archive):
            return GivenDepth(depth_m=true_depth(archive), exact=True)
        name, array = pick(archive, ("depth_m", "depth_mm", "depth"), entry)
        return GivenDepth(depth_m=_metres(array, name, entry), exact=exact)


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
