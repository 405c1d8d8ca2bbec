"""Boards, of which furniture consists: boxes to see, to touch, or both."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.geometry import make_pose
from kinebench_drake.suites.assets.mesh import box_mesh
from kinebench_drake.suites.assets.model import Body, Collider, ColliderKind, Joint, Material, Surface, Visual

_UPRIGHT = np.eye(3)


def block(size: ArrayLike, center: ArrayLike, *, R: ArrayLike = _UPRIGHT) -> Collider:
    """A solid box of full sizes `size` (3,) about `center` (3,) [m], turned by `R` (3, 3)."""
    x, y, z = (float(s) for s in 0.5 * np.asarray(size, dtype=np.float64))
    return Collider(kind=ColliderKind.BOX, size=(x, y, z), X_BodyC=make_pose(R, center))


def board(
    size: ArrayLike,
    center: ArrayLike,
    surface: Surface,
    *,
    R: ArrayLike = _UPRIGHT,
    bevel_m: float = 0.001,
    uv_per_m: float = 5.0,
) -> Visual:
    """What is seen of a box of full sizes `size` (3,) about `center` (3,) [m], turned by `R` (3, 3).

    `bevel_m` and `uv_per_m` are those of `box_mesh`.
    """
    return Visual(
        mesh=box_mesh(size, bevel_m=bevel_m, uv_per_m=uv_per_m), surface=surface, X_BodyV=make_pose(R, center)
    )


@dataclass(slots=True)
class Parts:
    """Visuals and colliders of one body, added piece by piece in the body's frame."""

    uv_per_m: float = 5.0
    """Textures a metre on panels."""
    visuals: list[Visual] = field(default_factory=list)
    colliders: list[Collider] = field(default_factory=list)

    def panel(
        self, low: ArrayLike, high: ArrayLike, surface: Surface, *, bevel_m: float = 0.001, solid: bool = True
    ) -> None:
        """The box between two corners (3,) [m]; `solid`: not only to be seen."""
        low, high = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
        size, center = high - low, 0.5 * (low + high)
        self.visuals.append(board(size, center, surface, bevel_m=bevel_m, uv_per_m=self.uv_per_m))
        if solid:
            self.colliders.append(block(size, center))

    def body(self, name: str, material: Material, joint: Joint | None = None) -> Body:
        """All of it as one body."""
        return Body(
            name=name,
            visuals=tuple(self.visuals),
            colliders=tuple(self.colliders),
            material=material,
            joint=joint,
        )
