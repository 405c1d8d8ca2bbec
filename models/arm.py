"""Loading of arms: by name, or from a URDF; with limits, tool, payload and obstacles of the user."""

import copy
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import MappingProxyType

import numpy as np

from kinebench_drake.errors import InputError, SetupError, UsageError, suggestion
from kinebench_drake.geometry import Array
from kinebench_drake.io.files import absence, cache_folder
from kinebench_drake.io.jsonl import Json
from kinebench_drake.models.joint_limits import (
    LIMIT_KINDS,
    JointLimits,
    LimitTable,
    read_limit_table,
    read_limits,
    read_number,
    write_limits,
)
from kinebench_drake.models.named_arm import named_arms
from kinebench_drake.models.obstacles import PREFIX, SCHEME, read_obstacles
from kinebench_drake.models.panda.description import (
    ARM_JOINTS,
    FLANGE_LINK,
    FR3_LIMITS,
    PANDA_LIMITS,
    REMARK,
    TCP_LINK,
    add_inertial,
    make_fr3,
    source_urdf,
)
from kinebench_drake.models.panda.description import rest_q as panda_rest_q
from kinebench_drake.models.robot import Robot
from kinebench_drake.models.urdf import (
    MOVING,
    LinkTree,
    convert_urdf,
    end_link,
    find_mesh,
    read_allowed_pairs,
    read_urdf,
    srdf_path,
)

PANDA = "panda"
FR3 = "fr3"
ROBOTS: Mapping[str, LimitTable] = MappingProxyType({PANDA: PANDA_LIMITS, FR3: FR3_LIMITS})
"""Franka's arms, with their published limits; both on mani_skill's URDF of the Panda."""
MAX_PAYLOAD_KG = 50.0
"""Greatest payload [kg]; more is taken for another unit."""

_TCP = "tcp"  # attribute of the root element of a converted URDF: name of the link whose frame is G
_FREE = "angles"  # attribute of the root element: changes the hash of arms whose conversion has changed
_TOOL_LINK = "added_tool"
_PAYLOAD_LINK = "added_payload"


@cache
def panda() -> Robot:
    """Return the Panda with its gripper, as in ManiSkill.

    Raises:
        SetupError: mani_skill is missing or damaged, or the cache folder cannot be written.
    """
    try:
        return load_robot(PANDA)
    except InputError as error:
        raise SetupError(f"mani_skill's Panda is damaged, reinstall mani-skill 3.0.x ({error})") from None


def load_robot(
    robot: str | Path = PANDA,
    tool: str | None = None,
    *,
    limits: Path | None = None,
    payload_kg: float = 0.0,
    obstacles: Path | None = None,
    package_path: Path | None = None,
) -> Robot:
    """Load an arm: the links between the root of its URDF and the tool, whose frame is G.

    There must be five to seven moving joints between the two, or beyond the last link from which another limb begins. A
    limit that is not stated is not checked. Prismatic joints beyond them are fingers, each opened by half the gap
    between the pads within its limits; other joints elsewhere are fixed at 0, or at their limit nearest to it. Where no
    link has a shape for contact, it is the convex hull of its visual meshes. Pairs of links
    excluded from contact checks are read from an SRDF of the same name beside the URDF; without one they are those of
    `Robot.allowed_pairs`. The rest posture is the Panda's if the joints have its names and their limits contain it,
    else the middle of the limits.

    Args:
        robot: name in `named_arms`, or path of a URDF.
        tool: link of the URDF, or pose "[LINK:]x,y,z,qw,qx,qy,qz" [m] of G in a link (of a named robot its flange);
            None: panda_hand_tcp of a named robot.
        limits: JSON file of limits that replace those of the robot (`LimitTable`).
        payload_kg: mass of a point at the origin of G [kg].
        obstacles: JSON file of bodies that the arm must not touch (`obstacles.Obstacle`).
        package_path: folder in which packages of package:// URIs are looked up first.
    """
    named = named_arms().get(str(robot))
    source, table = _find(robot)
    root = read_urdf(source)
    remarks = [REMARK] if robot == FR3 else []
    remarks += _fix_base(root)
    _number_actuators(root)
    default = (named.tool or TCP_LINK) if named else ""
    tcp = _place_tool(LinkTree(source.name, root), root, tool or default or None, default.partition(":")[0])
    if robot == FR3:
        make_fr3(root)
    joints = LinkTree(source.name, root).arm(tcp)
    if named and named.package:
        _drop_assumed(joints)
    for stated in (table, None if limits is None else read_limit_table(limits)):
        if stated is not None:
            write_limits(joints, stated)
    read_limits(source.name, joints)  # before the conversion, which takes seconds
    _add_payload(root, tcp, payload_kg)
    if obstacles is not None:
        _add_obstacles(root, obstacles)
    root.set(_TCP, tcp)
    if continuous := [str(joint.get("name")) for joint in joints if joint.get("type") == "continuous"]:
        remarks.append(f"continuous joints have no limits of position: {', '.join(continuous)}")
        root.set(_FREE, "continuous")
    remarks += _fix_others(LinkTree(source.name, root), joints)
    remarks += _complete_shapes(source, root, package_path)
    visuals = _count_visuals(root)
    loaded = _read(convert_urdf(source, Path(robot).stem, root, package_path, obstacles and obstacles.parent))
    left = _count_visuals(read_urdf(loaded.urdf))
    if lost := [link for link, n in visuals.items() if n > left[link]]:
        remarks.append(f"visual meshes that cannot be read are not drawn: those of {', '.join(lost)}")
    if loaded.allowed_pairs is None:
        srdf = srdf_path(source).name
        remarks.append(f"no {srdf} beside the URDF: links in contact at mid-range of all joints are not checked")
    if unstated := loaded.limits.unstated:
        remarks.append(
            f"states no limits of {' and '.join(unstated)}, which are not checked: feasible means feasible as far as "
            "checked; $limits states them"
        )
    return replace(loaded, remarks=tuple(remarks), columns=named.columns if named else ())


