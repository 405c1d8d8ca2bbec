"""State of N scenes as tensors, from which success conditions are computed."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from kinebench_drake.suites.scene.model import AssetModel

STILL_M_S = 0.02
STILL_RAD_S = 0.05
"""Speeds up to which objects and drawers, or lids and handles, count as at rest."""
CLEAR_M = 0.03
"""Least distance of the TCP from the part it moved for that part to count as released."""
CALM_RAD_S = 0.2
"""Speed of the fastest joint up to which the arm counts as at rest, so that a flailing arm does not succeed."""
MOVED_M = 0.02
"""Greatest horizontal displacement of an obstacle."""
ARM = "arm"
"""Key of the arm in `State.speeds`."""
TILT_RAD = float(np.deg2rad(10.0))
"""Greatest tilt of an obstacle's z axis from the vertical."""


def to_frame(X: Tensor, p: Tensor) -> Tensor:
    """Return points (N, 3) of B expressed in frames with poses (N, 4, 4) [m]."""
    return torch.einsum("nji,nj->ni", X[:, :3, :3], p - X[:, :3, 3])


@dataclass(frozen=True, slots=True, kw_only=True)
class State:
    """N scenes at one moment; poses in each scene's robot base frame B [m]."""

    X_BG: Tensor
    """(N, 4, 4) pose of panda_hand_tcp."""
    finger_width_m: Tensor
    """(N,) gap between the finger pads."""
    poses: Mapping[str, Tensor]
    """(N, 4, 4) pose of each object and of each further body of an articulation, as "box/lid"."""
    starts: Mapping[str, Tensor]
    """`poses` at the beginning of the episodes."""
    joints: Mapping[str, Tensor]
    """(N,) joint position of each articulated object [rad or m]."""
    joint_starts: Mapping[str, Tensor]
    """`joints` at the beginning of the episodes."""
    speeds: Mapping[str, Tensor]
    """(N,) speed of each free object [m/s], of the joint of each articulated object [rad/s or m/s], and of the arm's
    fastest joint under `ARM` [rad/s]."""
    models: Mapping[str, Sequence[AssetModel]]
    """N assets of each object."""
    grasps: Callable[[str], Tensor]
    """Returns (N,) bool: True where the gripper holds the named object between its fingers."""

    def position(self, name: str) -> Tensor:
        """Return the position (N, 3) of an object [m]."""
        return self.poses[name][:, :3, 3]

    def displacement(self, name: str) -> Tensor:
        """Return how far (N, 3) an object has moved since the episode began [m]."""
        return self.position(name) - self.starts[name][:, :3, 3]

    def size(self, name: str, measure: str) -> Tensor:
        """Return a dimension (N,) of an object."""
        values = [model.size[measure] for model in self.models[name]]
        return torch.tensor(values, dtype=torch.float32, device=self.X_BG.device)

    def site(self, name: str, site: str) -> Tensor:
        """Return the pose (N, 4, 4) of a site of an object."""
        models = self.models[name]
        frames = [model.sites[site] for model in models]
        body = name if frames[0].body == models[0].bodies[0].name else f"{name}/{frames[0].body}"
        offsets = torch.stack([torch.as_tensor(frame.X_BodyS, dtype=torch.float32) for frame in frames])
        return self.poses[body] @ offsets.to(self.X_BG.device)

    def joint_progress(self, name: str, goal: Tensor | float) -> Tensor:
        """Return the fraction (N,) of the way to the joint position `goal` (N,) covered since the episode began."""
        start = self.joint_starts[name]
        way = goal - start
        return (self.joints[name] - start) / torch.where(way.abs() < 1e-6, 1e-6, way)

    def distance_progress(self, name: str, goal: Tensor) -> Tensor:
        """Return the fraction (N,) of the distance from an object to `goal` (N, 3) [m] covered since the start."""
        before = torch.linalg.norm(self.starts[name][:, :3, 3] - goal, dim=-1)
        left: Tensor = torch.linalg.norm(self.position(name) - goal, dim=-1) / before.clamp(min=1e-6)
        return 1.0 - left

    def release_conditions(self, name: str) -> dict[str, Tensor]:
        """Return conditions (N,) that a free object is at rest and not grasped."""
        return {"still": self.speeds[name] <= STILL_M_S, "released": ~self.grasps(name)}

    def rest_conditions(self, name: str, distance: Tensor, still: float = STILL_RAD_S) -> dict[str, Tensor]:
        """Return conditions (N,) that an articulated object and the arm are at rest and apart.

        Args:
            distance: distance (N,) of the TCP from the part that it moved [m].
            still: greatest speed of the joint [rad/s or m/s].
        """
        return {
            "still": self.speeds[name] <= still,
            "calm": self.speeds[ARM] <= CALM_RAD_S,
            "released": distance >= CLEAR_M,
        }

    def obstacle_conditions(self) -> dict[str, Tensor]:
        """Return conditions (N,) that the obstacle stands upright and in its place; none without an obstacle."""
        if "obstacle" not in self.poses:
            return {}
        return {
            "obstacle_upright": self.poses["obstacle"][:, 2, 2] >= float(np.cos(TILT_RAD)),
            "obstacle_in_place": torch.linalg.norm(self.displacement("obstacle")[:, :2], dim=-1) <= MOVED_M,
        }
