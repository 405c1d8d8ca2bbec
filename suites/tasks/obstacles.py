"""What the variants with obstacles ask besides: nothing knocked over, nothing pushed away."""

import numpy as np
import torch
from torch import Tensor

from kinebench_drake.suites.tasks.state import State

UPRIGHT_RAD = np.deg2rad(10.0)
"""How far an obstacle's own z axis may lean from the vertical."""
MOVED_M = 0.02
"""How far an obstacle may be from where it stood, sideways."""


def undisturbed(state: State, name: str) -> dict[str, Tensor]:
    """Whether (N,) the thing of a name still stands (`NAME_upright`), and where it stood (`NAME_in_place`)."""
    way = state.position(name)[:, :2] - state.starts[name][:, :2, 3]
    return {
        f"{name}_upright": state.poses[name][:, 2, 2] >= float(np.cos(UPRIGHT_RAD)),
        f"{name}_in_place": torch.linalg.norm(way, dim=-1) <= MOVED_M,
    }
