"""Cells of views as measurements: the direction in which each looks, how far it sees, which point of the CAD model."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.grounding.view import GripperView


@dataclass(frozen=True, slots=True, kw_only=True)
class Correspondences:
    """N cells, of one view or of several that share the camera's centre."""

    R_LC: Array
    """(N, 3, 3) from the camera frame C into a frame of the cell's own whose z axis is its line of sight."""
    range_m: Array
    """(N,) distance along the line of sight [m]."""
    range_sigma: Array
    """(N,) its standard deviation, relative."""
    p_P: Array
    """(N, 3) point seen in the frame of its part [m]; see `GripperView.coordinates_P`."""
    sigma_m: Array
    """(N, 2) standard deviation across the line of sight, along the first axes of L [m]; inf where nothing is said."""
    part: NDArray[np.uint8]
    """(N,) values of `Part`."""
    opening_sign: Array
    """(N,) where the cell goes along the hand's y axis as the gripper opens: 1, -1 or, but for fingers, 0."""
    weight: Array
    """(N,) how many independent measurements it is worth: cells next to each other err alike."""

    def __len__(self) -> int:
        """Number of cells."""
        return len(self.range_m)

    @property
    def p_C(self) -> Array:
        """(N, 3) points seen, by their ranges, in the camera frame [m]."""
        return np.asarray(self.R_LC[:, 2] * self.range_m[:, None])

    def take(self, chosen: NDArray[np.generic]) -> "Correspondences":
        """Some of the cells, by index or mask."""
        return Correspondences(**{f.name: getattr(self, f.name)[chosen] for f in fields(self)})

    @staticmethod
    def join(several: "Sequence[Correspondences]") -> "Correspondences":
        """The cells of several views."""
        return Correspondences(
            **{f.name: np.concatenate([getattr(c, f.name) for c in several]) for f in fields(Correspondences)}
        )

    @staticmethod
    def of_view(view: GripperView, wanted: NDArray[np.bool_], limit: int, independent: float) -> "Correspondences":
        """The `wanted` cells (h, w) of a view, every so many if there are more than `limit`.

        Args:
            view: the view.
            wanted: (h, w) which of its cells.
            limit: greatest number of cells.
            independent: what all of them together are worth at most, in independent measurements.
        """
        v, u = np.nonzero(wanted)
        if len(v) > limit:
            chosen = np.linspace(0, len(v) - 1, limit).astype(int)
            v, u = v[chosen], u[chosen]
        rays = view.rays()[v, u] @ view.crop.R_CV.T
        length = np.linalg.norm(rays, axis=1)
        return Correspondences(
            R_LC=_frames(rays / length[:, None]),
            range_m=view.depth_m[v, u] * length,
            range_sigma=view.depth_sigma[v, u],
            p_P=view.coordinates_P[v, u],
            sigma_m=np.repeat(view.coordinates_sigma_m[v, u, None], 2, axis=1),
            part=view.part[v, u],
            opening_sign=view.opening_sign[v, u],
            weight=np.full(len(v), min(1.0, independent / max(1, len(v)))),
        )


def _frames(z: Array) -> Array:
    """Rotations (N, 3, 3) whose third rows are the unit vectors `z` (N, 3)."""
    x = np.cross([0.0, 1.0, 0.0], z)  # lines of sight are near the camera's axis, never along its y
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=1)
