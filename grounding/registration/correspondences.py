"""Correspondences between cells of views and CAD points: line of sight, range and CAD coordinates of each cell."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array, cross
from kinebench_drake.grounding.tracking.view import OPENING_SIGNS, GripperView

CELLS_INDEPENDENT = 30.0
"""Greatest number of independent measurements that cells of links in a view count as: their errors correlate."""
POINTS_INDEPENDENT = 60.0
"""The same of points on the contour of the hand, or of a surface that is followed."""
MIN_POINTS = 20
"""Least number of points on a contour or surface that is matched."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Correspondences:
    """N correspondences, from one view or several that share the camera's centre.

    Those of several frames (`stack`) have a leading dimension of frames in every field.
    """

    R_LC: Array
    """(N, 3, 3) rotation from the camera frame C to a frame L whose z axis is the line of sight."""
    range_m: Array
    """(N,) distance along the line of sight [m]."""
    range_sigma: Array
    """(N,) relative standard deviation of the range; inf if there is none."""
    p_P: Array
    """(N, 3) CAD point in the frame of its part [m], as in `GripperView.coordinates_P`."""
    sigma_m: Array
    """(N, 2) standard deviation along the first two axes of L [m]; inf where the point is unconstrained."""
    part: NDArray[np.uint8]
    """(N,) values of `RobotPart`."""
    opening_sign: Array
    """(N,) direction along the hand's y axis as the fingers open: 1 or -1 on a finger, else 0."""
    weight: Array
    """(N,) number of independent measurements that it counts as: adjacent cells have correlated errors."""

    def __len__(self) -> int:
        """Return the number N of correspondences, or of frames."""
        return len(self.range_m)

    @property
    def p_C(self) -> Array:
        """(N, 3) points in the camera frame according to their ranges [m]."""
        return np.asarray(self.R_LC[..., 2, :] * self.range_m[..., None])

    def take(self, index: NDArray[np.generic]) -> "Correspondences":
        """Return a subset, by index or mask."""
        return Correspondences(**{f.name: getattr(self, f.name)[index] for f in fields(self)})

    @staticmethod
    def join(parts: "Sequence[Correspondences]") -> "Correspondences":
        """Concatenate correspondences."""
        return Correspondences(
            **{f.name: np.concatenate([getattr(c, f.name) for c in parts]) for f in fields(Correspondences)}
        )

    @staticmethod
    def stack(frames: "Sequence[Correspondences]") -> "Correspondences":
        """Stack the correspondences of frames; shorter ones are filled up with copies of their first, of no weight."""
        index = np.arange(max(len(cells) for cells in frames))
        padded = [cells.take(np.where(index < len(cells), index, 0)) for cells in frames]
        for cells, filled in zip(frames, padded, strict=True):
            filled.weight[len(cells) :] = 0.0
        return Correspondences(
            **{f.name: np.stack([getattr(cells, f.name) for cells in padded]) for f in fields(Correspondences)}
        )

    @staticmethod
    def without_range(
        R_LC: Array,
        p_P: Array,
        sigma_m: Array,
        part: NDArray[np.uint8],
        independent: float,
        opening_sign: Array | None = None,
    ) -> "Correspondences":
        """Return correspondences whose ranges are unknown; at most `independent` is their total weight."""
        n = len(part)
        return Correspondences(
            R_LC=R_LC,
            range_m=np.ones(n),
            range_sigma=np.full(n, np.inf),
            p_P=p_P,
            sigma_m=sigma_m,
            part=part,
            opening_sign=np.zeros(n) if opening_sign is None else opening_sign,
            weight=np.full(n, min(1.0, independent / n)),
        )

    @staticmethod
    def of_view(
        view: GripperView, mask: NDArray[np.bool_], limit: int = 300, independent: float = CELLS_INDEPENDENT
    ) -> "Correspondences":
        """Return the correspondences of the cells in `mask` (h, w) of a view.

        More than `limit` are evenly subsampled; their total weight is `independent` at most.
        """
        v, u = np.nonzero(mask)
        if len(v) > limit:
            subset = np.linspace(0, len(v) - 1, limit).astype(int)
            v = v[subset]
            u = u[subset]
        rays = view.rays_at(v, u) @ view.crop.R_CV.T
        length = np.sqrt((rays**2).sum(axis=1))
        return Correspondences(
            R_LC=line_frames(rays / length[:, None]),
            range_m=view.depth_m[v, u] * length,
            range_sigma=view.depth_sigma[v, u],
            p_P=view.coordinates_P[v, u],
            sigma_m=np.repeat(view.coordinates_sigma_m[v, u, None], 2, axis=1),
            part=view.part[v, u],
            opening_sign=OPENING_SIGNS[view.part[v, u]],
            weight=np.full(len(v), min(1.0, independent / max(1, len(v)))),
        )


def line_frames(z: Array) -> Array:
    """Return rotations (N, 3, 3) whose third rows are the unit vectors `z` (N, 3)."""
    # y x z as first axis: a line of sight is never parallel to the camera's y axis.
    length = np.sqrt(z[:, 0] ** 2 + z[:, 2] ** 2)
    R = np.empty((len(z), 3, 3))
    R[:, 0, 0] = z[:, 2] / length
    R[:, 0, 1] = 0.0
    R[:, 0, 2] = -z[:, 0] / length
    R[:, 1, 0], R[:, 1, 1], R[:, 1, 2] = z[:, 1] * R[:, 0, 2], length, -z[:, 1] * R[:, 0, 0]
    R[:, 2] = z
    return R


def edge_frames(ray: Array, normal: Array) -> Array:
    """Return rotations (N, 3, 3) as `Correspondences.R_LC` whose first axes lie across edges of the image.

    Args:
        ray: (N, 3) lines of sight, of any length.
        normal: (N, 2) directions across the edges in the image.
    """
    z = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    x = np.column_stack([normal, np.zeros(len(normal))])
    x -= (x * z).sum(axis=1, keepdims=True) * z
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, cross(z, x), z], axis=1)
