"""Conversion of URDF files for Drake: meshes are converted once into the user's cache folder."""

import hashlib
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from urllib.parse import unquote, urlsplit

from kinebench_drake.errors import InputError, SetupError, cause
from kinebench_drake.io.atomic import atomic_folder
from kinebench_drake.io.files import cache_folder
from kinebench_drake.models.joint_limits import JOINT_COUNTS
from kinebench_drake.models.mjcf import read_mjcf
from kinebench_drake.models.obstacles import SCHEME

TURNING = ("revolute", "continuous")
"""Types of the joints of an arm."""
MOVING = (*TURNING, "prismatic")
JOINT_TYPES = (*MOVING, "fixed")
"""Types of joints that are supported."""


class LinkTree:
    """Links and joints of a URDF, checked to be a tree."""

    def __init__(self, file: str, root: ElementTree.Element) -> None:
        """Read the links and joints of the root element of a URDF called `file`.

        Raises:
            InputError: they are no tree, or a joint is of an unknown type.
        """
        self.file = file
        self.elements = {str(link.get("name")): link for link in root.findall("link")}
        self.links = tuple(self.elements)
        self.joints = root.findall("joint")
        self.inboard: dict[str, ElementTree.Element] = {}
        for joint in self.joints:
            name = joint.get("name")
            child = end_link(joint, "child")
            if joint.get("type") not in JOINT_TYPES:
                raise InputError(f"{file}: joint {name} is {joint.get('type')}, expected {', '.join(JOINT_TYPES)}")
            for end in (end_link(joint, "parent"), child):
                if end not in self.elements:
                    raise InputError(f"{file}: joint {name} names the link {end!r}, which the file lacks")
            if child in self.inboard:
                raise InputError(
                    f"{file}: link {child} hangs on two joints, {self.inboard[child].get('name')} and {name}"
                )
            self.inboard[child] = joint
        roots = [link for link in self.links if link not in self.inboard]
        if len(roots) != 1:
            others = ", ".join(roots) or ("the joints form a loop" if self.links else "it has no link")
            raise InputError(f"{file}: {len(roots)} links hang on no joint ({others}), expected one base")
        self.root = roots[0]
        reached = fresh = set(roots)
        while fresh:
            fresh = {link for link, joint in self.inboard.items() if end_link(joint, "parent") in reached} - reached
            reached = reached | fresh
        if loop := [link for link in self.links if link not in reached]:
            raise InputError(f"{file}: the joints of {', '.join(loop)} form a loop, expected a tree")

    def chain(self, link: str) -> Iterator[ElementTree.Element]:
        """Yield the joints from the root to `link`."""
        if link != self.root:
            joint = self.inboard[link]
            yield from self.chain(end_link(joint, "parent"))
            yield joint

    def arm(self, tcp: str) -> tuple[ElementTree.Element, ...]:
        """Return the moving joints of the arm that ends in the link `tcp`.

        They lie between the root and that link; of a body with several limbs, beyond the last link at which another
        limb as long as an arm begins.

        Raises:
            InputError: there are more or fewer than those of an arm.
        """
        path = list(self.chain(tcp))
        moving = [joint for joint in path if joint.get("type") != "fixed"]
        for k, joint in reversed([*enumerate(moving)]):
            if len(moving) - k in JOINT_COUNTS and self._has_other_limb(end_link(joint, "parent"), path):
                return tuple(moving[k:])
        if len(moving) not in JOINT_COUNTS:
            names = ", ".join(str(joint.get("name")) for joint in moving) or "none"
            raise InputError(
                f"{self.file}: {len(moving)} moving joints between {self.root} and {tcp} ({names}), "
                f"expected {JOINT_COUNTS[0]} to {JOINT_COUNTS[-1]}"
            )
        return tuple(moving)

    def _has_other_limb(self, link: str, path: Sequence[ElementTree.Element]) -> bool:
        """Return whether from a link, or those fixed to it, another limb with as many joints as an arm begins."""
        fixed = {link}
        for joint in self.joints:  # links follow their parents in files
            if joint.get("type") == "fixed" and joint not in path and end_link(joint, "parent") in fixed:
                fixed.add(end_link(joint, "child"))
        others = [joint for joint in self.joints if joint not in path and end_link(joint, "parent") in fixed]
        return any(self._depth(end_link(joint, "child")) + 1 >= JOINT_COUNTS[0] for joint in others)

    def _depth(self, link: str) -> int:
        """Return the greatest number of moving joints between a link and one beyond it."""
        beyond = [joint for joint in self.joints if end_link(joint, "parent") == link]
        return max((self._depth(end_link(j, "child")) + (j.get("type") in MOVING) for j in beyond), default=0)

    def fingers(self, arm: Sequence[ElementTree.Element]) -> tuple[ElementTree.Element, ...]:
        """Return the prismatic joints beyond the last joint of an arm."""
        last = arm[-1]
        slides = [joint for joint in self.joints if joint.get("type") == "prismatic" and joint is not last]
        return tuple(joint for joint in slides if last in self.chain(end_link(joint, "child")))

    def body(self, link: str) -> str:
        """Return the link itself or its nearest ancestor with a visual; the root if none has one."""
        while link != self.root and self.elements[link].find("visual") is None:
            link = end_link(self.inboard[link], "parent")
        return link


