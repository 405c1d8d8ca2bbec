"""Rotations as six numbers: a representation that is continuous, so that a network can learn it.

Zhou et al., "On the Continuity of Rotation Representations in Neural Networks", CVPR 2019: the first two columns of the
matrix; Gram-Schmidt makes a rotation of any two that are not parallel.
"""

import torch
from torch import Tensor
from torch.nn import functional


def to_six(R: Tensor) -> Tensor:
    """Six numbers (..., 6) of rotation matrices `R` (..., 3, 3): first column, second column."""
    return R[..., :, :2].transpose(-1, -2).flatten(-2)


def from_six(six: Tensor) -> Tensor:
    """Rotation matrices (..., 3, 3) of any six numbers (..., 6), by Gram-Schmidt (their equation 15)."""
    x = functional.normalize(six[..., :3], dim=-1)
    y = six[..., 3:]
    y = functional.normalize(y - (x * y).sum(dim=-1, keepdim=True) * x, dim=-1)
    return torch.stack([x, y, torch.linalg.cross(x, y)], dim=-1)
