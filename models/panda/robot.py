"""The Franka Panda for Drake: the URDF of the installed mani_skill package with meshes that Drake can read.

ManiSkill's `panda_v2.urdf` is the robot that the tasks are executed with; its collision meshes are .stl and its visual
meshes .glb, which Drake's collision engine does not take. They are converted once into the user's cache folder.
"""

import hashlib
import importlib.util
import os
import shutil
import tempfile
import xml.etree.ElementTree as ElementTree
from functools import cache
from pathlib import Path

import numpy as np

from kinebench_drake.errors import SetupError
from kinebench_drake.geometry import Array, make_pose

BASE_LINK = "panda_link0"
"""Frame B."""
HAND_LINK = "panda_hand"
"""Frame H."""
TCP_LINK = "panda_hand_tcp"
"""Frame G."""
ARM_LINKS = tuple(f"panda_link{i}" for i in range(9))
FINGER_LINKS = ("panda_leftfinger", "panda_rightfinger")
LINKS = (*ARM_LINKS, HAND_LINK, TCP_LINK, *FINGER_LINKS)
"""Links of the arm and the hand, base first."""

ARM_JOINTS = tuple(f"panda_joint{i}" for i in range(1, 8))
FINGER_JOINTS = ("panda_finger_joint1", "panda_finger_joint2")
"""Prismatic, 0..0.04 m each; the gap between the pads is twice one of them."""

HAND_TO_TCP_M = 0.1034
"""Distance of panda_hand_tcp from panda_hand along z [m]."""

_URDF = Path("assets/robots/panda/panda_v2.urdf")
_CONVERSION = "2"  # raise it when the conversion changes, so that caches of an older version are not used
_VISUAL_COLOR = "0.9 0.92 0.93 1"


def hand_from_tcp() -> Array:
    """Pose X_HG (4, 4) of panda_hand_tcp in panda_hand [m]."""
    return make_pose(np.eye(3), [0.0, 0.0, HAND_TO_TCP_M])


def rest_q() -> Array:
    """ManiSkill's rest posture (7,) [rad]: the arm in front of its base, the gripper pointing down."""
    return np.pi * np.array([0.0, 1 / 8, 0.0, -5 / 8, 0.0, 3 / 4, 1 / 4])


def source_urdf() -> Path:
    """The URDF in the installed mani_skill package, found without importing it (that would load torch and sapien).

    Raises:
        SetupError: mani_skill is not installed, or its Panda is not where it was.
    """
    spec = importlib.util.find_spec("mani_skill")
    if spec is None or not spec.submodule_search_locations:
        raise SetupError(
            "mani_skill is not installed, but the Panda's URDF comes from it; pip install 'mani-skill~=3.0'"
        )
    path = Path(spec.submodule_search_locations[0]) / _URDF
    if not path.is_file():
        raise SetupError(f"mani_skill holds no {_URDF}; expected mani-skill 3.0.x, reinstall it")
    return path


def cache_folder() -> Path:
    """Where converted models are kept: $XDG_CACHE_HOME/kinebench_drake, else ~/.cache/kinebench_drake."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "kinebench_drake"


@cache
def panda_urdf() -> Path:
    """Path of a URDF that Drake can load, converted on first use (seconds) and then taken from the cache.

    Collision meshes become their convex hulls (.obj), visual meshes one-colour .obj files with the source's triangles.
    The second finger's `mimic` and the `safety_controller` elements are dropped: Drake has no use for them in a
    continuous-time plant. Everything else is the source's.

    Raises:
        SetupError: mani_skill is missing, or the cache folder cannot be written.
    """
    source = source_urdf()
    root = ElementTree.parse(source).getroot()
    meshes = sorted({str(mesh.get("filename")) for mesh in root.iter("mesh")})
    digest = hashlib.sha256(_CONVERSION.encode() + source.read_bytes())
    for name in meshes:
        digest.update(name.encode() + (source.parent / name).read_bytes())
    folder = cache_folder() / f"panda-{digest.hexdigest()[:16]}"
    urdf = folder / "panda.urdf"
    if not urdf.is_file():
        try:
            _convert(source.parent, root, folder)
        except OSError as error:
            raise SetupError(
                f"cannot write the converted robot to {folder} ({error}); set XDG_CACHE_HOME to a writable folder"
            ) from error
    return urdf


def _convert(source: Path, root: ElementTree.Element, folder: Path) -> None:
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
        ElementTree.ElementTree(root).write(work / "panda.urdf", encoding="utf-8", xml_declaration=True)
        try:
            os.replace(work, folder)
        except OSError:
            if not (folder / "panda.urdf").is_file():  # else another process was first, with the same bytes
                raise
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _convert_mesh(source: Path, target: Path, *, hull: bool) -> None:
    import trimesh  # half a second that only the first run ever needs

    mesh = trimesh.load(source, force="mesh")
    mesh = mesh.convex_hull if hull else trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    target.write_text(trimesh.exchange.obj.export_obj(mesh, include_normals=False, include_texture=False, header=None))
