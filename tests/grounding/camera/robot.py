"""Synthetic views of a robot: points of its parts projected by a known camera."""

from dataclasses import dataclass

import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert, transform_points
from kinebench_drake.grounding.camera.bundle_adjustment import ArmScene, BundleAdjustment
from kinebench_drake.grounding.camera.camera_estimate import CameraEstimate
from kinebench_drake.grounding.camera.detections import ArmDetections, CalibrationCorrespondences
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.models.panda.description import OPENING_SIGN, RobotPart, rest_q

VISIBLE = (
    RobotPart.HAND,
    RobotPart.LEFT_FINGER,
    RobotPart.RIGHT_FINGER,
    RobotPart.LINK0,
    RobotPart.LINK2,
    RobotPart.LINK4,
    RobotPart.LINK6,
    RobotPart.LINK7,
)


def postures(frames: int, *, reach: float = 0.25, seed: int = 0) -> Array:
    """Postures (T, 7) around the one in which ManiSkill's robot rests [rad]."""
    return rest_q() + np.random.default_rng(seed).uniform(-reach, reach, (frames, 7))


def project_robot(
    camera: Camera,
    q: Array,
    model: ArmModel,
    *,
    parts: tuple[RobotPart, ...] = VISIBLE,
    finger_m: float = 0.01,
    noise_px: float = 0.0,
    cells: int = 12,
) -> CalibrationCorrespondences:
    """Project the robot by `camera` at postures `q` (T, 7), `cells` points of each part in each frame."""
    rng = np.random.default_rng(1)
    n = len(q) * len(parts) * cells
    part = np.tile(np.repeat(np.array(parts, np.uint8), cells), len(q))
    observed = CalibrationCorrespondences(
        frame=np.repeat(np.arange(len(q)), len(parts) * cells),
        uv_px=np.zeros((n, 2)),
        part=part,
        p_P=rng.uniform(-0.06, 0.06, (n, 3)),
        sigma_m=np.full(n, 0.003),
        depth_per_px=np.full(n, np.nan),
        opening_sign=np.array([OPENING_SIGN.get(RobotPart(p), 0.0) for p in part]),
        weight=np.full(n, 8.0 / cells),
    )
    p_B = observed.locate(model.poses(q), np.full(len(q), finger_m))
    p_C = transform_points(invert(camera.X_BC), p_B)
    uv = camera.project(p_C)
    observed.depth_per_px[:] = p_C[:, 2] / camera.fx
    observed.uv_px[:] = uv + rng.normal(0.0, noise_px, uv.shape) if noise_px else uv
    return observed


@dataclass
class PerfectEstimator:
    """View estimator that returns the projection by a fixed camera, whatever camera it gets."""

    camera: Camera
    q: Array
    model: ArmModel
    noise_px: float = 0.0

    def estimate(self, frames, camera):
        cells = project_robot(self.camera, self.q[frames[:, 0, 0, 0]], self.model, noise_px=self.noise_px)
        T = len(frames)
        return ArmDetections(
            rows=np.arange(T),
            cells=cells,
            finger_m=np.full(T, 0.01),
            q=self.q[frames[:, 0, 0, 0]],
            robot=np.zeros(frames.shape[1:3], dtype=bool),
        )


def certain_bundle(scene: ArmScene) -> BundleAdjustment:
    """Result of a fit without errors."""
    return BundleAdjustment(
        scene=scene,
        cost=0.0,
        error_px=np.zeros(len(VISIBLE)),
        information=1e8 * np.eye(9),
        response=np.zeros((len(scene.q), 7, 9)),
    )


class CellsAlone:
    """Takes the camera that was fitted to cells as the one that fits the contours."""

    def refine(self, frames, camera, start, *, focal_free, centre_sigma_px):
        return CameraEstimate(
            bundle=certain_bundle(start.scene),
            frames=start.rows,
            part=np.array(VISIBLE, np.uint8),
            gripper_sigma_m=1e-4,
            gripper_sigma_rad=1e-4,
            agreement=1.0,
            base_agreement=1.0,
            residual_px=0.0,
        )
