"""Rigid-body geometry on 4x4 homogeneous transforms, in NumPy.

`X_AB` is the pose of frame B in frame A (Drake's monogram notation): `p_A = X_AB @ p_B`. All functions accept a
leading batch shape `(..., 4, 4)` unless stated otherwise. Lengths in metres, angles in radians, quaternions wxyz.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from kinebench_drake.errors import InputError

Array = NDArray[np.float64]


def make_pose(R: ArrayLike, p: ArrayLike) -> Array:
    """Return poses (..., 4, 4) from rotation matrices `R` (..., 3, 3) and positions `p` (..., 3) [m]."""
    R = np.asarray(R, dtype=np.float64)
    p = np.asarray(p, dtype=np.float64)
    X = np.zeros((*np.broadcast_shapes(R.shape[:-2], p.shape[:-1]), 4, 4))
    X[..., :3, :3] = R
    X[..., :3, 3] = p
    X[..., 3, 3] = 1.0
    return X


def invert(X: ArrayLike) -> Array:
    """Invert rigid poses (..., 4, 4) in closed form."""
    X = np.asarray(X, dtype=np.float64)
    R_T = np.swapaxes(X[..., :3, :3], -1, -2)
    return make_pose(R_T, -(R_T @ X[..., :3, 3:])[..., 0])


def checked_pose(X: ArrayLike) -> Array:
    """Check an input pose (4, 4) and return it with an exactly orthonormal rotation.

    Raises:
        InputError: the pose is not finite, or not rigid.
    """
    X = np.asarray(X, dtype=np.float64)
    if X.shape != (4, 4) or not np.isfinite(X).all():
        raise InputError(f"must be a finite 4x4 matrix, found shape {X.shape}")
    R = X[:3, :3]
    error = float(np.abs(R @ R.T - np.eye(3)).max())
    det = float(np.linalg.det(R))
    if error > 1e-3 or det < 0 or not np.allclose(X[3], [0, 0, 0, 1], atol=1e-9):
        raise InputError(
            f"is not a rigid pose (rotation off by {error:.1e}, determinant {det:.3f}); expected a rotation, a "
            "position in metres and the last row 0 0 0 1"
        )
    return make_pose(orthonormalize(R), X[:3, 3])


def transform_points(X: ArrayLike, points: ArrayLike) -> Array:
    """Transform points (..., N, 3) [m] by poses `X` (..., 4, 4)."""
    X = np.asarray(X, dtype=np.float64)
    points = np.asarray(points, dtype=np.float64)
    return np.asarray(points @ np.swapaxes(X[..., :3, :3], -1, -2) + X[..., None, :3, 3])


def cross(a: Array, b: Array) -> Array:
    """Return the cross products (..., 3) of vectors (..., 3); several times as fast as `np.cross` for short arrays."""
    product = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        product[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return product


def rotation_angle(R: ArrayLike) -> Array:
    """Return the angle [rad] in [0, pi] of rotation matrices (..., 3, 3), accurate near 0 and near pi."""
    R = np.asarray(R, dtype=np.float64)
    skew = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1)
    return np.asarray(np.arctan2(np.linalg.norm(skew, axis=-1), np.trace(R, axis1=-2, axis2=-1) - 1.0))


def pose_difference(X_1: ArrayLike, X_2: ArrayLike) -> tuple[Array, Array]:
    """Return the distance [m] of the origins and the rotation angle [rad] between poses (..., 4, 4)."""
    X_1 = np.asarray(X_1, dtype=np.float64)
    X_2 = np.asarray(X_2, dtype=np.float64)
    distance = np.linalg.norm(X_1[..., :3, 3] - X_2[..., :3, 3], axis=-1)
    return distance, rotation_angle(np.swapaxes(X_1[..., :3, :3], -1, -2) @ X_2[..., :3, :3])


def orthonormalize(R: ArrayLike) -> Array:
    """Return the rotation matrices nearest to `R` (..., 3, 3) in Frobenius norm, by SVD (orthogonal Procrustes)."""
    U, _, V_T = np.linalg.svd(np.asarray(R, dtype=np.float64))
    U[..., :, 2] *= np.sign(np.linalg.det(U @ V_T))[..., None]
    return np.asarray(U @ V_T)


def rotation_exp(w: ArrayLike) -> Array:
    """Return the rotation matrices (..., 3, 3) of rotation vectors `w` (..., 3) [rad]."""
    w = np.asarray(w, dtype=np.float64)
    return np.asarray(Rotation.from_rotvec(w.reshape(-1, 3)).as_matrix().reshape(*w.shape[:-1], 3, 3))


def rotation_z(angle_rad: ArrayLike) -> Array:
    """Return the rotation matrices (..., 3, 3) about z by angles (...) [rad]."""
    R = np.zeros((*np.shape(angle_rad), 3, 3))
    R[..., 0, 0] = R[..., 1, 1] = np.cos(angle_rad)
    R[..., 1, 0] = np.sin(angle_rad)
    R[..., 0, 1] = -R[..., 1, 0]
    R[..., 2, 2] = 1.0
    return R


def rotation_log(R: ArrayLike) -> Array:
    """Return the rotation vectors (..., 3) [rad] of rotation matrices (..., 3, 3)."""
    R = np.asarray(R, dtype=np.float64)
    return np.asarray(Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec().reshape(*R.shape[:-2], 3))


def from_quaternion(quaternion: ArrayLike, p: ArrayLike) -> Array:
    """Return poses (..., 4, 4) from quaternions wxyz (..., 4), normalised here, and positions (..., 3) [m]."""
    quaternion = np.asarray(quaternion, dtype=np.float64)
    R = Rotation.from_quat(quaternion.reshape(-1, 4), scalar_first=True).as_matrix()
    return make_pose(R.reshape(*quaternion.shape[:-1], 3, 3), p)


def to_quaternion(R: ArrayLike) -> Array:
    """Return the quaternions wxyz (..., 4) with w >= 0 of rotation matrices (..., 3, 3)."""
    R = np.asarray(R, dtype=np.float64)
    quaternion = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_quat(canonical=True, scalar_first=True)
    return np.asarray(quaternion.reshape(*R.shape[:-2], 4))


def interpolate_pose(X_1: ArrayLike, X_2: ArrayLike, s: ArrayLike) -> Array:
    """Return the poses (..., 4, 4) at fractions `s` (...) from `X_1` (s = 0) to `X_2` (s = 1).

    The position moves along a straight line, the rotation the shortest way.
    """
    X_1 = np.asarray(X_1, dtype=np.float64)
    X_2 = np.asarray(X_2, dtype=np.float64)
    s = np.asarray(s, dtype=np.float64)[..., None]
    step = rotation_log(np.swapaxes(X_1[..., :3, :3], -1, -2) @ X_2[..., :3, :3])
    return make_pose(X_1[..., :3, :3] @ rotation_exp(s * step), (1.0 - s) * X_1[..., :3, 3] + s * X_2[..., :3, 3])
