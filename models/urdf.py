"""URDF files made fit for Drake: meshes converted, once, into the user's cache folder."""

import hashlib
import math
import os
import shutil
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import unquote, urlsplit

import numpy as np

from kinebench_drake.errors import InputError, SetupError, cause
from kinebench_drake.geometry import Array

_CONVERSION = "4"  # raise it when the conversion changes, so that caches of an older version are not used
_VISUAL_MATERIAL, _VISUAL_COLOR = "plain_white", "0.9 0.92 0.93 1"


def cache_folder() -> Path:
    """Where converted models are kept: $XDG_CACHE_HOME/kinebench_drake, else ~/.cache/kinebench_drake."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "kinebench_drake"


def read_urdf(source: Path) -> ElementTree.Element:
    """The URDF's root element.

    Raises:
        InputError: the file cannot be read, or is no URDF.
    """
    try:
        root = ElementTree.fromstring(source.read_bytes())
    except ElementTree.ParseError as error:
        raise InputError(f"{source.name}: not a URDF ({error})") from None
    except OSError as error:
        raise InputError(f"{source.name} cannot be read ({cause(error)})") from None
    if root.tag != "robot":
        raise InputError(f"{source.name}: not a URDF (its root element is <{root.tag}>, expected <robot>)")
    return root


def convert_urdf(source: Path, name: str) -> Path:
    """Path of a URDF that Drake can load, converted on first use (seconds) and then taken from the cache.

    Collision meshes become their convex hulls (.obj), visual meshes one-colour .obj files with the source's triangles;
    visual meshes that cannot be read are left out. `mimic` and `safety_controller` elements and joint friction are
    dropped: Drake has no use for them in a continuous-time plant. Joints that turn without end (`continuous`) may turn
    from -pi to pi. Everything else is the source's.

    Args:
        source: the URDF; its meshes are looked for as `find_mesh` does.
        name: first part of the cache folder's name and name of the converted file.

    Raises:
        InputError: the URDF or a collision mesh it names cannot be read.
        SetupError: the cache folder cannot be written.
    """
    root = read_urdf(source)
    digest = hashlib.sha256(_CONVERSION.encode() + source.read_bytes())
    meshes: dict[str, Path | None] = {}
    for element in (*root.iter("collision"), *root.iter("visual")):
        for mesh in element.iter("mesh"):
            uri = str(mesh.get("filename"))
            if uri in meshes:
                continue
            meshes[uri] = path = find_mesh(source, uri)
            if path is None and element.tag == "collision":
                raise InputError(f"{source.name}: its collision mesh {uri} is nowhere to be found")
            try:
                digest.update(uri.encode() + (path.read_bytes() if path else b""))
            except OSError as error:
                raise InputError(f"{source.name}: {Path(uri).name} cannot be read ({cause(error)})") from None
    folder = cache_folder() / f"{name}-{digest.hexdigest()[:16]}"
    urdf = folder / f"{name}.urdf"
    if not urdf.is_file():
        try:
            _convert(source.name, root, meshes, folder, urdf.name)
        except OSError as error:
            raise SetupError(
                f"cannot write the converted robot to {folder} ({error}); set XDG_CACHE_HOME to a writable folder"
            ) from error
    return urdf


def find_mesh(urdf: Path, uri: str) -> Path | None:
    """The file that a URDF calls `uri`; None if there is none.

    Plain paths and file:// URIs are relative to the URDF's folder, or absolute. package://NAME/PATH is looked for as
    NAME/PATH, then as PATH, in the URDF's folder and then in each folder above it.
    """
    parts = urlsplit(uri)
    if parts.scheme == "package":
        inside = unquote(parts.path).lstrip("/")
        folders = urdf.resolve().parents
        candidates = [folder / path for folder in folders for path in (f"{parts.netloc}/{inside}", inside)]
    else:
        candidates = [urdf.parent / (unquote(parts.netloc + parts.path) if parts.scheme == "file" else uri)]
    return next((path for path in candidates if path.is_file()), None)


def srdf_path(urdf: Path) -> Path:
    """Where the SRDF of a URDF is looked for: beside it, under the same name."""
    return urdf.with_suffix(".srdf")


def robot_files(urdf: Path) -> list[Path]:
    """All files that a robot is read from and that are there: the URDF, its SRDF, its meshes.

    Of a URDF that cannot be read no meshes are known.
    """
    try:
        uris = sorted({str(mesh.get("filename")) for mesh in read_urdf(urdf).iter("mesh")})
    except InputError:
        uris = []
    files = (urdf, srdf_path(urdf), *(find_mesh(urdf, uri) for uri in uris))
    return [file for file in files if file is not None and file.is_file()]


def read_effort_limits(urdf: Path, joints: Sequence[str]) -> Array:
    """Greatest torques [N m] of some joints, as the URDF has them; infinite where it names none.

    Drake's parser keeps them for joints with a transmission only, which ManiSkill's robots lack.

    Raises:
        InputError: the file is no URDF, or a limit is not a positive number.
    """
    limits = {str(joint.get("name")): joint.find("limit") for joint in read_urdf(urdf).findall("joint")}
    found = [limits.get(name) for name in joints]
    efforts = [math.inf if limit is None else read_number(limit, "effort", math.inf) for limit in found]
    for name, effort in zip(joints, efforts, strict=True):
        if not effort > 0.0:
            raise InputError(f"{urdf.name}: joint {name} has the effort limit {effort:g}, expected a positive torque")
    return np.array(efforts)


def read_number(element: ElementTree.Element, attribute: str, default: float) -> float:
    """A number of an element; `default` where it is absent, NaN where it is none."""
    try:
        return float(element.get(attribute, default))
    except ValueError:
        return math.nan


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


def _convert(source: str, root: ElementTree.Element, meshes: dict[str, Path | None], folder: Path, name: str) -> None:
    """Write URDF and meshes to a folder beside `folder`, then move it there in one step: a race has no loser."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    work = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        for parent in list(root.iter()):
            for tag in ("mimic", "safety_controller"):
                for child in parent.findall(tag):
                    parent.remove(child)
        for joint in root.findall("joint"):
            _end_turns(joint)
            for dynamics in joint.findall("dynamics"):
                dynamics.attrib.pop("friction", None)
        targets = _targets(meshes)
        for link in root.findall("link"):
            for element in (*link.findall("collision"), *link.findall("visual")):
                if not _convert_element(source, element, meshes, targets, work):
                    link.remove(element)
        ElementTree.ElementTree(root).write(work / name, encoding="utf-8", xml_declaration=True)
        try:
            os.replace(work, folder)
        except OSError:
            if not (folder / name).is_file():  # else another process was first, with the same bytes
                raise
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _targets(meshes: dict[str, Path | None]) -> dict[str, str]:
    """A file name for each mesh that was found, by URI: its own, numbered where two folders hold the same name."""
    targets: dict[str, str] = {}
    for uri, path in meshes.items():
        if path is not None:
            name = f"{path.stem}.obj"
            targets[uri] = name if name not in targets.values() else f"{path.stem}_{len(targets)}.obj"
    return targets


