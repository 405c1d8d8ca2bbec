"""Lens of a camera as unknowns of a fit, and pose of known points by perspective-n-point."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.geometry import Array, invert, make_pose, rotation_exp, transform_points

UNKNOWNS = 9
"""Number of unknowns: rotation about the camera axes [rad], translation [m], logarithm of the focal length, principal
point [px]."""
USUAL_FOV_DEG = 55.0
"""Field of view along the longer side of a camera of which nothing is known [degrees]."""
_SENSORS = (4 / 3, 16 / 9)
"""Shapes of the pictures of usual sensors, width over height: others may have been stretched."""
_SAME_SHAPE = 0.01
"""Relative difference within which two shapes are the same."""
_SHOULDER_M = 0.333
"""Height of the shoulder above the base [m]."""
_CONSENSUS_PX = 6.0
"""Largest error of an inlier [px of an image 384 px wide]."""
_SAME_RAD = np.deg2rad(3.0)
"""Angle between the axes of joint 1 within which two cameras see the same arm [rad]."""
_SAME_SHARE = 0.03
"""Distance between the shoulders, over that from the camera, within which they do."""
_SAME_ZOOM = 0.05
"""Logarithm of the ratio of focal lengths within which they do."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lens:
    """Camera as unknowns of a fit: intrinsics, and the pose of the robot base in the frame of the camera.

    The steps of a fit turn and move the base as the camera shows it, so its pose is kept instead of `Camera.X_BC`.
    """

    intrinsics: Camera
    """Size, focal lengths and principal point; the pose of this camera is ignored."""
    X_CB: Array
    """(4, 4) pose of the base in the camera frame [m]."""

    @classmethod
    def of_camera(cls, camera: Camera) -> "Lens":
        """Return the lens of a camera of known pose."""
        return cls(intrinsics=camera, X_CB=invert(camera.X_BC))

    def displace(self, step: Array) -> "Lens":
        """Return the lens after a step (9,) of the unknowns; the base turns about the axes of C."""
        X_CB = make_pose(rotation_exp(step[:3]) @ self.X_CB[:3, :3], self.X_CB[:3, 3] + step[3:6])
        own = self.intrinsics
        zoom = float(np.exp(step[6]))
        displaced = replace(
            own,
            fx=own.fx * zoom,
            fy=own.fy * zoom,
            cx=own.cx + float(step[7]),
            cy=own.cy + float(step[8]),
        )
        return Lens(intrinsics=displaced, X_CB=X_CB)

    def to_camera(self) -> Camera:
        """Return the camera with its pose."""
        return replace(self.intrinsics, X_BC=invert(self.X_CB))

    def project(self, p_B: Array) -> tuple[Array, Array]:
        """Project points (N, 3) in B to pixels (N, 2) and depths (N,) [m], points behind the camera included."""
        p_C = transform_points(self.X_CB, p_B)
        z = np.where(np.abs(p_C[:, 2]) < 1e-3, 1e-3, p_C[:, 2])
        own = self.intrinsics
        return np.asarray(p_C[:, :2] / z[:, None] * [own.fx, own.fy] + [own.cx, own.cy]), z

    def derivatives(self, p_B: Array) -> tuple[Array, Array]:
        """Return the derivatives of the pixels of points (N, 3) by the unknowns (N, 2, 9) and by p_C (N, 2, 3)."""
        offset = p_B @ self.X_CB[:3, :3].T
        x, y, z = (offset + self.X_CB[:3, 3]).T
        fx = self.intrinsics.fx
        fy = self.intrinsics.fy
        zero = np.zeros_like(z)
        by_C = np.stack(
            [np.stack([fx / z, zero, -fx * x / z**2], axis=-1), np.stack([zero, fy / z, -fy * y / z**2], axis=-1)],
            axis=1,
        )
        J = np.empty((len(z), 2, UNKNOWNS))
        J[:, :, :3] = np.cross(offset[:, None], by_C)  # d p_C / d w = -[offset]x
        J[:, :, 3:6] = by_C
        J[:, 0, 6] = fx * x / z
        J[:, 1, 6] = fy * y / z
        J[:, :, 7:] = np.eye(2)
        return J, by_C

    def position_sigma_m(self, covariance: Array) -> float:
        """Return the standard deviation of the camera's position in B: root of the sum over axes [m].

        `covariance` (6, 6) is that of the base's rotation about the axes of C [rad] and its position in C [m].
        """
        x, y, z = self.X_CB[:3, 3]
        by_turn = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])  # the camera's position is -R^T t
        J = np.concatenate([by_turn, np.eye(3)], axis=1)
        return float(np.trace(J @ covariance @ J.T) ** 0.5)

    def sees_same_arm(self, other: "Lens", factor: float) -> bool:
        """Return whether another camera sees the same axis of joint 1, whatever the turn about it.

        Tolerances are `factor` times 3 degrees, 3 % of the distance and 5 % of the focal length.
        """
        zoom = abs(float(np.log(self.intrinsics.fx / other.intrinsics.fx)))
        axis = self.X_CB[:3, 2]
        other_axis = other.X_CB[:3, 2]
        shoulder = self.X_CB[:3, 3] + _SHOULDER_M * axis
        other_shoulder = other.X_CB[:3, 3] + _SHOULDER_M * other_axis
        far = float(np.linalg.norm(shoulder - other_shoulder) / np.linalg.norm(shoulder))
        along = float(axis @ other_axis) >= np.cos(factor * _SAME_RAD)
        return along and zoom <= factor * _SAME_ZOOM and far <= factor * _SAME_SHARE


