"""Simulator-independent description of an asset: rigid bodies with meshes, colliders, materials and joints.

A model is a tree of rigid bodies; poses of a body's parts are in the body's own frame. Lengths in metres.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, make_pose, rotation_exp


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceFinish:
    """Render material of a part."""

    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Linear RGB 0..1, without effect if there is a texture."""
    texture: NDArray[np.uint8] | None = None
    """(H, W, 3) sRGB image mapped by the mesh's `uv`, repeated outside 0..1; None: none."""
    roughness: float = 0.7
    """0 (mirror) .. 1 (matte)."""
    metallic: float = 0.0
    """0 .. 1."""
    specular: float = 0.3
    """0 .. 1."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Mesh:
    """Triangle mesh for rendering."""

    vertices: Array
    """(V, 3) [m]."""
    faces: NDArray[np.integer]
    """(F, 3) vertex indices, counter-clockwise seen from outside."""
    normals: Array
    """(V, 3) unit vectors."""
    uv: Array
    """(V, 2) texture coordinates."""

    def __post_init__(self) -> None:
        n = len(self.vertices)
        if self.vertices.shape != (n, 3) or self.normals.shape != (n, 3) or self.uv.shape != (n, 2):
            raise InputError(
                f"a mesh has vertices {self.vertices.shape}, normals {self.normals.shape} and uv {self.uv.shape}; "
                "expected (V, 3), (V, 3), (V, 2)"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Visual:
    """Mesh with a surface finish."""

    mesh: Mesh
    surface: SurfaceFinish
    X_BodyV: Array = field(default_factory=lambda: np.eye(4))
    """Pose (4, 4) in the body [m]."""


class ColliderKind(Enum):
    """Shape of a collider."""

    BOX = "box"
    SPHERE = "sphere"
    CYLINDER = "cylinder"
    CAPSULE = "capsule"
    HULL = "hull"


@dataclass(frozen=True, slots=True, kw_only=True)
class Collider:
    """Convex collision geometry."""

    kind: ColliderKind
    size: tuple[float, ...] = ()
    """BOX: half extents. SPHERE: radius. CYLINDER, CAPSULE: radius and half length along x [m]. HULL: empty."""
    points: Array | None = None
    """(N, 3) points whose convex hull is the solid [m]; HULL only."""
    X_BodyC: Array = field(default_factory=lambda: np.eye(4))
    """Pose (4, 4) in the body [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Material:
    """Physical material of a body."""

    density: float = 400.0
    """[kg/m^3] of the colliders' volume; overlapping volume counts twice."""
    static_friction: float = 0.7
    dynamic_friction: float = 0.6
    restitution: float = 0.05
    linear_damping: float = 0.0
    """Of free bodies [1/s]."""
    angular_damping: float = 0.05
    """Of free bodies [1/s]; stops round objects from rolling."""


class JointKind(Enum):
    """Degree of freedom of a body relative to its parent."""

    HINGE = "revolute"
    SLIDER = "prismatic"


@dataclass(frozen=True, slots=True, kw_only=True)
class Joint:
    """Joint with one degree of freedom between a body and its parent; its axis is the x axis of both joint frames.

    Gravity does not move it, as with a stiff hinge that holds a lid at any angle.
    """

    kind: JointKind
    X_ParentJ: Array = field(default_factory=lambda: np.eye(4))
    """Pose (4, 4) of the joint in the parent body [m]."""
    X_BodyJ: Array = field(default_factory=lambda: np.eye(4))
    """Pose (4, 4) of the joint in the body [m]; at position 0 both frames coincide."""
    upper: float
    """Upper limit [rad or m]; the lower one is 0."""
    friction: float = 0.0
    """PhysX joint friction: coefficient (unitless) of the load on the joint; it grows with off-axis loads."""
    damping: float = 0.0
    """Viscous friction [N m s/rad or N s/m]."""

    def motion(self, position: float) -> Array:
        """Return the pose (4, 4) of the body's joint frame in the parent's at a position [rad or m]."""
        if self.kind is JointKind.SLIDER:
            return make_pose(np.eye(3), [position, 0.0, 0.0])
        return make_pose(rotation_exp([position, 0.0, 0.0]), np.zeros(3))


_R_LID = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # joint x along the body's -y


def lid_hinge(p_Hinge: ArrayLike, upper: float, *, friction: float, damping: float) -> Joint:
    """Return a hinge along y at `p_Hinge` (3,) of the parent; positive angles lift a lid that extends along x."""
    return Joint(
        kind=JointKind.HINGE,
        X_ParentJ=make_pose(_R_LID, p_Hinge),
        X_BodyJ=make_pose(_R_LID, np.zeros(3)),
        upper=upper,
        friction=friction,
        damping=damping,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class RigidBody:
    """Rigid body of an asset."""

    name: str
    visuals: tuple[Visual, ...]
    colliders: tuple[Collider, ...] = ()
    material: Material = field(default_factory=Material)
    joint: Joint | None = None
    """Joint to the model's first body; None for the first body itself."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Site:
    """Named frame on a body, used by tasks and experts."""

    body: str
    X_BodyS: Array
    """Pose (4, 4) in the body [m]."""


def site_at(body: str, p: ArrayLike) -> Site:
    """Return a site at a point (3,) of a body, with the body's orientation."""
    return Site(body=body, X_BodyS=make_pose(np.eye(3), p))


@dataclass(frozen=True, slots=True, kw_only=True)
class AssetModel:
    """One instance of an asset kind."""

    asset_id: str
    """Kind and number, such as "box/07"."""
    words: str
    """Noun phrase for prompts without article, such as "red apple"."""
    bodies: tuple[RigidBody, ...]
    """The first body carries the others; several bodies form an articulation whose first body is fixed in the world."""
    size: Mapping[str, float]
    """Dimensions used by tasks and experts, by name [m, rad]."""
    sites: Mapping[str, Site] = field(default_factory=dict)
    """Frames used by tasks and experts, by name."""

    def __post_init__(self) -> None:
        names = [body.name for body in self.bodies]
        if not names or len(set(names)) != len(names):
            raise InputError(f"{self.asset_id}: bodies need different names, got {names}")
        if self.bodies[0].joint is not None or any(body.joint is None for body in self.bodies[1:]):
            raise InputError(f"{self.asset_id}: all bodies but the first need a joint")
        for name, site in self.sites.items():
            if site.body not in names:
                raise InputError(f"{self.asset_id}: site {name} is on {site.body!r}; there are {', '.join(names)}")

    @property
    def articulated(self) -> bool:
        """True if the asset has a joint."""
        return len(self.bodies) > 1


AssetMaker = Callable[[str, int, np.random.Generator], AssetModel]
"""Makes an instance of a kind from its asset id, its number 0.. (for properties assigned in turn, such as a faucet's
shape) and its own random generator."""