def end_link(joint: ElementTree.Element, tag: str) -> str:
    """Return the link at an end of a joint, `tag` "parent" or "child"; empty if it is not stated."""
    element = joint.find(tag)
    return "" if element is None else str(element.get("link"))


_CONVERSION = "5"  # version of the conversion; increment it with every change to invalidate caches
_VISUAL_MATERIAL = "plain_white"
_VISUAL_COLOR = "0.9 0.92 0.93 1"


def read_urdf(source: Path) -> ElementTree.Element:
    """Read the root element of a URDF; of an MJCF that of a URDF with the same content.

    Raises:
        InputError: the file cannot be read, or is no URDF.
    """
    try:
        text = source.read_bytes()
        # Drake accepts prefixes that no attribute xmlns declares.
        prefixes = {*re.findall(rb"[\s</](\w+):\w+\s*[=/>\s]", text)} - {*re.findall(rb"xmlns:(\w+)", text), b"xmlns"}
        names = b"".join(b' xmlns:%b="%b"' % (prefix, prefix) for prefix in sorted(prefixes))
        root = ElementTree.fromstring(text.replace(b"<robot ", b"<robot" + names + b" ", 1))
    except ElementTree.ParseError as error:
        raise InputError(f"{source.name}: not a URDF ({error})") from None
    except OSError as error:
        raise InputError(f"{source.name} cannot be read ({cause(error)})") from None
    if root.tag == "mujoco":
        return read_mjcf(source, root)
    if root.tag != "robot":
        raise InputError(f"{source.name}: not a URDF (its root element is <{root.tag}>, expected <robot>)")
    return root


def convert_urdf(
    source: Path,
    name: str,
    root: ElementTree.Element | None = None,
    package_path: Path | None = None,
    scene: Path | None = None,
) -> Path:
    """Return the path of a URDF that Drake can load, converted on first use (seconds) and cached.

    Collision meshes become their convex hulls (.obj), visual meshes one-colour .obj files with the original triangles;
    unreadable visual meshes are left out. `mimic` and `safety_controller` elements and joint friction are dropped:
    Drake does not use them in a continuous-time plant. An SRDF beside the source is copied. The name of the folder
    identifies the content: `name` and a hash of all files; meshes are found by `find_mesh`.

    Args:
        name: name of the converted file, without its suffix.
        root: its root element, if it was edited; left converted.
        package_path: folder in which packages of package:// URIs are looked up first.

    Raises:
        InputError: the URDF, its SRDF or one of its collision meshes cannot be read.
        SetupError: the cache folder cannot be written.
    """
    root = read_urdf(source) if root is None else root
    srdf = srdf_path(source)
    digest = hashlib.sha256(_CONVERSION.encode() + ElementTree.tostring(root))
    meshes: dict[str, Path | None] = {}
    files: dict[str, Path | None] = {"": srdf if srdf.is_file() else None}
    for element in (*root.iter("collision"), *root.iter("visual")):
        for mesh in element.iter("mesh"):
            uri = str(mesh.get("filename"))
            if uri not in meshes:
                of_scene = scene / uri.removeprefix(SCHEME) if scene and uri.startswith(SCHEME) else None
                files[uri] = meshes[uri] = of_scene or find_mesh(source, uri, package_path)
            if meshes[uri] is None and element.tag == "collision":
                fix = "; name the folder of its packages with $package_path" if uri.startswith("package:") else ""
                raise InputError(f"{source.name}: its collision mesh {uri} does not exist{fix}")
    for uri, path in files.items():
        try:
            digest.update(uri.encode() + b"\0" + (path.read_bytes() if path else b""))
        except OSError as error:
            raise InputError(f"{source.name}: {path and path.name} cannot be read ({cause(error)})") from None
    folder = cache_folder() / f"{name}-{digest.hexdigest()[:16]}"
    urdf = folder / f"{name}.urdf"
    if not urdf.is_file():
        try:
            _convert(source, root, meshes, urdf)
        except OSError as error:
            raise SetupError(
                f"cannot write the converted robot to {folder} ({error}); set XDG_CACHE_HOME to a writable folder"
            ) from error
    return urdf


