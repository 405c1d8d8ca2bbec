"""Points of asset bodies and states of scenes, for tests of assets and conditions."""

from collections.abc import Sequence

import numpy as np
import torch

from kinebench_drake.geometry import Array, transform_points
from kinebench_drake.suites.composition import Episode
from kinebench_drake.suites.scene.model import Collider, ColliderKind, RigidBody
from kinebench_drake.suites.scene.state import ARM, State


def visual_points(body: RigidBody) -> Array:
    """Return all vertices (N, 3) of a body's visuals in its frame."""
    return np.concatenate([transform_points(v.X_BodyV, v.mesh.vertices) for v in body.visuals])


def collider_points(collider: Collider) -> Array:
    """Return the corners (N, 3) of a collider's bounding box, or its points if it is a hull, in the body's frame."""
    if collider.points is not None:
        return transform_points(collider.X_BodyC, collider.points)
    if collider.kind is ColliderKind.BOX:
        half = np.array(collider.size)
    elif collider.kind is ColliderKind.SPHERE:
        half = np.full(3, collider.size[0])
    else:
        radius, length = collider.size
        half = np.array([length + (radius if collider.kind is ColliderKind.CAPSULE else 0.0), radius, radius])
    corners = half * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return transform_points(collider.X_BodyC, corners)


def solid_points(body: RigidBody) -> Array:
    """Return the points (N, 3) of all colliders of a body in its frame."""
    return np.concatenate([collider_points(collider) for collider in body.colliders])


def initial_state(episodes: Sequence[Episode]) -> State:
    """Return the state in which the episodes begin, everything at rest, the TCP at B."""
    scenes = [episode.layout().scene(np.eye(4)) for episode in episodes]
    n = len(scenes)
    names = list(scenes[0].models)
    poses = {
        name: torch.tensor(np.stack([s.poses[name] for s in scenes]), dtype=torch.float32) for name in scenes[0].poses
    }
    joints = {name: torch.tensor([s.joints[name] for s in scenes]) for name in scenes[0].joints}
    return State(
        X_BG=torch.eye(4).repeat(n, 1, 1),
        finger_width_m=torch.full((n,), 0.08),
        poses=poses,
        starts=poses,
        joints=joints,
        joint_starts=joints,
        speeds={name: torch.zeros(n) for name in (*names, ARM)},
        models={name: [s.models[name] for s in scenes] for name in names},
        grasps=lambda name: torch.zeros(n, dtype=torch.bool),
    )
