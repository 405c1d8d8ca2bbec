"""Loading of any seven-joint arm from its URDF and the name of its tool link."""

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.models.panda.robot import ARM_JOINTS, panda
from kinebench_drake.models.panda.robot import rest_q as panda_rest_q
from kinebench_drake.models.robot import N_JOINTS, Robot
from kinebench_drake.models.urdf import (
    convert_urdf,
    read_allowed_pairs,
    read_effort_limits,
    read_number,
    read_urdf,
    srdf_path,
)

_TURNING = ("revolute", "continuous")
_KNOWN = (*_TURNING, "prismatic", "fixed")


def choose_robot(urdf: Path | None, tcp_link: str | None) -> Robot:
    """Load the arm of a URDF with the link `tcp_link` as frame G, or mani_skill's Panda if there is no URDF.

    Raises:
        InputError: the URDF or its SRDF cannot be used.
        SetupError: the Panda's files are missing, or the cache folder cannot be written.
        UsageError: the URDF has no such link.
    """
    return panda() if urdf is None else load_robot(urdf, tcp_link or "")


def load_robot(urdf: Path, tcp_link: str) -> Robot:
    """Load the arm between the root link of a URDF and `tcp_link`, whose frame is G.

    There must be seven revolute or continuous joints between the two (continuous ones get the limits -pi and pi), each
    with limits of position and speed. Prismatic joints elsewhere are fingers, each opened by half the gap between the
    pads within its limits; other joints elsewhere are fixed at 0, or at their limit nearest to it. Pairs of links
    excluded from contact checks are read from an SRDF of the same name beside the URDF; without one they are those of
    `Robot.allowed_pairs`. The rest posture is the Panda's if the joints have its names and their limits contain it,
    else the middle of the limits.

    Raises:
        UsageError: there is no such file, or no such link in it.
        InputError: the file is no URDF, its chain does not have seven revolute joints with limits, or one of its
            collision meshes cannot be read.
        SetupError: the cache folder cannot be written.
    """
    if not urdf.is_file():
        raise UsageError(f"{urdf.name}: there is no such file, expected a URDF")
    root = read_urdf(urdf)
    tree = _Tree(urdf.name, root)
    if tcp_link not in tree.links:
        raise UsageError(f"{urdf.name} has no link {tcp_link!r}; it has {', '.join(tree.links)}")
    chain = tuple(tree.chain(tcp_link))
    moving = [joint for joint in chain if joint.get("type") != "fixed"]
    names = tuple(str(joint.get("name")) for joint in moving)
    for joint in moving:
        if joint.get("type") not in _TURNING:
            raise InputError(
                f"{urdf.name}: joint {joint.get('name')} between {tree.root} and {tcp_link} is {joint.get('type')}, "
                "expected revolute or continuous joints"
            )
    if len(moving) != N_JOINTS:
        raise InputError(
            f"{urdf.name}: {len(moving)} revolute joints between {tree.root} and {tcp_link} "
            f"({', '.join(names) or 'none'}), expected {N_JOINTS}"
        )
    lower, upper = np.array([_limits(urdf.name, joint) for joint in moving]).T
    converted = convert_urdf(urdf, urdf.stem)
    srdf = srdf_path(urdf)
    fingers = [j for j in tree.joints if j.get("type") == "prismatic"]
    hand = _end(fingers[0], "parent") if fingers else tree.body(tcp_link)
    along = [tree.root, *(_end(joint, "child") for joint in chain)]
    return Robot(
        name=urdf.stem,
        urdf=converted,
        base_link=tree.root,
        tcp_link=tcp_link,
        hand_link=hand,
        joints=names,
        finger_joints=tuple(str(joint.get("name")) for joint in fingers),
        links=(*along, *(link for link in tree.links if link not in along)),
        rest_q=_rest(names, lower, upper),
        effort_limits=read_effort_limits(urdf, names),
        acceleration_limits=None,
        jerk_limits=None,
        allowed_pairs=read_allowed_pairs(srdf) if srdf.is_file() else None,
        remarks=tuple(_remarks(root, read_urdf(converted), moving, srdf)),
    )


