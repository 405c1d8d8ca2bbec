"""What a task consists of: a scene drawn from a seed, conditions of success, and how far things have come.

Everything is in the robot base frame B: the table top is the plane z = 0, the robot looks along x, y is to its left.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from kinebench_drake.geometry import Array, invert
from kinebench_drake.suites.assets.model import Model
from kinebench_drake.suites.tasks.card import TaskCard, TaskVariant

if TYPE_CHECKING:
    from torch import Tensor

    from kinebench_drake.suites.tasks.state import State


@dataclass(frozen=True, slots=True, kw_only=True)
class Placement:
    """One thing in its place."""

    model: Model
    X_BM: Array
    """Pose (4, 4) of its first body [m]."""
    joint: float = 0.0
    """Position of its joint, if it has one [rad or m]."""
    fixed: bool = False
    """Whether it cannot be moved; the first body of an articulation never can."""
    decor: bool = False
    """Whether it is only to be seen, such as a mark on the table."""
    avoid: bool = False
    """Whether it must not be touched: plans keep the gripper off, too."""

    @property
    def movable(self) -> bool:
        """Whether physics moves it, or its joint."""
        return not (self.fixed or self.decor)


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneLayout:
    """A scene as it begins. Every seed of a task and variant has the same names, for simulation in batches."""

    placements: Mapping[str, Placement]
    """Things by their role in the task, such as "target"."""
    prompt: str
    """The task in words, as a world model is asked."""
    finger_width_m: float = 0.08
    """Gap between the finger pads at the start."""

    def scene(self, X_BG: Array) -> "Scene":
        """What an expert would see before anything moves, the gripper at a pose (4, 4): no simulator is needed."""
        poses = {name: placed.X_BM for name, placed in self.placements.items()}
        for name, placed in self.placements.items():
            for body in placed.model.bodies[1:]:
                if body.joint is not None:
                    moved = body.joint.motion(placed.joint)
                    poses[f"{name}/{body.name}"] = (
                        placed.X_BM @ body.joint.X_ParentJ @ moved @ invert(body.joint.X_BodyJ)
                    )
        articulated = {name: p.joint for name, p in self.placements.items() if p.model.articulated}
        return Scene(
            X_BG=X_BG,
            finger_width_m=self.finger_width_m,
            poses=poses,
            joints=articulated,
            models={name: placed.model for name, placed in self.placements.items()},
            starts=poses,
            fixed=self.fixed,
            avoided=self.avoided,
        )

    @property
    def fixed(self) -> frozenset[str]:
        """Things that cannot be moved, beside the first bodies of articulations."""
        return frozenset(name for name, placed in self.placements.items() if placed.fixed and not placed.decor)

    @property
    def avoided(self) -> frozenset[str]:
        """Things that must not be touched."""
        return frozenset(name for name, placed in self.placements.items() if placed.avoid)


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """One scene at one moment, as an expert sees it: true poses in B [m]."""

    X_BG: Array
    """(4, 4) panda_hand_tcp."""
    finger_width_m: float
    """Gap between the finger pads."""
    poses: Mapping[str, Array]
    """(4, 4) of each thing; of an articulation each body's too, as "box/lid"."""
    joints: Mapping[str, float]
    """Joint position of each articulated thing [rad or m]."""
    models: Mapping[str, Model]
    """What the things are."""
    starts: Mapping[str, Array] = field(default_factory=dict)
    """(4, 4) of each thing as the episode began."""
    fixed: frozenset[str] = frozenset()
    """Things that cannot be moved, beside the first bodies of articulations."""
    avoided: frozenset[str] = frozenset()
    """Things that must not be touched."""

    def site(self, name: str, site: str) -> Array:
        """Pose (4, 4) of a site of the thing `name`."""
        where = self.models[name].sites[site]
        body = name if where.body == self.models[name].bodies[0].name else f"{name}/{where.body}"
        return np.asarray(self.poses[body] @ where.X_BodyS)

    def size(self, name: str, measure: str) -> float:
        """A measure of the thing `name` [m or rad]."""
        return self.models[name].size[measure]


class Task(ABC):
    """A manipulation task. Subclasses document Description, Randomizations and Success."""

    card: TaskCard
    slots: ClassVar[Mapping[str, str]]
    """Kind of asset that an episode draws for each slot."""

    def slots_of(self, variant: TaskVariant) -> Mapping[str, str]:
        """Slots of a variant; those of the task unless a task says otherwise."""
        return self.slots

    @abstractmethod
    def layout(self, models: Mapping[str, Model], rng: np.random.Generator, variant: TaskVariant) -> SceneLayout:
        """The scene to begin with.

        Args:
            models: the asset drawn for each slot.
            rng: the episode's generator for everything else.
            variant: version of the scene.
        """

    @abstractmethod
    def conditions(self, state: "State") -> "dict[str, Tensor]":
        """Named sub-conditions (N,) bool of N scenes; success is all of them together."""

    @abstractmethod
    def progress(self, state: "State") -> "Tensor":
        """How far (N,) the scenes have come, 0 as they began, 1 done; it may leave 0..1, the environment clips it."""
