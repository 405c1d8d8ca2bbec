"""Contract of a task: its card, the scene drawn from a seed, the success conditions and the progress.

All poses are in the robot base frame B: the table top is the plane z = 0, the robot faces along x, y is to its left.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from kinebench_drake.geometry import Array, invert, make_pose, rotation_z
from kinebench_drake.suites.scene.model import AssetModel
from kinebench_drake.suites.start import START_WIDTH_M

if TYPE_CHECKING:
    from torch import Tensor

    from kinebench_drake.suites.scene.state import State


class Difficulty(Enum):
    """Difficulty of a task."""

    EASY = "easy"
    """One push or one grasp."""
    MEDIUM = "medium"
    """A grasp with a precise release, or contact that must be maintained."""
    HARD = "hard"
    """Prying, or several steps in sequence."""


class TaskVariant(Enum):
    """Variant of a task's scene."""

    PLAIN = "plain"
    OBSTACLES = "obstacles"
    """An obstacle stands in the way and must not be knocked over."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskCard:
    """Metadata of a task."""

    id: str
    """Plain id such as "StackCube-v1"."""
    family: str
    """Kind of objects manipulated, such as "boxes"."""
    difficulty: Difficulty
    articulated_dof: int = 0
    """Number of joints of the objects in the scene."""
    axes: str = ""
    """World axes of these joints, such as "z"; empty if there are none."""
    contacts: int = 1
    """Number of separate contacts of the gripper: grasps, pushes, pries."""
    clips: int = 1
    """Clips of 49 frames that the expert needs; each begins and ends at rest."""
    variants: tuple[TaskVariant, ...] = (TaskVariant.PLAIN,)

    @property
    def horizon(self) -> int:
        """Number of frames that the expert needs, including the first."""
        return 48 * self.clips + 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Placement:
    """One object and its initial pose."""

    model: AssetModel
    X_BM: Array
    """Pose (4, 4) of the first body [m]."""
    joint: float = 0.0
    """Joint position of an articulated object [rad or m]."""
    decor: bool = False
    """True if the object is only visible and has no collision geometry, such as a mark on the table."""
    avoid: bool = False
    """True if the object must not be touched: plans keep the gripper clear of it too."""

    @classmethod
    def upright(
        cls,
        model: AssetModel,
        p_BM: tuple[float, float, float],
        yaw_rad: float = 0.0,
        *,
        joint: float = 0.0,
        decor: bool = False,
        avoid: bool = False,
    ) -> "Placement":
        """Place an upright object with its origin at a point of B, rotated about z by `yaw_rad`."""
        return cls(model=model, X_BM=make_pose(rotation_z(yaw_rad), p_BM), joint=joint, decor=decor, avoid=avoid)


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneLayout:
    """Initial scene. All seeds of a task and variant have the same object names."""

    placements: Mapping[str, Placement]
    """Objects by their role in the task, such as "target"."""
    prompt: str
    """Text prompt for a world model."""
    finger_width_m: float = 0.08
    """Initial gap between the finger pads."""

    def scene(self, X_BG: Array) -> "Scene":
        """Return the initial scene as an expert receives it, with the TCP at a pose (4, 4); needs no simulator."""
        poses = {name: placement.X_BM for name, placement in self.placements.items()}
        for name, placement in self.placements.items():
            for body in placement.model.bodies[1:]:
                if body.joint is not None:
                    X_JJ = body.joint.motion(placement.joint)
                    poses[f"{name}/{body.name}"] = (
                        placement.X_BM @ body.joint.X_ParentJ @ X_JJ @ invert(body.joint.X_BodyJ)
                    )
        return Scene(
            X_BG=X_BG,
            finger_width_m=self.finger_width_m,
            poses=poses,
            joints={name: p.joint for name, p in self.placements.items() if p.model.articulated},
            models={name: placement.model for name, placement in self.placements.items()},
            avoided=self.avoided,
        )

    @property
    def avoided(self) -> frozenset[str]:
        """Names of objects that must not be touched."""
        return frozenset(name for name, p in self.placements.items() if p.avoid)


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """Ground-truth state of one scene at one moment, as an expert receives it; poses in B [m]."""

    X_BG: Array
    """(4, 4) pose of panda_hand_tcp."""
    finger_width_m: float
    """Gap between the finger pads."""
    poses: Mapping[str, Array]
    """(4, 4) pose of each object and of each further body of an articulation, as "box/lid"."""
    joints: Mapping[str, float]
    """Joint position of each articulated object [rad or m]."""
    models: Mapping[str, AssetModel]
    """Asset of each object."""
    avoided: frozenset[str] = frozenset()
    """Names of objects that must not be touched."""

    def site(self, name: str, site: str) -> Array:
        """Return the pose (4, 4) of a site of the object `name`."""
        frame = self.models[name].sites[site]
        body = name if frame.body == self.models[name].bodies[0].name else f"{name}/{frame.body}"
        return np.asarray(self.poses[body] @ frame.X_BodyS)

    def size(self, name: str, measure: str) -> float:
        """Return a dimension of the object `name` [m or rad]."""
        return self.models[name].size[measure]


class Task(ABC):
    """A manipulation task. The docstring of each subclass states Description, Randomizations and Success."""

    card: TaskCard
    slots: ClassVar[Mapping[str, str]]
    """Asset kind from which an episode draws an asset, for each slot."""

    def slots_of(self, variant: TaskVariant) -> Mapping[str, str]:
        """Return the slots of a variant: `slots`, and one for the obstacle in the variant that has one."""
        return self.slots if variant is TaskVariant.PLAIN else {**self.slots, "obstacle": "obstacle/upright"}

    @abstractmethod
    def layout(self, models: Mapping[str, AssetModel], rng: np.random.Generator, variant: TaskVariant) -> SceneLayout:
        """Draw the initial scene."""

    @abstractmethod
    def conditions(self, state: "State") -> "dict[str, Tensor]":
        """Return the named sub-conditions, each (N,) bool for N scenes; success is their conjunction."""

    @abstractmethod
    def progress(self, state: "State") -> "Tensor":
        """Return the progress (N,): 0 at the start, 1 at the goal. The environment clips it to 0..1."""


class JointTask(Task):
    """Task of moving the joint of one articulated object past a goal; it has a single slot."""

    prompt: str
    """Prompt with a placeholder for the object's name."""
    reached: ClassVar[str]
    """Name of the condition: "open" if the joint is to be at the goal or above, else "shut" or "closed"."""

    @abstractmethod
    def place(self, model: AssetModel, rng: np.random.Generator) -> Placement:
        """Draw the initial pose and joint position of the object."""

    @abstractmethod
    def goal(self, state: "State") -> "Tensor | float":
        """Return the joint position (N,) at which the task is done [rad or m]."""

    @abstractmethod
    def rest_conditions(self, state: "State") -> "dict[str, Tensor]":
        """Return the conditions (N,) other than that of the joint's position."""

    def layout(self, models: Mapping[str, AssetModel], rng: np.random.Generator, variant: TaskVariant) -> SceneLayout:
        """Place the object alone."""
        [(name, model)] = models.items()
        return SceneLayout(
            placements={name: self.place(model, rng)},
            prompt=self.prompt.format(model.words),
            finger_width_m=START_WIDTH_M[self.card.id],
        )

    def conditions(self, state: "State") -> "dict[str, Tensor]":
        """Return the conditions of the joint's position and of rest."""
        [name] = self.slots
        position = state.joints[name]
        goal = self.goal(state)
        reached = position >= goal if self.reached == "open" else position <= goal
        return {self.reached: reached, **self.rest_conditions(state)}

    def progress(self, state: "State") -> "Tensor":
        """Return the fraction of the joint's way to the goal."""
        [name] = self.slots
        return state.joint_progress(name, self.goal(state))