def find_mesh(urdf: Path, uri: str, package_path: Path | None = None) -> Path | None:
    """Return the mesh file of a `uri` in a URDF; None if there is none.

    Plain paths and file:// URIs are relative to the URDF's folder, or absolute. package://NAME/PATH is resolved as
    NAME/PATH, then as PATH, in `package_path`, in the URDF's folder and then in each folder above it.
    """
    parts = urlsplit(uri)
    if parts.scheme == "package":
        inside = unquote(parts.path).lstrip("/")
        folders = (*([package_path] if package_path else []), *urdf.resolve().parents)
        candidates = [folder / path for folder in folders for path in (f"{parts.netloc}/{inside}", inside)]
    else:
        candidates = [urdf.parent / (unquote(parts.netloc + parts.path) if parts.scheme == "file" else uri)]
    return next((path for path in candidates if path.is_file()), None)


def srdf_path(urdf: Path) -> Path:
    """Return the path of the SRDF of a URDF: beside it, with the same name."""
    return urdf.with_suffix(".srdf")


def read_allowed_pairs(srdf: Path) -> frozenset[frozenset[str]]:
    """Read the pairs of links for which an SRDF disables contact checks.

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


def _convert(source: Path, root: ElementTree.Element, meshes: Mapping[str, Path | None], urdf: Path) -> None:
    """Write URDF, SRDF and meshes to the folder of `urdf`."""
    with atomic_folder(urdf.parent) as work:
        for parent in list(root.iter()):
            for tag in ("mimic", "safety_controller"):
                for child in parent.findall(tag):
                    parent.remove(child)
        for joint in root.findall("joint"):
            for dynamics in joint.findall("dynamics"):
                dynamics.attrib.pop("friction", None)
        targets = _targets(meshes)
        for link in root.findall("link"):
            for element in (*link.findall("collision"), *link.findall("visual")):
                if not _convert_element(source.name, element, meshes, targets, work):
                    link.remove(element)
        if (srdf := srdf_path(source)).is_file():
            srdf_path(work / urdf.name).write_bytes(srdf.read_bytes())
        ElementTree.ElementTree(root).write(work / urdf.name, encoding="utf-8", xml_declaration=True)


def _targets(meshes: Mapping[str, Path | None]) -> dict[str, str]:
    """Return a file name for each existing mesh, by URI; equal names of different folders are numbered."""
    targets: dict[str, str] = {}
    for uri, path in meshes.items():
        if path is not None:
            name = f"{path.stem}.obj"
            targets[uri] = name if name not in targets.values() else f"{path.stem}_{len(targets)}.obj"
    return targets


def _convert_element(
    source: str, element: ElementTree.Element, meshes: Mapping[str, Path | None], targets: Mapping[str, str], work: Path
) -> bool:
    """Convert the meshes of one collision or visual element; return False for an unreadable visual."""
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
            # trimesh reads dozens of formats through other libraries and passes on any of their exceptions
            except Exception as error:
                if not hull:
                    return False
                raise InputError(f"{source}: collision mesh {origin.name} cannot be read ({cause(error)})") from None
            (work / target).write_text(text)
    return True


def _mesh(source: Path, *, hull: bool) -> str:
    """Return the surface of a mesh file, or its convex hull, as the text of an .obj file."""
    import trimesh  # takes half a second, needed for the first run only

    mesh = trimesh.load(source, force="mesh")
    if len(mesh.faces) == 0:
        raise ValueError("it has no triangles")
    mesh = mesh.convex_hull if hull else trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    return str(trimesh.exchange.obj.export_obj(mesh, include_normals=False, include_texture=False, header=None))
