"""Reading of MJCF files: Drake's model of one, written as a URDF."""

import hashlib
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np

from kinebench_drake.errors import InputError, cause
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.io.files import cache_folder
from kinebench_drake.models.drake_log import silent_drake
from kinebench_drake.models.panda.description import add_inertial

_TYPES = {"revolute": "revolute", "prismatic": "prismatic"}
_SERVOS = ("position", "velocity", "intvelocity", "general")  # actuators whose control is no force


def read_mjcf(source: Path, root: ElementTree.Element) -> ElementTree.Element:
    """Return the root element of a URDF with the links, joints, masses and shapes of an MJCF file.

    Meshes that Drake does not read are converted into the user's cache folder. Free joints become fixed; a free body
    without joints is an object of the scene and has no shapes.

    Raises:
        InputError: a mesh or the file cannot be read.
    """
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
    from pydrake.multibody.tree import BodyIndex
    from pydrake.systems.framework import DiagramBuilder

    plant: Any
    plant, graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.0)
    try:
        _inline(source, root)
        root.set("model", root.get("model") or source.stem)
        _convert_meshes(source, root)
        for servo in (servo for tag in _SERVOS for servo in root.iter(tag)):
            for key in ("ctrlrange", "ctrllimited"):  # which Drake takes for those of forces
                servo.attrib.pop(key, None)
        with silent_drake():  # a line for each attribute that is not of use here
            Parser(plant).AddModelsFromString(ElementTree.tostring(root, encoding="unicode"), "xml")
        plant.Finalize()
    # trimesh passes on exceptions of other libraries
    except Exception as error:
        raise InputError(f"{source.name}: Drake cannot load this MJCF ({cause(error)})") from None
    urdf = ElementTree.Element("robot", name=source.stem)
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    carrying = {joint.parent_body().name() for joint in joints}
    free = {joint.child_body().name() for joint in joints if joint.type_name().endswith("floating")}
    for index in range(plant.num_bodies()):
        body = plant.get_body(BodyIndex(index))
        link = ElementTree.SubElement(urdf, "link", name=body.name())
        if index and body.name() not in free - carrying:  # neither the world nor an object that lies about
            _add_body(link, body, plant, graph.model_inspector())
    efforts = {}
    for index in plant.GetJointActuatorIndices():
        actuator = plant.get_joint_actuator(index)
        efforts[actuator.joint().name()] = actuator.effort_limit()
    for joint in joints:
        _add_joint(urdf, joint, efforts)
    return urdf


def _inline(source: Path, element: ElementTree.Element, around: tuple[str, ...] = ()) -> None:
    """Put the content of included files in the place of their `include` elements; `around` are files about them."""
    for place, child in reversed([*enumerate(element)]):
        if child.tag == "include":
            file = str(child.get("file"))
            if file in around or not (source.parent / file).is_file():
                raise InputError(
                    f"the included file {file} {'includes itself' if file in around else 'does not exist'}"
                )
            own = ElementTree.fromstring((source.parent / file).read_bytes())
            _inline(source, own, (*around, file))
            element[place : place + 1] = [*own]
        else:
            _inline(source, child, around)


def _convert_meshes(source: Path, root: ElementTree.Element) -> None:
    """Point the meshes of an MJCF to .obj files, by their absolute paths; remove masses of 0."""
    import trimesh

    compiler = root.find("compiler")
    about = {} if compiler is None else compiler.attrib
    folder = source.resolve().parent / about.pop("meshdir", about.pop("assetdir", ""))
    for body in root.iter("body"):
        for inertial in body.findall("inertial"):
            if float(inertial.get("mass", 1.0)) <= 0.0:  # at which Drake ends the process
                body.remove(inertial)
    for mesh in root.iter("mesh"):
        if (file := mesh.get("file")) is not None:
            path = folder / file
            if not path.is_file():
                raise InputError(f"its mesh {file} does not exist")
            mesh.set("name", mesh.get("name", path.stem))
            if path.suffix.lower() != ".obj":
                content = path.read_bytes()
                target = cache_folder() / "mjcf" / hashlib.sha256(content).hexdigest()[:16] / f"{path.stem}.obj"
                if not target.is_file():
                    shape = trimesh.load(path, force="mesh")
                    write_atomically(target, str(trimesh.exchange.obj.export_obj(shape)).encode())
                path = target
            mesh.set("file", str(path))