def _end_turns(joint: ElementTree.Element) -> None:
    if joint.get("type") == "continuous":
        joint.set("type", "revolute")
        limit = joint.find("limit")
        limit = ElementTree.SubElement(joint, "limit") if limit is None else limit
        limit.set("lower", repr(-math.pi))
        limit.set("upper", repr(math.pi))


def _convert_element(
    source: str, element: ElementTree.Element, meshes: dict[str, Path | None], targets: dict[str, str], work: Path
) -> bool:
    """Convert the meshes of one collision or visual; False if it is a visual that cannot be read."""
    hull = element.tag == "collision"
    if not hull and element.find("material") is None:
        material = ElementTree.SubElement(element, "material", name=_VISUAL_MATERIAL)
        ElementTree.SubElement(material, "color", rgba=_VISUAL_COLOR)
    for node in element.iter("mesh"):
        uri = str(node.get("filename"))
        origin = meshes[uri]
        if origin is None:
            return False
        target = f"{element.tag}_{targets[uri]}"
        node.set("filename", target)
        if not (work / target).exists():
            try:
                text = _mesh(origin, hull=hull)
            # trimesh reads dozens of formats with as many libraries, and passes on whatever they raise
            except Exception as error:
                if not hull:
                    return False
                raise InputError(f"{source}: collision mesh {origin.name} cannot be read ({cause(error)})") from None
            (work / target).write_text(text)
    return True


def _mesh(source: Path, *, hull: bool) -> str:
    """A mesh file's surface, or its convex hull, as the text of an .obj file."""
    import trimesh  # half a second that only the first run ever needs

    mesh = trimesh.load(source, force="mesh")
    if len(mesh.faces) == 0:
        raise ValueError("it has no triangles")
    mesh = mesh.convex_hull if hull else trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    return str(trimesh.exchange.obj.export_obj(mesh, include_normals=False, include_texture=False, header=None))
