"""Limits of an arm's joints: in a URDF, in a table, in a JSON file of the user."""

import json
import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from kinebench_drake.errors import InputError, UsageError, cause, suggestion
from kinebench_drake.geometry import Array

LEAST_SPEED = 1e-6
"""Lower bound of a speed limit that depends on the position, so that ratios to it are finite [rad/s]."""
JOINT_COUNTS = range(5, 8)
"""Numbers of joints of supported arms."""
UNLIMITED = 100.0 * math.pi
"""Limit of joints without one: fifty turns [rad], or as many metres."""
LIMIT_KINDS = ("position", "velocity", "acceleration", "jerk", "torque")
"""Kinds of limits of joints that are checked where they are stated."""
_Values = Annotated[tuple[float, ...], Field(min_length=JOINT_COUNTS[0], max_length=JOINT_COUNTS[-1])]


class LimitTable(BaseModel):
    """Limits of the joints of an arm, base first, that replace those of a URDF; the JSON of `--limits`."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    source: str | None = None
    """Where the numbers come from."""
    lower_rad: _Values | None = None
    upper_rad: _Values | None = None
    velocity_rad_s: _Values | None = None
    acceleration_rad_s2: _Values | None = None
    jerk_rad_s3: _Values | None = None
    torque_nm: _Values | None = None
    torque_rate_nm_s: _Values | None = None
    velocity_offset_rad_s: _Values | None = None
    """With `deceleration_rad_s2`: speed limits that depend on the position (`JointLimits.speeds`)."""
    deceleration_rad_s2: _Values | None = None


_ATTRIBUTES = {
    "lower_rad": ("limit", "lower"),
    "upper_rad": ("limit", "upper"),
    "velocity_rad_s": ("limit", "velocity"),
    "acceleration_rad_s2": ("limit", "acceleration"),
    "jerk_rad_s3": ("limit", "jerk"),
    "torque_nm": ("limit", "effort"),
    "torque_rate_nm_s": ("limit", "effort_rate"),
    "velocity_offset_rad_s": ("position_based_velocity_limits", "velocity_offset"),
    "deceleration_rad_s2": ("position_based_velocity_limits", "deceleration_limit"),
}
"""Element of a joint and its attribute by field: URDF, its 2025 extension (acceleration, jerk) and Franka's own."""
_UNBOUNDED = {
    "velocity_rad_s": "velocity",
    "torque_nm": "effort",
    "acceleration_rad_s2": "acceleration",
    "jerk_rad_s3": "jerk",
    "torque_rate_nm_s": "torque rate",
}
"""Limits that are infinite where a joint states none, in words by field."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointLimits:
    """Limits of an arm's joints, (J,) each; infinite where a joint states none."""

    lower: Array
    """Lower limits [rad]."""
    upper: Array
    """Upper limits [rad]."""
    velocity: Array
    """Greatest speeds at any position [rad/s]."""
    torque: Array
    """Greatest torques [N m]."""
    acceleration: Array | None = None
    """Greatest accelerations [rad/s^2]; None if no joint states one."""
    jerk: Array | None = None
    """Greatest jerks [rad/s^3]; None if no joint states one."""
    torque_rate: Array | None = None
    """Greatest rates of commanded torques [N m/s], of `export-commands`; None if no joint states one."""
    velocity_offset: Array | None = None
    """Offsets of the speed limits near a position limit [rad/s], with `deceleration`."""
    unlimited: tuple[str, ...] = ()
    """Joints without limits of position that are not continuous: theirs are +-`UNLIMITED`."""
    deceleration: Array | None = None
    """Decelerations that bound the speeds near a position limit [rad/s^2]; None: the speed limits are constant."""

    def speeds(self, q: Array, v: Array) -> Array:
        """Return the speed limits (..., J) [rad/s] at joint angles `q` [rad] in the direction of the speeds `v`.

        Near a position limit min(velocity, sqrt(2 deceleration room) - offset), `room` the angle up to the limit.
        Source: Franka Robotics, "Control Interface Specification and Robot Limits", position-based velocity limits.
        """
        if self.deceleration is None or self.velocity_offset is None:
            return np.broadcast_to(self.velocity, np.shape(v))
        room = np.where(v >= 0.0, self.upper - q, q - self.lower)
        stopping = np.sqrt(2.0 * self.deceleration * np.maximum(room, 0.0)) - self.velocity_offset
        return np.asarray(np.clip(stopping, LEAST_SPEED, self.velocity))

    @property
    def unstated(self) -> tuple[str, ...]:
        """Kinds of limits that at least one joint does not state, so that they cannot be checked."""
        rates = {"velocity": self.velocity, "acceleration": self.acceleration, "jerk": self.jerk, "torque": self.torque}
        kinds = (kind for kind, limit in rates.items() if limit is None or not np.isfinite(limit).all())
        return (*(("position",) if self.unlimited else ()), *kinds)


