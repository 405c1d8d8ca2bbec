"""N scenes at one moment as batches of tensors, for conditions of success; on the device of the simulation."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from kinebench_drake.suites.assets.model import Model

STILL_M_S, STILL_RAD_S = 0.02, 0.05
"""Things and drawers, or lids and handles, slower than this are at rest."""
CLEAR_M = 0.03
"""A gripper whose TCP is this far from what it moved has let go of it."""
CALM_RAD_S = 0.2
"""An arm whose every joint is slower than this is at rest."""
ARM = "arm"
"""The robot's arm, where speeds are named."""


@dataclass(frozen=True, slots=True, kw_only=True)
class State:
    """N scenes; poses are in each scene's robot base frame B [m]."""

    X_BG: Tensor
    """(N, 4, 4) panda_hand_tcp."""
    finger_width_m: Tensor
    """(N,) gap between the finger pads."""
    poses: Mapping[str, Tensor]
    """(N, 4, 4) of each thing; of an articulation each body's too, as "box/lid"."""
    starts: Mapping[str, Tensor]
    """(N, 4, 4) the same as the episodes began."""
    joints: Mapping[str, Tensor]
    """(N,) joint position of each articulated thing [rad or m]."""
    joint_starts: Mapping[str, Tensor]
    """(N,) the same as the episodes began."""
    speeds: Mapping[str, Tensor]
    """(N,) speed of each free thing [m/s] and, of articulated things, of the joint [rad/s or m/s]; of the arm's
    fastest joint as `ARM` [rad/s]."""
    models: Mapping[str, Sequence[Model]]
    """N models of each thing."""
    grasps: Callable[[str], Tensor]
    """Whether (N,) the gripper holds the thing of a name between its fingers."""

    def calm(self) -> Tensor:
        """Whether (N,) the arm is at rest: what a robot that thrashes about brings to pass does not count."""
        return self.speeds[ARM] <= CALM_RAD_S

    def position(self, name: str) -> Tensor:
        """(N, 3) where a thing is [m]."""
        return self.poses[name][:, :3, 3]

    def size(self, name: str, measure: str) -> Tensor:
        """(N,) a measure of a thing."""
        values = [model.size[measure] for model in self.models[name]]
        return torch.tensor(values, dtype=torch.float32, device=self.X_BG.device)

    def site(self, name: str, site: str) -> Tensor:
        """(N, 4, 4) pose of a site of a thing."""
        models = self.models[name]
        where = [model.sites[site] for model in models]
        body = name if where[0].body == models[0].bodies[0].name else f"{name}/{where[0].body}"
        offsets = torch.stack([torch.as_tensor(s.X_BodyS, dtype=torch.float32) for s in where])
        return self.poses[body] @ offsets.to(self.X_BG.device)

    def travelled(self, name: str, goal: Tensor) -> Tensor:
        """(N,) part of the way to `goal` (N,) that a joint has come since the episode began."""
        start = self.joint_starts[name]
        way = goal - start
        return (self.joints[name] - start) / torch.where(way.abs() < 1e-6, torch.full_like(way, 1e-6), way)

    def approached(self, name: str, goal: Tensor) -> Tensor:
        """(N,) part of the distance between a thing and `goal` (N, 3) [m] that is gone since the episode began."""
        before = torch.linalg.norm(self.starts[name][:, :3, 3] - goal, dim=-1)
        now = torch.linalg.norm(self.position(name) - goal, dim=-1)
        left: Tensor = now / before.clamp(min=1e-6)
        return 1.0 - left