class _Tree:
    """Links and joints of a URDF, checked to be a tree."""

    def __init__(self, file: str, root: ElementTree.Element) -> None:
        self.elements = {str(link.get("name")): link for link in root.findall("link")}
        self.links = tuple(self.elements)
        self.joints = root.findall("joint")
        self.inboard: dict[str, ElementTree.Element] = {}
        for joint in self.joints:
            name, child = joint.get("name"), _end(joint, "child")
            if joint.get("type") not in _KNOWN:
                raise InputError(f"{file}: joint {name} is {joint.get('type')}, expected {', '.join(_KNOWN)}")
            for end in (_end(joint, "parent"), child):
                if end not in self.elements:
                    raise InputError(f"{file}: joint {name} names the link {end!r}, which the file lacks")
            if child in self.inboard:
                raise InputError(
                    f"{file}: link {child} hangs on two joints, {self.inboard[child].get('name')} and {name}"
                )
            self.inboard[child] = joint
        roots = [link for link in self.links if link not in self.inboard]
        if len(roots) != 1:
            raise InputError(f"{file}: {len(roots)} links hang on no joint ({', '.join(roots)}), expected one base")
        self.root = roots[0]
        reached = fresh = set(roots)
        while fresh:
            fresh = {link for link, joint in self.inboard.items() if _end(joint, "parent") in reached} - reached
            reached = reached | fresh
        if loop := [link for link in self.links if link not in reached]:
            raise InputError(f"{file}: the joints of {', '.join(loop)} form a loop, expected a tree")

    def chain(self, link: str) -> Iterator[ElementTree.Element]:
        """Yield the joints from the root to `link`."""
        if link != self.root:
            joint = self.inboard[link]
            yield from self.chain(_end(joint, "parent"))
            yield joint

    def body(self, link: str) -> str:
        """Return the link itself or its nearest ancestor with a visual; the root if none has one."""
        while link != self.root and self.elements[link].find("visual") is None:
            link = _end(self.inboard[link], "parent")
        return link


def _end(joint: ElementTree.Element, tag: str) -> str:
    element = joint.find(tag)
    return "" if element is None else str(element.get("link"))


def _limits(file: str, joint: ElementTree.Element) -> tuple[float, float]:
    """Return lower and upper limit [rad] of a revolute or continuous joint."""
    name = joint.get("name")
    limit = joint.find("limit")
    limit = ElementTree.Element("limit") if limit is None else limit
    speed = read_number(limit, "velocity", math.nan)
    if not (0.0 < speed < math.inf):
        raise InputError(f"{file}: joint {name} has no positive velocity limit; state it in its <limit> element")
    if joint.get("type") == "continuous":
        return -math.pi, math.pi
    lower, upper = (read_number(limit, side, math.nan) for side in ("lower", "upper"))
    if not (-math.inf < lower < upper < math.inf):
        raise InputError(
            f"{file}: joint {name} has the limits {lower:g} and {upper:g} rad, expected lower < upper, both stated"
        )
    return lower, upper


def _rest(names: tuple[str, ...], lower: Array, upper: Array) -> Array:
    rest = panda_rest_q()
    fits = names == ARM_JOINTS and bool(((rest >= lower) & (rest <= upper)).all())
    return rest if fits else np.asarray(0.5 * (lower + upper))


def _remarks(
    source: ElementTree.Element, converted: ElementTree.Element, moving: list[ElementTree.Element], srdf: Path
) -> Iterator[str]:
    continuous = [str(joint.get("name")) for joint in moving if joint.get("type") == "continuous"]
    if continuous:
        yield f"continuous joints are limited to -pi..pi: {', '.join(continuous)}"
    left = {str(link.get("name")): len(link.findall("visual")) for link in converted.findall("link")}
    lost = [
        name for link in source.findall("link") if len(link.findall("visual")) > left[name := str(link.get("name"))]
    ]
    if lost:
        yield f"visual meshes that cannot be read are not drawn: those of {', '.join(lost)}"
    if not srdf.is_file():
        yield f"no {srdf.name} beside the URDF: links in contact at mid-range of all joints are not checked"
