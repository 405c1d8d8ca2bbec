"""Depth and masks in the truth of demonstrations: `truth/ID.npz` as `kinebench-drake suite demos` writes it."""

from typing import cast
from zipfile import ZipFile

import numpy as np
from numpy.lib.format import read_array_header_1_0, read_magic
from numpy.lib.npyio import NpzFile
from numpy.typing import NDArray

from kinebench_drake.geometry import Array

_HALF_MM = 0.5  # stored depth is cut towards zero


def holds_truth(archive: NpzFile) -> bool:
    """Whether an archive is the truth of a demonstration with depth and mask, not another program's arrays."""
    return {"camera_from_hand", "depth_mm", "mask"} <= set(archive.files)


def true_depth(archive: NpzFile) -> Array:
    """Depth (T, H, W) along the camera's axis [m]; 0 where nothing is."""
    depth_mm = archive["depth_mm"]
    return np.asarray(np.where(depth_mm > 0, depth_mm + _HALF_MM, 0.0) / 1000.0)


def true_mask(archive: NpzFile) -> NDArray[np.bool_]:
    """Pixels (T, H, W) that show the gripper; stored packed along the width, which the depth tells."""
    with cast(ZipFile, archive.zip).open("depth_mm.npy") as file:
        read_magic(file)
        shape, _, _ = read_array_header_1_0(file)
    return np.unpackbits(archive["mask"], axis=-1, count=shape[2]).astype(bool)