def _fix_base(root: ElementTree.Element) -> list[str]:
    """Fix links that float to their parents; return a remark about it."""
    floating = [joint for joint in root.findall("joint") if joint.get("type") == "floating"]
    for joint in floating:
        joint.set("type", "fixed")
    names = ", ".join(str(joint.get("name")) for joint in floating)
    return [f"floating joints are taken as fixed, the base does not move: {names}"] if floating else []


def _number_actuators(root: ElementTree.Element) -> None:
    """Give actuators that share a name, which Drake refuses, names of their own."""
    actuators = [*root.iter("actuator")]
    if len({actuator.get("name") for actuator in actuators}) < len(actuators):
        for k, actuator in enumerate(actuators):
            actuator.set("name", f"actuator_{k}")


def _fix_others(tree: LinkTree, joints: Sequence[ElementTree.Element]) -> list[str]:
    """Fix the joints that are neither of the arm nor of its fingers at 0 where their limits allow it.

    Also drop what mimics another joint, but for the direction in which a finger opens. Return a remark about joints
    between the root and the arm.
    """
    fingers = tree.fingers(joints)
    before = tree.chain(end_link(joints[0], "parent"))
    moved = [str(joint.get("name")) for joint in before if joint.get("type") in MOVING]
    others: list[str] = []
    for joint in tree.joints:
        if joint not in joints and joint not in fingers and joint.get("type") in MOVING:
            limit = joint.find("limit")
            ends = [0.0 if limit is None else read_number(limit, name, 0.0) for name in ("lower", "upper")]
            if joint.get("type") == "continuous" or ends[0] <= 0.0 <= ends[1]:
                joint.set("type", "fixed")
            others += [link for link in tree.links if joint in (path := [*tree.chain(link)]) and joints[0] not in path]
    shaped = [link for link in dict.fromkeys(others) if tree.elements[link].find("collision") is not None]
    for link in shaped if moved or len(others) > len(joints) else ():  # at an unknown posture
        for collision in tree.elements[link].findall("collision"):
            tree.elements[link].remove(collision)
    remarks = [f"joints between the base and the arm are fixed: {', '.join(moved)}"] if moved else []
    return [*remarks, *([f"contacts with other limbs are not checked: {', '.join(shaped)}"] if shaped else [])]


