"""URDF files made fit for Drake: meshes converted, once, into the user's cache folder."""

import hashlib
import os
import shutil
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kinebench_drake.errors import InputError, SetupError, cause
from kinebench_drake.geometry import Array

_CONVERSION = "2"  # raise it when the conversion changes, so that caches of an older version are not used
_VISUAL_COLOR = "0.9 0.92 0.93 1"


def cache_folder() -> Path:
    """Where converted models are kept: $XDG_CACHE_HOME/kinebench_drake, else ~/.cache/kinebench_drake."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "kinebench_drake"


def convert_urdf(source: Path, name: str) -> Path:
    """Path of a URDF that Drake can load, converted on first use (seconds) and then taken from the cache.

    Collision meshes become their convex hulls (.obj), visual meshes one-colour .obj files with the source's triangles.
    `mimic` and `safety_controller` elements are dropped: Drake has no use for them in a continuous-time plant.
    Everything else is the source's.

    Args:
        source: the URDF; its meshes are named relative to it.
        name: first part of the cache folder's name and name of the converted file.

    Raises:
        InputError: the URDF or a mesh it names cannot be read.
        SetupError: the cache folder cannot be written.
    """
    digest = hashlib.sha256(_CONVERSION.encode())
    try:
        digest.update(source.read_bytes())
        root = ElementTree.fromstring(source.read_bytes())
        for mesh in sorted({str(mesh.get("filename")) for mesh in root.iter("mesh")}):
            digest.update(mesh.encode() + (source.parent / mesh).read_bytes())
    except ElementTree.ParseError as error:
        raise InputError(f"{source.name}: not a URDF ({error})") from None
    except OSError as error:
        file = Path(error.filename).name if error.filename else source.name
        raise InputError(f"{source.name}: {file} cannot be read ({cause(error)})") from None
    folder = cache_folder() / f"{name}-{digest.hexdigest()[:16]}"
    urdf = folder / f"{name}.urdf"
    if not urdf.is_file():
        try:
            _convert(source.parent, root, folder, urdf.name)
        except OSError as error:
            raise SetupError(
                f"cannot write the converted robot to {folder} ({error}); set XDG_CACHE_HOME to a writable folder"
            ) from error
    return urdf


def read_effort_limits(urdf: Path, joints: Sequence[str]) -> Array:
    """Greatest torques [N m] of some joints, as the URDF has them; infinite where it names none.

    Drake's parser keeps them for joints with a transmission only, which ManiSkill's robots lack.
    """
    root = ElementTree.parse(urdf).getroot()
    limits = {str(joint.get("name")): joint.find("limit") for joint in root.findall("joint")}
    found = [limits.get(name) for name in joints]
    return np.array([np.inf if limit is None else float(limit.get("effort", "inf")) for limit in found])


def read_allowed_pairs(srdf: Path) -> frozenset[frozenset[str]]:
    """Pairs of links for which an SRDF disables the search for contacts.

    Raises:
        InputError: the file cannot be read.
    """
    try:
        root = ElementTree.parse(srdf).getroot()
    except (OSError, ElementTree.ParseError) as error:
        raise InputError(f"{srdf.name}: not an SRDF ({error})") from None
    return frozenset(
        frozenset((str(pair.get("link1")), str(pair.get("link2")))) for pair in root.iter("disable_collisions")
    )


def _convert(source: Path, root: ElementTree.Element, folder: Path, name: str) -> None:
    """Write URDF and meshes to a folder beside `folder`, then move it there in one step: a race has no loser."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    work = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        for parent in list(root.iter()):
            for tag in ("mimic", "safety_controller"):
                for child in parent.findall(tag):
                    parent.remove(child)
        for kind in ("collision", "visual"):
            for element in root.iter(kind):
                if kind == "visual" and element.find("material") is None:
                    material = ElementTree.SubElement(element, "material", name="panda_white")
                    ElementTree.SubElement(material, "color", rgba=_VISUAL_COLOR)
                for node in element.iter("mesh"):
                    origin = source / str(node.get("filename"))
                    target = f"{kind}_{origin.stem}.obj"
                    node.set("filename", target)
                    if not (work / target).exists():
                        _convert_mesh(origin, work / target, hull=kind == "collision")
        ElementTree.ElementTree(root).write(work / name, encoding="utf-8", xml_declaration=True)
        try:
            os.replace(work, folder)
        except OSError:
            if not (folder / name).is_file():  # else another process was first, with the same bytes
                raise
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _convert_mesh(source: Path, target: Path, *, hull: bool) -> None:
    import trimesh  # half a second that only the first run ever needs

    mesh = trimesh.load(source, force="mesh")
    mesh = mesh.convex_hull if hull else trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    target.write_text(trimesh.exchange.obj.export_obj(mesh, include_normals=False, include_texture=False, header=None))
