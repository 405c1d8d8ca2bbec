"""A pinhole that can be moved and zoomed: what a calibration looks for."""

from dataclasses import dataclass, replace

import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert, make_pose, rotation_exp, transform_points

UNKNOWNS = 7
"""Rotation about the camera's axes [rad], shift [m] and the logarithm of the focal length."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lens:
    """A camera by the pose of the robot's base in it."""

    camera: Camera
    """Intrinsics; its pose is not read."""
    X_CB: Array
    """(4, 4) pose of the base in the camera frame [m]."""

    def moved(self, step: Array) -> "Lens":
        """The lens after a change (7,): the base turned about the axes of C and shifted, then the zoom."""
        X_CB = make_pose(rotation_exp(step[:3]) @ self.X_CB[:3, :3], self.X_CB[:3, 3] + step[3:6])
        zoom = float(np.exp(step[6]))
        camera = replace(self.camera, fx=self.camera.fx * zoom, fy=self.camera.fy * zoom)
        return Lens(camera=camera, X_CB=X_CB)

    def placed(self) -> Camera:
        """The camera with its pose."""
        return replace(self.camera, X_BC=invert(self.X_CB))

    def project(self, p_B: Array) -> tuple[Array, Array]:
        """Pixels (N, 2) and depths (N,) [m] of points (N, 3) of B; behind the camera they are where they would be."""
        p_C = transform_points(self.X_CB, p_B)
        z = np.where(np.abs(p_C[:, 2]) < 1e-3, 1e-3, p_C[:, 2])
        f, c = [self.camera.fx, self.camera.fy], [self.camera.cx, self.camera.cy]
        return np.asarray(p_C[:, :2] / z[:, None] * f + c), z

    def derivatives(self, p_B: Array) -> tuple[Array, Array]:
        """Of the pixels of points (N, 3): by the unknowns (N, 2, 7), and by the point's place in C (N, 2, 3)."""
        offset = p_B @ self.X_CB[:3, :3].T
        x, y, z = (offset + self.X_CB[:3, 3]).T
        fx, fy = self.camera.fx, self.camera.fy
        zero = np.zeros_like(z)
        by_C = np.stack(
            [
                np.stack([fx / z, zero, -fx * x / z**2], axis=-1),
                np.stack([zero, fy / z, -fy * y / z**2], axis=-1),
            ],
            axis=1,
        )
        J = np.empty((len(z), 2, UNKNOWNS))
        J[:, :, :3] = np.cross(offset[:, None], by_C)  # d p_C / d w = -[offset]x
        J[:, :, 3:6] = by_C
        J[:, 0, 6], J[:, 1, 6] = fx * x / z, fy * y / z
        return J, by_C