def solve_pnp(p: Array, uv_px: Array, camera: Camera, samples: int = 100) -> tuple[Array, int] | None:
    """Return the pose (4, 4) of points (N, 3) in the camera frame [m] and the number of inliers; None if there is none.

    Args:
        p: (N, 3) points [m].
        uv_px: (N, 2) their pixels.
        camera: intrinsics.
        samples: greatest number of samples of points of which the best consensus is taken.
    """
    error_px = _CONSENSUS_PX * camera.unit_px
    try:
        ok, rotation, translation, inliers = cv2.solvePnPRansac(
            p,
            uv_px,
            camera.K,
            None,
            flags=cv2.SOLVEPNP_SQPNP,
            reprojectionError=error_px,
            iterationsCount=samples,
        )
    except cv2.error:  # raised where the best sample has too few inliers
        return None
    if not ok or inliers is None or not (np.isfinite(rotation).all() and np.isfinite(translation).all()):
        return None
    return make_pose(rotation_exp(rotation.ravel()), translation.ravel()), len(inliers)


def focal_px(side_px: int, fov_deg: float) -> float:
    """Return the focal length [px] with which a field of view [degrees] fills a side of an image."""
    return side_px / 2 / float(np.tan(np.deg2rad(fov_deg) / 2))


def with_focal(camera: Camera, fx: float) -> Camera:
    """Return the camera with another focal length along x [px] and the same pixel aspect ratio."""
    return replace(camera, fx=fx, fy=camera.fy * fx / camera.fx)


def centred_camera(width: int, height: int, focal: float) -> Camera:
    """Return a camera with its principal point in the middle, at the place of the benchmark camera."""
    return replace(benchmark_camera(), width=width, height=height, fx=focal, fy=focal, cx=width / 2, cy=height / 2)


def pixel_shapes(width: int, height: int) -> tuple[float, ...]:
    """Return the ratios fy / fx that a picture of this size may have, the likeliest first.

    They are 1, and those that undo the stretching of the picture of a usual sensor, the least stretching first.
    """
    shape = width / height
    if any(abs(shape / sensor - 1.0) <= _SAME_SHAPE for sensor in _SENSORS):
        return (1.0,)
    stretched = sorted((sensor / shape for sensor in _SENSORS), key=lambda ratio: abs(np.log(ratio)))
    return (stretched[0], 1.0, stretched[1])
