"""Square crops around the gripper: images of a virtual camera whose optical axis points at the gripper.

The virtual camera V shares the real camera's centre, so a homography of the image gives exactly the image of a camera
rotated towards the gripper. The network's input then does not depend on where in the image the gripper is.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, make_pose, rotation_exp, transform_points

GRIPPER_CENTRE_H = np.array([0.0, 0.0, 0.045])
"""Centre of the gripper's bounding sphere in panda_hand [m]."""
GRIPPER_RADIUS_M = 0.115
"""Radius of that sphere [m]."""
WRIST_CENTRE_H = np.array([0.044, 0.0, -0.15])
WRIST_RADIUS_M = 0.17
"""The same for the last links."""
WIDE_SIZE = 192
"""Width of the crop that holds the whole image, for detection [px]."""
CLOSE_SIZE = 128
"""Width of the crop around the gripper, for pose estimation [px]."""
CLOSE_MARGIN = 1.3
"""Half width of that crop over the gripper's radius."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Crop:
    """Square image of a virtual camera V."""

    R_CV: Array
    """(3, 3) rotation of V in the camera frame."""
    focal: float
    """Focal length of V [px]."""
    size: int
    """Width and height [px]; the principal point is at the centre."""

    @property
    def X_CV(self) -> Array:
        """(4, 4) pose of V in the camera frame: a pure rotation."""
        return make_pose(self.R_CV, np.zeros(3))

    @classmethod
    def towards(cls, direction_C: ArrayLike, half_tangent: float, size: int, roll: float = 0.0) -> "Crop":
        """Return the crop along `direction_C` (3,) in the camera frame, of half the field of view by its tangent.

        `roll` is the rotation about the optical axis [rad]; at 0, V is the camera rotated by the smallest angle.
        """
        z = np.asarray(direction_C, dtype=np.float64)
        z = z / np.linalg.norm(z)
        axis = np.cross([0.0, 0.0, 1.0], z)
        sine = np.linalg.norm(axis)
        turn = axis / sine * np.arctan2(sine, z[2]) if sine > 1e-12 else np.zeros(3)
        R_CV = rotation_exp(turn) @ rotation_exp([0.0, 0.0, roll])
        return cls(R_CV=R_CV, focal=size / 2 / half_tangent, size=size)

    @classmethod
    def of_gripper(cls, X_CH: ArrayLike, margin: float, size: int) -> "Crop":
        """Return the crop filled by the bounding sphere, times `margin`, of a gripper at `X_CH` (4, 4)."""
        centre = transform_points(X_CH, GRIPPER_CENTRE_H[None])[0]
        return cls.towards(centre, margin * GRIPPER_RADIUS_M / float(np.linalg.norm(centre)), size)

    @classmethod
    def of_frame(cls, camera: Camera) -> "Crop":
        """Return the crop that holds the whole image of `camera`."""
        half = np.array([camera.width / 2, camera.height / 2])
        direction = np.array([(half[0] - camera.cx) / camera.fx, (half[1] - camera.cy) / camera.fy, 1.0])
        return cls.towards(direction, float(max(half / [camera.fx, camera.fy])), WIDE_SIZE)

    def homography(self, camera: Camera, stride: int = 1) -> Array:
        """Return the (3, 3) homography from cells of the crop to pixels of `camera`, centres at half-integers."""
        f = self.focal / stride
        c = self.size / stride / 2
        K_V_inverse = np.array([[1 / f, 0.0, -c / f], [0.0, 1 / f, -c / f], [0.0, 0.0, 1.0]])
        return np.asarray(camera.K @ self.R_CV @ K_V_inverse)

    def warp(
        self, image: NDArray[np.generic], camera: Camera, stride: int = 1, nearest: bool = False
    ) -> NDArray[np.generic]:
        """Return the crop (n, n[, 3]) of an image (H, W[, 3]) of `camera`; 0 outside the image."""
        M = _opencv_homography(self.homography(camera, stride))
        n = self.size // stride
        flags = (cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR) | cv2.WARP_INVERSE_MAP
        return np.asarray(cv2.warpPerspective(image, M, (n, n), flags=flags))

    def unwarp(self, cells: NDArray[np.uint8], camera: Camera, stride: int = 1) -> NDArray[np.uint8]:
        """Return the labels (n, n) of cells as an image (H, W) of `camera`; 0 outside the crop."""
        M = _opencv_homography(self.homography(camera, stride))
        return np.asarray(cv2.warpPerspective(cells, M, (camera.width, camera.height), flags=cv2.INTER_NEAREST))

    def in_image(self, camera: Camera, stride: int = 1) -> NDArray[np.bool_]:
        """Return the cells (n, n) that lie inside the image of `camera`."""
        return self.warp(np.ones((camera.height, camera.width), np.uint8), camera, stride, nearest=True).astype(bool)

    def rays(self, stride: int = 1) -> Array:
        """Return the directions (n, n, 3) in V through the centres of the cells, scaled to z = 1."""
        n = self.size // stride
        u = ((np.arange(n) + 0.5) * stride - self.size / 2) / self.focal
        grid = np.ones((n, n, 3))
        grid[..., 0], grid[..., 1] = np.meshgrid(u, u)
        return grid


def _opencv_homography(M: Array) -> Array:
    """Convert a homography from half-integer pixel centres to OpenCV's integer ones."""
    shift = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
    return np.asarray(np.linalg.inv(shift) @ M @ shift)
