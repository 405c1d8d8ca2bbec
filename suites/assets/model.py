"""What a thing is made of, for eyes and for physics, apart from any simulator.

A model is a tree of rigid bodies; poses of a body's parts are given in the body's own frame. Lengths in metres.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, make_pose, rotation_exp


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceFinish:
    """How a part looks."""

    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Linear RGB 0..1; multiplied with the texture, if there is one."""
    texture: NDArray[np.uint8] | None = None
    """(H, W, 3) sRGB image laid on by the mesh's `uv`, repeated outside 0..1; None: plain."""
    roughness: float = 0.7
    """0 (mirror) .. 1 (matt)."""
    metallic: float = 0.0
    """0 .. 1."""
    specular: float = 0.3
    """0 .. 1."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Mesh:
    """Triangles to look at."""

    vertices: Array
    """(V, 3) [m]."""
    faces: NDArray[np.integer]
    """(F, 3) indices, counter-clockwise seen from outside."""
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
    """A mesh with its surface."""

    mesh: Mesh
    surface: SurfaceFinish
    X_BodyV: Array = field(default_factory=lambda: np.eye(4))
    """Pose (4, 4) in the body [m]."""


class ColliderKind(Enum):
    """Solids that physics knows."""

    BOX = "box"
    SPHERE = "sphere"
    CYLINDER = "cylinder"
    CAPSULE = "capsule"
    HULL = "hull"


@dataclass(frozen=True, slots=True, kw_only=True)
class Collider:
    """A convex solid to bump into."""

    kind: ColliderKind
    size: tuple[float, ...] = ()
    """BOX: half sizes along x, y, z. SPHERE: radius. CYLINDER, CAPSULE: radius, half length along x [m]. HULL: none."""
    points: Array | None = None
    """(N, 3) points whose convex hull is the solid [m]; HULL only."""
    X_BodyC: Array = field(default_factory=lambda: np.eye(4))
    """Pose (4, 4) in the body [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Material:
    """What physics knows of a body's substance."""

    density: float = 400.0
    """[kg/m^3] of the colliders' volume; where these overlap it counts twice."""
    static_friction: float = 0.7
    dynamic_friction: float = 0.6
    restitution: float = 0.05
    linear_damping: float = 0.0
    """Of free bodies [1/s]."""
    angular_damping: float = 0.05
    """Of free bodies [1/s]; what keeps round things from rolling for ever."""


class JointKind(Enum):
    """How a body may move against its parent."""

    HINGE = "revolute"
    SLIDER = "prismatic"


@dataclass(frozen=True, slots=True, kw_only=True)
class Joint:
    """The one degree of freedom between a body and its parent; its axis is the x axis of both joint frames."""

    kind: JointKind
    X_ParentJ: Array
    """Pose (4, 4) of the joint in the parent body [m]."""
    X_BodyJ: Array
    """Pose (4, 4) of the joint in the body [m]; at position 0 both frames coincide."""
    lower: float
    """Least position [rad or m]."""
    upper: float
    """Greatest position [rad or m]."""
    friction: float = 0.0
    """PhysX's joint friction: a coefficient (no unit) of the load that the joint bears; it grows when pushed askew."""
    damping: float = 0.0
    """Viscous friction [N m s/rad or N s/m]."""
    balanced: bool = True
    """Whether the joint carries the body's weight, as a stiff hinge does that holds a lid at any angle."""

    def motion(self, position: float) -> Array:
        """Pose (4, 4) of the body's joint frame in the parent's at a position [rad or m]."""
        if self.kind is JointKind.SLIDER:
            return make_pose(np.eye(3), [position, 0.0, 0.0])
        return make_pose(rotation_exp([position, 0.0, 0.0]), np.zeros(3))


@dataclass(frozen=True, slots=True, kw_only=True)
class Body:
    """One rigid body."""

    name: str
    visuals: tuple[Visual, ...]
    colliders: tuple[Collider, ...] = ()
    material: Material = field(default_factory=Material)
    joint: Joint | None = None
    """How it hangs on the model's first body; None for the first body itself."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Site:
    """A named frame on a body: where to grasp, push or look."""

    body: str
    X_BodyS: Array
    """Pose (4, 4) in the body [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Model:
    """One instance of a kind of thing."""

    kind: str
    """Such as "box"."""
    asset_id: str
    """Such as "box/07"."""
    words: str
    """What a person would call it in a prompt, such as "red apple"; without article."""
    bodies: tuple[Body, ...]
    """The first one carries the others; more than one make an articulation whose first body is fixed in the world."""
    size: Mapping[str, float]
    """Measures that tasks and experts need, by name [m, rad]."""
    sites: Mapping[str, Site] = field(default_factory=dict)
    """Frames that tasks and experts need, by name."""

    def __post_init__(self) -> None:
        names = [body.name for body in self.bodies]
        if not names or len(set(names)) != len(names):
            raise InputError(f"{self.asset_id}: bodies need different names, found {names}")
        if self.bodies[0].joint is not None or any(body.joint is None for body in self.bodies[1:]):
            raise InputError(f"{self.asset_id}: all bodies but the first need a joint")
        for name, site in self.sites.items():
            if site.body not in names:
                raise InputError(f"{self.asset_id}: site {name} is on {site.body!r}; there are {', '.join(names)}")

    @property
    def articulated(self) -> bool:
        """Whether it has a joint."""
        return len(self.bodies) > 1


@dataclass(frozen=True, slots=True, kw_only=True)
class AssetKind:
    """A kind of thing, of which the library has many instances."""

    name: str
    """Such as "box"; kinds that tasks tell apart have names of their own, such as "fruit/apple"."""
    make: Callable[[str, int, np.random.Generator], Model]
    """From the asset id, the instance's number 0.. (for what is dealt out in turn, such as a faucet's shape) and a
    random generator of its own."""
