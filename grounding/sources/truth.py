"""Depth and masks in the truth of demonstrations: `truth/ID.npz` as `kinebench-drake suite demos` writes it."""

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array
from kinebench_drake.npz import Archive

_HALF_MM = 0.5  # stored depth is cut towards zero


def holds_truth(archive: Archive) -> bool:
    """Whether an archive is the truth of a demonstration with depth and mask, not another program's arrays."""
    return {"camera_from_hand", "depth_mm", "mask"} <= set(archive.files)


def true_depth(archive: Archive) -> Array:
    """Depth (T, H, W) along the camera's axis [m]; 0 where nothing is."""
    depth_mm = archive["depth_mm"]
    if depth_mm.dtype.kind not in "iuf":
        raise InputError(f"the depth is {depth_mm.dtype}, expected numbers")
    return np.asarray(np.where(depth_mm > 0, depth_mm + _HALF_MM, 0.0) / 1000.0)


def true_mask(archive: Archive) -> NDArray[np.bool_]:
    """Pixels (T, H, W) that show the gripper; stored packed along the width, which the depth tells."""
    shape, packed = archive.shape("depth_mm"), archive["mask"]
    if packed.dtype != np.uint8 or len(shape) != 3 or packed.shape != (*shape[:2], -(-shape[2] // 8)):
        raise InputError(f"the mask is {packed.dtype} of shape {packed.shape}, which does not fit the depth's {shape}")
    return np.unpackbits(packed, axis=-1, count=shape[2]).astype(bool)
