"""A robot in view of the benchmark's camera: dense estimates and images of it, from the CAD models of all its parts."""

import numpy as np
import trimesh
from numpy.typing import NDArray

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.geometry import Array, invert, transform_points
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.tracking.view import CLOSE_SIZE, Crop, GripperView
from kinebench_drake.models.gripper import GripperModel
from kinebench_drake.models.panda.cad import PartCaster, franka_hand, link_meshes
from kinebench_drake.models.panda.description import RobotPart

CAMERA = benchmark_camera()
FINGER_M = 0.025


def posture(seed: int) -> Array:
    """A posture with the gripper in the middle of the image, pointing down."""
    rng = np.random.default_rng(seed)
    return np.array([0.0, 0.1, 0.0, -2.2, 0.0, 2.3, np.pi / 4]) + rng.normal(0, 0.12, 7)


def view(model: ArmModel, q: Array, crop: Crop, *, noise_m: float, depth_factor: float, seed: int) -> GripperView:
    """Dense estimates with coordinate noise `noise_m` and depth off by a common factor."""
    rng = np.random.default_rng(seed)
    gripper = model.gripper
    X_VB = gripper.open(invert(crop.X_CV) @ invert(CAMERA.X_BC) @ model.poses(q[None])[0], FINGER_M)
    n = crop.size // 2
    part = np.zeros((n, n), np.uint8)
    depth = np.full((n, n), np.inf)
    coordinates = np.zeros((n, n, 3))
    for body, mesh in {**gripper.meshes, **link_meshes()}.items():
        points = np.asarray(trimesh.sample.sample_surface(mesh, 6000, seed=seed)[0])
        p_V = transform_points(X_VB[body], points)
        p_P = gripper.in_parts(np.full(len(points), body), points, p_V, X_VB)
        u, v = np.floor(p_V[:, :2] / p_V[:, 2:] * crop.focal / 2 + n / 2).astype(int).T
        for i in np.flatnonzero((p_V[:, 2] > 0.1) & (u >= 0) & (u < n) & (v >= 0) & (v < n)):
            if p_V[i, 2] < depth[v[i], u[i]]:
                depth[v[i], u[i]] = p_V[i, 2]
                part[v[i], u[i]] = gripper.part_of[body]
                coordinates[v[i], u[i]] = p_P[i]
    return GripperView(
        crop=crop,
        stride=2,
        in_image=np.ones((n, n), dtype=bool),
        part=part,
        depth_m=np.where(np.isfinite(depth), depth, 1.0) * depth_factor,
        depth_sigma=np.full((n, n), 0.01),
        depth_factor_sigma=0.012,
        coordinates_P=coordinates + rng.normal(0, noise_m, coordinates.shape),
        coordinates_sigma_m=np.full((n, n), max(noise_m, 1e-3)),
    )


def views(model: ArmModel, q: Array, seed: int) -> tuple[Array, GripperView, GripperView]:
    """Pose of the hand, close and wide view of a posture, depth 3 % too large."""
    X_CH = invert(CAMERA.X_BC) @ model.poses(q[None])[0, RobotPart.HAND]
    crops = Crop.of_gripper(X_CH, 1.3, CLOSE_SIZE), Crop.of_frame(CAMERA)
    close, wide = (view(model, q, crop, noise_m=0.003, depth_factor=1.03, seed=seed) for crop in crops)
    return X_CH, close, wide


def drawn(model: ArmModel, q: Array, gripper: GripperModel | None = None, stains: float = 0.0) -> NDArray[np.uint8]:
    """An image of the robot in one grey, before a darker one; with another gripper, or stains of that contrast."""
    gripper = gripper or franka_hand()
    X_CP = gripper.open(invert(CAMERA.X_BC) @ model.poses(q[None])[0], FINGER_M)
    hit = PartCaster(gripper, link_meshes()).cast(X_CP, CAMERA.rays().reshape(-1, 3))
    # A grey of its own for each part: contours between parts count as well.
    grey = np.where(hit.part > 0, 120.0 + 12.0 * hit.part, 50.0)
    shown = hit.part > 0
    p_C = (CAMERA.rays().reshape(-1, 3) * hit.distance[:, None])[shown]
    p_P = transform_points(invert(X_CP)[hit.part[shown]], p_C[:, None])[:, 0]
    grey[shown] += stains * np.sin(p_P @ np.random.default_rng(0).normal(0.0, 150.0, (3, 6))).mean(axis=1)
    return np.repeat(grey.clip(0, 255).astype(np.uint8).reshape(CAMERA.height, CAMERA.width, 1), 3, axis=2)
