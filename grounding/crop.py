"""Square crops around the gripper, seen by a virtual camera that looks straight at it.

A virtual camera V shares the real camera's centre, so warping the image by a homography shows exactly what a camera
turned towards the gripper would see: the network then meets the same view wherever in the frame the gripper is.
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
WIDE_SIZE = 192
"""Width of the view of the whole frame that finds the gripper [px]."""
CLOSE_SIZE = 128
"""Width of the close view [px]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Crop:
    """A square virtual view."""

    R_CV: Array
    """(3, 3) axes of the virtual camera in the real camera's frame."""
    focal: float
    """Focal length of the virtual camera [px]."""
    size: int
    """Width and height [px]; the principal point is the centre."""

    @property
    def X_CV(self) -> Array:
        """(4, 4) pose of the virtual camera in the real camera's frame: a pure rotation."""
        return make_pose(self.R_CV, np.zeros(3))

    @classmethod
    def towards(cls, direction_C: ArrayLike, half_tangent: float, size: int, roll: float = 0.0) -> "Crop":
        """A view along `direction_C` (3,) whose half width subtends `half_tangent`, rolled about its axis [rad].

        Without roll the view is turned the shortest way from the real camera, so upright stays upright.
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
        """A view of the gripper at pose `X_CH` (4, 4): its bounding sphere times `margin` fills the crop."""
        centre = transform_points(X_CH, GRIPPER_CENTRE_H[None])[0]
        return cls.towards(centre, margin * GRIPPER_RADIUS_M / float(np.linalg.norm(centre)), size)

    def homography(self, camera: Camera, stride: int = 1) -> Array:
        """Matrix (3, 3) from pixels of the crop (every `stride`-th) to pixels of the frame, half-integer centres."""
        f, c = self.focal / stride, self.size / stride / 2
        K_V_inverse = np.array([[1 / f, 0.0, -c / f], [0.0, 1 / f, -c / f], [0.0, 0.0, 1.0]])
        return np.asarray(camera.K @ self.R_CV @ K_V_inverse)

    def warp(
        self, image: NDArray[np.generic], camera: Camera, stride: int = 1, nearest: bool = False
    ) -> NDArray[np.generic]:
        """The crop of an image (H, W[, 3]) of `camera`; what lies outside the frame is 0."""
        M = _in_opencv(self.homography(camera, stride))
        n = self.size // stride
        flags = (cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR) | cv2.WARP_INVERSE_MAP
        return np.asarray(cv2.warpPerspective(image, M, (n, n), flags=flags))

    def unwarp(self, cells: NDArray[np.uint8], camera: Camera, stride: int = 1) -> NDArray[np.uint8]:
        """An image (H, W) of `camera` from labels (n, n) of every `stride`-th pixel of the crop; 0 elsewhere."""
        M = _in_opencv(self.homography(camera, stride))
        return np.asarray(cv2.warpPerspective(cells, M, (camera.width, camera.height), flags=cv2.INTER_NEAREST))

    def shown(self, camera: Camera, stride: int = 1) -> NDArray[np.bool_]:
        """Which of every `stride`-th pixel (n, n) lie within the frames of `camera`."""
        return self.warp(np.ones((camera.height, camera.width), np.uint8), camera, stride, nearest=True).astype(bool)

    def rays(self, stride: int = 1) -> Array:
        """Directions (n, n, 3) in V through the centres of every `stride`-th pixel, scaled so that z = 1."""
        n = self.size // stride
        u = ((np.arange(n) + 0.5) * stride - self.size / 2) / self.focal
        grid = np.ones((n, n, 3))
        grid[..., 0], grid[..., 1] = np.meshgrid(u, u)
        return grid


def _in_opencv(M: Array) -> Array:
    """A homography between pixels with half-integer centres for OpenCV, whose centres are integers."""
    shift = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
    return np.asarray(np.linalg.inv(shift) @ M @ shift)
