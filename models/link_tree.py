"""Tree of the links of a URDF, and the arm in it."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator

from kinebench_drake.errors import InputError
from kinebench_drake.models.robot import N_JOINTS

TURNING = ("revolute", "continuous")
"""Types of the joints of an arm."""
JOINT_TYPES = (*TURNING, "prismatic", "fixed")
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
            raise InputError(f"{file}: {len(roots)} links hang on no joint ({', '.join(roots)}), expected one base")
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
        """Return the seven moving joints between the root and the link `tcp`.

        Raises:
            InputError: there are more or fewer, or one is neither revolute nor continuous.
        """
        moving = [joint for joint in self.chain(tcp) if joint.get("type") != "fixed"]
        for joint in moving:
            if joint.get("type") not in TURNING:
                raise InputError(
                    f"{self.file}: joint {joint.get('name')} between {self.root} and {tcp} is {joint.get('type')}, "
                    "expected revolute or continuous joints"
                )
        if len(moving) != N_JOINTS:
            names = ", ".join(str(joint.get("name")) for joint in moving) or "none"
            raise InputError(
                f"{self.file}: {len(moving)} revolute joints between {self.root} and {tcp} ({names}), "
                f"expected {N_JOINTS}"
            )
        return tuple(moving)

    def body(self, link: str) -> str:
        """Return the link itself or its nearest ancestor with a visual; the root if none has one."""
        while link != self.root and self.elements[link].find("visual") is None:
            link = end_link(self.inboard[link], "parent")
        return link


def end_link(joint: ElementTree.Element, tag: str) -> str:
    """Return the link at an end of a joint, `tag` "parent" or "child"; empty if it is not stated."""
    element = joint.find(tag)
    return "" if element is None else str(element.get("link"))