def _complete_shapes(source: Path, root: ElementTree.Element, package_path: Path | None) -> list[str]:
    """Give links the shapes of their visuals for contact where no link has one; return a remark about it."""
    links = root.findall("link")
    if any(link.find("collision") is not None for link in links):
        return []
    for link in links:
        for visual in link.findall("visual"):
            meshes = [str(mesh.get("filename")) for mesh in visual.iter("mesh")]
            if all(uri.startswith(SCHEME) or find_mesh(source, uri, package_path) for uri in meshes):
                own = ElementTree.SubElement(link, "collision")
                own.extend(copy.deepcopy(child) for child in visual if child.tag in ("origin", "geometry"))
    shapes = sum(link.find("collision") is not None for link in links)
    if not shapes:
        return ["no link has a shape for contact: collisions are not checked"]
    return [f"no link has a shape for contact: the convex hulls of the visual meshes of {shapes} links are used"]


def load_converted(id: str) -> Robot | None:
    """Load a robot of the cache folder by its `Robot.id`; None if it is not there."""
    urdf = cache_folder() / Path(id).name / f"{id.rpartition('-')[0]}.urdf"
    return _read(urdf) if urdf.is_file() else None


def arm_limits(name: str) -> tuple[tuple[str, ...], JointLimits]:
    """Return the joints of an arm by name, and their limits, without a conversion of its meshes."""
    arm = named_arms()[name]
    source, table = _find(name)
    root = read_urdf(source)
    joints = LinkTree(source.name, root).arm(arm.tool.partition(":")[0] or TCP_LINK)
    if arm.package:
        _drop_assumed(joints)
    write_limits(joints, table or LimitTable())
    return tuple(str(joint.get("name")) for joint in joints), read_limits(source.name, joints)


def list_arms() -> list[dict[str, Json]]:
    """Return what is known of each arm by name: joints, checked and unchecked limits, sources; or how to install it."""
    listed: list[dict[str, Json]] = []
    for name, arm in named_arms().items():
        table = ROBOTS.get(name, arm.limits)
        about: dict[str, Json] = {"name": name, "title": arm.title, "source": table.source or arm.source}
        try:
            of_arms = [arm_limits(own) for own in arm.arms or (name,)]
            limits = of_arms[0][1]
            checked = [kind for kind in LIMIT_KINDS if kind not in limits.unstated]
            about |= {
                "joints": [joint for joints, _ in of_arms for joint in joints],
                "checked": [*checked],
                "unchecked": [*limits.unstated],
            }
        except SetupError as error:
            about["missing"] = str(error)
        listed.append(about)
    return listed


def _drop_assumed(joints: Sequence[ElementTree.Element]) -> None:
    """Remove limits of acceleration and jerk, which descriptions of arms by name state without a source."""
    for limit in (limit for joint in joints for limit in joint.findall("limit")):
        for key in [key for key in limit.attrib if key.endswith(("acceleration", "jerk"))]:
            del limit.attrib[key]


def _find(robot: str | Path) -> tuple[Path, LimitTable | None]:
    """Return the URDF of a robot, and the limits published for one with a name."""
    if str(robot) in ROBOTS:
        return source_urdf(), ROBOTS[str(robot)]
    if (arm := named_arms().get(str(robot))) and arm.arms:
        raise UsageError(f"$robot {robot} has two arms, which `audit` judges: expected one of {' and '.join(arm.arms)}")
    if arm:
        return arm.path(), arm.limits
    path = Path(robot)
    if not path.is_file():
        raise UsageError(f"$robot {robot}: {absence(path)}, expected {', '.join(named_arms())} or the path of a URDF")
    return path, None


def _place_tool(tree: LinkTree, root: ElementTree.Element, tool: str | None, own: str) -> str:
    """Return the link whose frame is G; a pose, by default in the flange of an arm with tool `own`, is a new link."""
    links = f"the links of {tree.file} are {', '.join(tree.links)}"
    if tool is None:
        raise UsageError(f"$tool names no TCP frame of $robot {tree.file}; {links}")
    pose = re.fullmatch(r"(?:(.*):)?([^:]*,[^:]*)", tool)
    if pose is None:
        if tool not in tree.elements:
            raise UsageError(f"$tool: {tree.file} has no link {tool!r}{suggestion(tool, tree.links)}; {links}")
        return tool
    parent = pose[1] or (FLANGE_LINK if own == TCP_LINK else own)
    if parent not in tree.elements:
        raise UsageError(f"$tool {tool}: expected LINK:x,y,z,qw,qx,qy,qz, the pose of the TCP in a link; {links}")
    try:
        x, y, z, *quaternion = map(float, pose[2].split(","))
        unit = len(quaternion) == 4 and abs(float(np.linalg.norm(quaternion)) - 1.0) <= 1e-3
    except ValueError:
        unit = False
    if not unit or not np.isfinite([x, y, z]).all():
        raise UsageError(f"$tool {tool}: expected x,y,z,qw,qx,qy,qz, metres and a unit quaternion")
    _add_link(root, _TOOL_LINK, parent, f"{x!r} {y!r} {z!r}", _rpy(quaternion))
    return _TOOL_LINK