def _add_body(link: ElementTree.Element, body: Any, plant: Any, inspector: Any) -> None:
    from pydrake.geometry import Box, Capsule, Cylinder, Mesh, Role, Sphere

    inertia = body.default_spatial_inertia()
    if inertia.get_mass() > 0.0:
        center = inertia.get_com()
        about_center = inertia.Shift(center).CalcRotationalInertia().CopyToFullMatrix3()
        pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
        numbers = [*center, *(about_center[pair] for pair in pairs)]
        add_inertial(link, *(repr(float(number)) for number in (inertia.get_mass(), *numbers)))
    frame = plant.GetBodyFrameIdOrThrow(body.index())
    for role, tag in ((Role.kProximity, "collision"), (Role.kIllustration, "visual")):
        for geometry in inspector.GetGeometries(frame, role):
            element = ElementTree.SubElement(link, tag)
            _add_origin(element, inspector.GetPoseInFrame(geometry))
            outer = ElementTree.SubElement(element, "geometry")
            match inspector.GetShape(geometry):
                case Box() as shape:
                    ElementTree.SubElement(outer, "box", size=_text(shape.size()))
                case Sphere() as shape:
                    ElementTree.SubElement(outer, "sphere", radius=repr(shape.radius()))
                case Cylinder() as shape:
                    ElementTree.SubElement(outer, "cylinder", radius=repr(shape.radius()), length=repr(shape.length()))
                case Capsule() as shape:
                    size = {"radius": repr(shape.radius()), "length": repr(shape.length())}
                    ElementTree.SubElement(outer, "drake:capsule", size)
                case Mesh() as shape:
                    scale = _text(shape.scale3())
                    ElementTree.SubElement(outer, "mesh", filename=str(shape.source().path()), scale=scale)
                case _:
                    link.remove(element)


def _add_joint(urdf: ElementTree.Element, joint: Any, efforts: dict[str, float]) -> None:
    """Add a joint; where its frame is not that of the child, with a link between."""
    kind = _TYPES.get(joint.type_name(), "fixed")
    child = joint.child_body().name()
    X_CM = joint.frame_on_child().GetFixedPoseInBodyFrame()
    if kind != "fixed" and not X_CM.IsNearlyIdentity(1e-12):
        between = f"{child}_joint_frame"
        ElementTree.SubElement(urdf, "link", name=between)
        _link(
            ElementTree.SubElement(urdf, "joint", name=f"{between}_fixed", type="fixed"), between, child, X_CM.inverse()
        )
        child = between
    X_PF = joint.frame_on_parent().GetFixedPoseInBodyFrame()
    if kind == "fixed":
        X_PF = X_PF @ (joint.X_FM() if joint.type_name() == "weld" else joint.GetDefaultPose()) @ X_CM.inverse()
    element = ElementTree.SubElement(urdf, "joint", name=joint.name(), type=kind)
    _link(element, joint.parent_body().name(), child, X_PF)
    if kind != "fixed":
        axis = joint.revolute_axis() if kind == "revolute" else joint.translation_axis()
        ElementTree.SubElement(element, "axis", xyz=_text(axis))
        ends = {"lower": joint.position_lower_limit(), "upper": joint.position_upper_limit()}
        ends["effort"] = efforts.get(joint.name(), np.inf)
        limits = {key: repr(float(value)) for key, value in ends.items() if np.isfinite(value)}
        ElementTree.SubElement(element, "limit", limits)


def _link(element: ElementTree.Element, parent: str, child: str, X_PC: Any) -> None:
    _add_origin(element, X_PC)
    ElementTree.SubElement(element, "parent", link=parent)
    ElementTree.SubElement(element, "child", link=child)


def _add_origin(element: ElementTree.Element, X: Any) -> None:
    from pydrake.math import RollPitchYaw

    rpy = _text(RollPitchYaw(X.rotation()).vector())
    ElementTree.SubElement(element, "origin", xyz=_text(X.translation()), rpy=rpy)


def _text(numbers: Any) -> str:
    return " ".join(repr(float(number)) for number in numbers)
