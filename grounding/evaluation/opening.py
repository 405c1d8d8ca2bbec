"""Open or closed: whether the gap between the pads is read right where it matters.

The gap decides, not the grasp: fingers closed on an object count as closed where the gap is the smaller of the
episode's two. The boundary is halfway between the least and the greatest true gap of the episode; where these differ
by less than twice the margin (a gripper that stays as it is), it is halfway of the gripper's own range. Frames whose
true gap lies within the margin of the boundary are not judged.
"""

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array

MARGIN_M = 0.008
"""True gaps nearer than this to the boundary are not judged [m]."""
HALFWAY_M = 0.04
"""Halfway of the gripper's range, 0..0.08 [m]."""


def boundary(true_width_m: Array) -> float:
    """The gap between closed and open in an episode with true gaps (T,), NaN left out [m]."""
    known = true_width_m[np.isfinite(true_width_m)]
    if not known.size or known.max() - known.min() < 2 * MARGIN_M:
        return HALFWAY_M
    return float((known.max() + known.min()) / 2)


def judged(width_m: Array, true_width_m: Array) -> NDArray[np.bool_]:
    """Whether open or closed was read right, in each frame (n,) that is judged and in which a gap was read at all."""
    middle = boundary(true_width_m)
    far = np.isfinite(width_m) & (np.abs(true_width_m - middle) > MARGIN_M)
    return np.asarray((width_m[far] > middle) == (true_width_m[far] > middle))