def _rpy(quaternion: Sequence[float]) -> str:
    """Return the angles of a URDF for a quaternion wxyz."""
    from pydrake.common.eigen_geometry import Quaternion
    from pydrake.math import RollPitchYaw

    angles = RollPitchYaw(Quaternion(np.array(quaternion) / np.linalg.norm(quaternion))).vector()
    return " ".join(map(repr, angles.tolist()))


def _add_obstacles(root: ElementTree.Element, path: Path) -> None:
    """Add the obstacles of a file as links fixed to the base, each shape for contact and for pictures."""
    base = LinkTree(path.name, root).root
    for obstacle in read_obstacles(path):
        xyz = " ".join(map(repr, obstacle.position_m))
        link = _add_link(root, PREFIX + obstacle.name, base, xyz, _rpy(obstacle.quaternion_wxyz))
        for role in ("collision", "visual"):
            ElementTree.SubElement(link, role).append(obstacle.geometry())


def _add_payload(root: ElementTree.Element, tcp: str, payload_kg: float) -> None:
    """Add the payload as a point mass at the TCP."""
    if not 0.0 <= payload_kg <= MAX_PAYLOAD_KG:
        raise UsageError(f"$payload_kg is {payload_kg}, expected kilograms from 0 to {MAX_PAYLOAD_KG:g}")
    if payload_kg:
        add_inertial(_add_link(root, _PAYLOAD_LINK, tcp, "0 0 0", "0 0 0"), repr(payload_kg), *["0"] * 9)


def _add_link(root: ElementTree.Element, name: str, parent: str, xyz: str, rpy: str) -> ElementTree.Element:
    link = ElementTree.SubElement(root, "link", name=name)
    joint = ElementTree.SubElement(root, "joint", name=f"{name}_joint", type="fixed")
    ElementTree.SubElement(joint, "origin", xyz=xyz, rpy=rpy)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=name)
    return link


def _count_visuals(root: ElementTree.Element) -> dict[str, int]:
    return {str(link.get("name")): len(link.findall("visual")) for link in root.findall("link")}


def _read(urdf: Path) -> Robot:
    """Read a converted robot."""
    root = read_urdf(urdf)
    srdf = srdf_path(urdf)
    tree = LinkTree(urdf.name, root)
    tcp = str(root.get(_TCP))
    joints = tree.arm(tcp)
    names = tuple(str(joint.get("name")) for joint in joints)
    limits = read_limits(urdf.name, joints)
    fingers = tree.fingers(joints)
    along = [tree.root, *(end_link(joint, "child") for joint in tree.chain(tcp))]
    return Robot(
        name=urdf.stem,
        urdf=urdf,
        base_link=tree.root,
        tcp_link=tcp,
        hand_link=end_link(fingers[0], "parent") if fingers else tree.body(tcp),
        joints=names,
        finger_joints=tuple(str(joint.get("name")) for joint in fingers),
        finger_signs=tuple(map(_opening, fingers)),
        links=(*along, *(link for link in tree.links if link not in along)),
        rest_q=_rest(names, limits.lower, limits.upper),
        limits=limits,
        allowed_pairs=read_allowed_pairs(srdf) if srdf.is_file() else None,
    )


def _opening(finger: ElementTree.Element) -> float:
    """Return 1 if a finger opens towards its upper limit, -1 if towards its lower one."""
    limit = finger.find("limit")
    ends = [0.0 if limit is None else abs(read_number(limit, name, 0.0)) for name in ("lower", "upper")]
    return -1.0 if ends[0] > ends[1] else 1.0


def _rest(names: tuple[str, ...], lower: Array, upper: Array) -> Array:
    rest = panda_rest_q()
    fits = names == ARM_JOINTS and bool(((rest >= lower) & (rest <= upper)).all())
    return rest if fits else np.asarray(0.5 * (lower + upper))
