"""Views of the gripper rendered from the CAD model: estimates of a perfect network."""

import numpy as np

from kinebench_drake.geometry import Array, invert, make_pose, rotation_exp, transform_points
from kinebench_drake.grounding.registration.fit import fit
from kinebench_drake.grounding.tracking.pose import FramePose
from kinebench_drake.grounding.tracking.view import Crop, GripperView
from kinebench_drake.models.panda.cad import GripperCad
from kinebench_drake.models.panda.description import RobotPart


def hand_pose(seed: int) -> Array:
    """A gripper 0.5 to 0.8 m before the camera, seen from the side of its fingers."""
    rng = np.random.default_rng(seed)
    down = rotation_exp([np.pi / 2, 0, 0]) @ rotation_exp([0, 0, rng.uniform(-0.8, 0.8)])
    R = rotation_exp(rng.normal(0, 0.25, 3)) @ np.diag([1.0, -1.0, -1.0]) @ down
    return make_pose(R, [*rng.uniform(-0.15, 0.15, 2), rng.uniform(0.5, 0.8)])


def perfect_view(
    cad: GripperCad,
    X_CH: Array,
    finger_m: float = 0.02,
    *,
    crop: Crop | None = None,
    noise_m: float = 0.0,
    depth_factor: float = 1.0,
    seed: int = 0,
) -> GripperView:
    """The view of a gripper with coordinates noisy by `noise_m` and depth off by a common factor."""
    rng = np.random.default_rng(seed)
    crop = crop or Crop.of_gripper(X_CH, 1.3, 128)
    X_VH = invert(crop.X_CV) @ X_CH
    rays = crop.rays(2)
    surface = cad.cast(X_VH, rays.reshape(-1, 3), finger_m)
    part = surface.part.reshape(rays.shape[:2])
    z = np.where(np.isfinite(surface.distance), surface.distance, 1.0).reshape(part.shape)
    p_H = transform_points(invert(X_VH), (rays * z[..., None]).reshape(-1, 3)).reshape(rays.shape)
    p_H[..., 1] -= finger_m * ((part == RobotPart.LEFT_FINGER).astype(float) - (part == RobotPart.RIGHT_FINGER))
    return GripperView(
        crop=crop,
        stride=2,
        in_image=np.ones(part.shape, dtype=bool),
        part=part,
        depth_m=z * depth_factor,
        depth_sigma=np.full(part.shape, 0.01),
        depth_factor_sigma=0.012,
        coordinates_P=p_H + rng.normal(0, noise_m, p_H.shape),
        coordinates_sigma_m=np.full(part.shape, max(noise_m, 1e-3)),
    )


def fitted_pose(view: GripperView) -> FramePose:
    """The pose of a frame whose hand is fitted to `view`, without an arm."""
    hand = fit(view)
    assert hand is not None
    return FramePose(
        X_CH=hand.X_CH,
        finger_m=0.02,
        finger_sigma_m=1e-3,
        hand=hand,
        hand_without_silhouette=hand,
        arm=None,
        view=view,
        overlap=0.95,
    )
