"""Obstacles around an arm: read from the JSON of `--obstacles`, added to its URDF as links fixed to the base.

So they are part of the robot: of its Drake plant, its collision checks, its replays, and of `Robot.id`.
"""

import json
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from kinebench_drake.errors import UsageError, cause

PREFIX = "obstacle "
"""Start of the names of links that are obstacles."""
SCHEME = "scene:"
"""Start of the URI of an obstacle's mesh, relative to the folder of the file of obstacles."""
SHAPES = ("box_m", "sphere_m", "cylinder_m", "mesh")

_Length = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
_Number = Annotated[float, Field(allow_inf_nan=False)]


def _check_unit(quaternion: tuple[float, ...]) -> tuple[float, ...]:
    if abs(float(np.linalg.norm(quaternion)) - 1.0) > 1e-3:
        raise ValueError("is no unit quaternion w x y z")
    return quaternion


class Obstacle(BaseModel):
    """One body at rest, of exactly one shape; a mesh counts as its convex hull."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]+$")]
    box_m: tuple[_Length, _Length, _Length] | None = None
    """Side lengths [m]."""
    sphere_m: _Length | None = None
    """Radius [m]."""
    cylinder_m: tuple[_Length, _Length] | None = None
    """Radius, and length along z [m]."""
    mesh: str | None = None
    """Mesh file in metres, relative to the file of obstacles."""
    position_m: tuple[_Number, _Number, _Number]
    """Origin of the shape in B; of box, sphere and cylinder its centre [m]."""
    quaternion_wxyz: Annotated[tuple[_Number, _Number, _Number, _Number], AfterValidator(_check_unit)] = (1, 0, 0, 0)
    """Orientation of the shape in B."""

    @model_validator(mode="after")
    def _check_shape(self) -> "Obstacle":
        if sum(getattr(self, shape) is not None for shape in SHAPES) != 1:
            raise ValueError(f"has not exactly one of {', '.join(SHAPES)}")
        return self

    def geometry(self) -> ElementTree.Element:
        """Return its geometry element."""
        element = ElementTree.Element("geometry")
        shapes = {
            "mesh": self.mesh and {"filename": f"{SCHEME}{self.mesh}"},
            "box": self.box_m and {"size": " ".join(map(repr, self.box_m))},
            "sphere": self.sphere_m and {"radius": repr(self.sphere_m)},
            "cylinder": self.cylinder_m and dict(zip(("radius", "length"), map(repr, self.cylinder_m), strict=True)),
        }
        for tag, attributes in shapes.items():
            if isinstance(attributes, dict):
                ElementTree.SubElement(element, tag, attributes)
        return element


class _ObstacleFile(BaseModel):
    model_config = ConfigDict(extra="forbid")

    obstacles: tuple[Obstacle, ...]


def read_obstacles(path: Path) -> tuple[Obstacle, ...]:
    """Read a file of obstacles.

    Raises:
        UsageError: it cannot be read, is no such file, or two obstacles have the same name.
    """
    try:
        obstacles = _ObstacleFile.model_validate(json.loads(path.read_bytes())).obstacles
    except ValidationError as error:
        first = error.errors()[0]
        where = " ".join(map(str, first["loc"])) or "its content"
        example = '{"obstacles": [{"name": "shelf", "box_m": [0.4, 0.1, 0.02], "position_m": [0.5, 0, 0.3]}]}'
        raise UsageError(f"$obstacles {path.name}: {where}: {first['msg']}; expected such as {example}") from None
    except (OSError, ValueError) as error:
        raise UsageError(f"$obstacles {path.name}: cannot be read as JSON ({cause(error)})") from None
    names = [obstacle.name for obstacle in obstacles]
    for name, mesh in ((obstacle.name, obstacle.mesh) for obstacle in obstacles):
        if names.count(name) > 1:
            raise UsageError(f"$obstacles {path.name}: two are called {name!r}; give each its own name")
        if mesh is not None and not (path.parent / mesh).is_file():
            raise UsageError(f"$obstacles {path.name}: {name} has no mesh file {mesh} beside it")
    return obstacles


def is_obstacle(link: str) -> bool:
    """Return whether a link of a robot is an obstacle."""
    return link.startswith(PREFIX)
