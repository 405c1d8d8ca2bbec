"""Back-projection: from a depth map to points in the crop's camera frame."""

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.grounding.view import GripperView

_EDGE_JUMP = 0.03  # relative depth step to a neighbour beyond which a cell straddles an edge


def gripper_cloud(view: GripperView) -> Array:
    """Points (N, 3) [m] of the view's gripper cells in V, cells on depth edges left out."""
    depth = np.where(view.gripper, view.depth_m, np.nan)
    jump = np.zeros(depth.shape, dtype=bool)
    for axis in (0, 1):
        step = np.abs(np.diff(np.log(depth), axis=axis)) > _EDGE_JUMP
        before = [(0, 1) if a == axis else (0, 0) for a in (0, 1)]
        after = [(1, 0) if a == axis else (0, 0) for a in (0, 1)]
        jump |= np.pad(step, before) | np.pad(step, after)
    keep = view.gripper & ~jump & np.isfinite(depth)
    return np.asarray(view.rays()[keep] * depth[keep][:, None])