def read_limit_table(path: Path) -> LimitTable:
    """Read the JSON file of `--limits`.

    Raises:
        UsageError: it cannot be read, or is no table of limits.
    """
    try:
        table = LimitTable.model_validate(json.loads(path.read_bytes()))
    except ValidationError as error:
        first = error.errors()[0]
        key = str(first["loc"][0]) if first["loc"] else ""
        what = f"{key or 'its content'} is not valid ({first['msg']}), expected a number for each joint, base first"
        if first["type"] == "extra_forbidden":
            what = f"has no key {key!r}{suggestion(key, _ATTRIBUTES)}; valid are {', '.join(LimitTable.model_fields)}"
        raise UsageError(f"$limits {path.name}: {what}") from None
    except (OSError, ValueError) as error:
        raise UsageError(f"$limits {path.name}: cannot be read as JSON ({cause(error)})") from None
    if not table.model_dump(include=set(_ATTRIBUTES), exclude_none=True):
        raise UsageError(f"$limits {path.name}: states no limit; valid keys are {', '.join(_ATTRIBUTES)}")
    return table


def write_limits(joints: Sequence[ElementTree.Element], table: LimitTable) -> None:
    """Write the limits of a table into the joint elements of a URDF.

    Raises:
        UsageError: it has not as many numbers as there are joints.
    """
    for name, (tag, attribute) in _ATTRIBUTES.items():
        values: tuple[float, ...] | None = getattr(table, name)
        if values is not None and len(values) != len(joints):
            raise UsageError(f"$limits: {name} has {len(values)} numbers, the arm {len(joints)} joints")
        for joint, value in zip(joints, values or (), strict=False):
            element = joint.find(tag)
            element = ElementTree.SubElement(joint, tag) if element is None else element
            element.set(attribute, repr(value))


def read_limits(file: str, joints: Sequence[ElementTree.Element]) -> JointLimits:
    """Read the limits of the joint elements of a URDF called `file`; limits of 0 are not stated.

    Raises:
        InputError: the limits of a position contradict each other, or another limit is no positive number.
    """
    values = {
        name: np.array([_read(joint, *place, default=math.inf if name in _UNBOUNDED else math.nan) for joint in joints])
        for name, place in _ATTRIBUTES.items()
    }
    lower, upper = (values[name] for name in ("lower_rad", "upper_rad"))
    unlimited = []
    for k, joint in enumerate(joints):
        name = f"{file}: joint {joint.get('name')}"
        limit = joint.find("limit")
        is_stated = limit is not None and {"lower", "upper"} & limit.attrib.keys() and (lower[k] or upper[k])
        if joint.get("type") == "continuous" or not is_stated:
            lower[k] = -UNLIMITED
            upper[k] = UNLIMITED
            unlimited += [str(joint.get("name"))] if joint.get("type") != "continuous" else []
        if not -math.inf < lower[k] < upper[k] < math.inf:
            raise InputError(
                f"{name} has the limits {lower[k]:g} and {upper[k]:g} rad, expected lower < upper, both stated or none"
            )
        for field, what in _UNBOUNDED.items():
            if values[field][k] == 0.0 and field in ("velocity_rad_s", "torque_nm"):
                values[field][k] = math.inf
            if not values[field][k] > 0.0:
                raise InputError(f"{name} has the {what} limit {values[field][k]:g}, expected a positive number")
    offset = values["velocity_offset_rad_s"]
    deceleration = values["deceleration_rad_s2"]
    if np.isnan([offset, deceleration]).any() != np.isnan([offset, deceleration]).all():
        raise InputError(f"{file}: position_based_velocity_limits need both attributes at each joint")
    return JointLimits(
        lower=lower,
        upper=upper,
        velocity=values["velocity_rad_s"],
        torque=values["torque_nm"],
        acceleration=_stated(values["acceleration_rad_s2"]),
        jerk=_stated(values["jerk_rad_s3"]),
        torque_rate=_stated(values["torque_rate_nm_s"]),
        velocity_offset=_stated(offset),
        deceleration=_stated(deceleration),
        unlimited=tuple(unlimited),
    )


def read_number(element: ElementTree.Element, attribute: str, default: float) -> float:
    """Read a numeric attribute, of any namespace, of an element; `default` if it is absent, NaN if it is no number."""
    stated = (value for name, value in element.attrib.items() if name.rpartition("}")[2] == attribute)
    try:
        return float(next(stated, default))
    except ValueError:
        return math.nan


def _read(joint: ElementTree.Element, tag: str, attribute: str, default: float) -> float:
    element = joint.find(tag)
    return default if element is None else read_number(element, attribute, default)


def _stated(limit: Array) -> Array | None:
    return limit if np.isfinite(limit).any() else None
