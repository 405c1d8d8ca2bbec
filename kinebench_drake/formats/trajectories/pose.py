"""Poses from the numbers of a file: nearly rigid poses are repaired, others are refused with their frame."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, make_pose, orthonormalize
from kinebench_drake.segments import spread

REPAIRABLE = 1e-3
"""Greatest deviation of R^T R from the identity, or of a quaternion's norm from 1, that is repaired."""
FAR_M = 10.0
"""Greatest coordinate of the gripper in the robot base frame [m]: larger values are not in metres."""

_ROUNDING = 1e-5  # deviations within single precision are repaired without a warning


@np.errstate(over="ignore", invalid="ignore")  # values that overflow are refused below
def rigid_poses(X: Array, valid: NDArray[np.bool_]) -> tuple[Array, tuple[str, ...]]:
    """Return rigid poses (T, 4, 4) of matrices, NaN for frames that are not `valid` (T,), and messages about repairs.

    Raises:
        InputError: a frame holds no finite number, no homogeneous matrix, a left-handed or a distorted frame, or a
            position that cannot be in metres.
    """
    frames = np.flatnonzero(valid)
    matrices = X[valid]
    _require_finite(matrices.reshape(len(frames), 16), frames)
    off = np.abs(matrices[:, 3] - np.eye(4)[3]).max(axis=-1, initial=0.0)
    if (off > REPAIRABLE).any():
        k = int(np.argmax(off > REPAIRABLE))
        row = ", ".join(f"{v:.4g}" for v in matrices[k, 3])
        turned = np.abs(matrices[k, :, 3] - np.eye(4)[3]).max() <= REPAIRABLE
        fix = "the matrices are transposed, store them row by row" if turned else "expected 0, 0, 0, 1"
        raise InputError(f"the last row of the pose of frame {frames[k]} is {row}: {fix}")
    R = matrices[:, :3, :3]
    deviation = np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max(axis=(-1, -2), initial=0.0)
    wrong = ~(deviation <= REPAIRABLE) | (np.linalg.det(R) < 0.0)
    if wrong.any():
        k = int(np.argmax(wrong))
        reason = f"not orthonormal: R^T R is off the identity by {deviation[k]:.2g}, at most {REPAIRABLE:g} is repaired"
        if deviation[k] <= REPAIRABLE:
            turned = f"(determinant {np.linalg.det(R[k]):.3f}): one of its axes is mirrored"
            reason = f"left-handed {turned}, expected a right-handed frame"
        raise InputError(f"the rotation of frame {frames[k]} is {reason}")
    _require_metres(matrices[:, :3, 3], frames)
    repaired = int((deviation > _ROUNDING).sum())
    message = f"{repaired} rotations, off by up to {deviation.max(initial=0.0):.1e}, were made orthonormal"
    poses = make_pose(orthonormalize(R), matrices[:, :3, 3])
    return spread(poses, valid, len(X)), ((message,) if repaired else ())


@np.errstate(over="ignore", invalid="ignore")
def rotations_of(layout: str, numbers: Array, angle_rad: float) -> tuple[Array, tuple[str, ...]]:
    """Return rotation matrices (T, 3, 3), NaN where a number is not finite, and messages about repairs.

    Args:
        layout: one of `reading.LAYOUTS` with a rotation.
        numbers: (T, n) numbers of the rotations.
        angle_rad: unit of angles [rad].
    """
    R = np.full((len(numbers), 3, 3), np.nan)
    finite = np.isfinite(numbers).all(axis=-1)
    frames = np.flatnonzero(finite)
    own = numbers[finite]
    repairs = tuple[str, ...]()
    if layout.startswith("quaternion"):
        repairs = _check_norms(own, frames)
        R[finite] = Rotation.from_quat(own, scalar_first=layout == "quaternion_wxyz").as_matrix()
    elif layout.startswith("matrix"):
        rows = own.reshape(-1, 3, 3)
        R[finite] = rows if layout == "matrix_rows" else np.swapaxes(rows, -1, -2)
    elif layout.startswith("rotation_6d"):
        # Two axes, made orthonormal; Y. Zhou et al., CVPR 2019.
        x = own[:, :3] / np.linalg.norm(own[:, :3], axis=-1, keepdims=True)
        y = own[:, 3:] - np.sum(x * own[:, 3:], axis=-1, keepdims=True) * x
        y /= np.linalg.norm(y, axis=-1, keepdims=True)
        axes = np.stack([x, y, np.cross(x, y)], axis=-2)
        R[finite] = axes if layout == "rotation_6d_rows" else np.swapaxes(axes, -1, -2)
    else:
        own = own * angle_rad
        _check_angles(own, frames)
        is_vector = layout == "rotation_vector"
        turns = Rotation.from_rotvec(own) if is_vector else Rotation.from_euler(layout.removeprefix("euler_"), own)
        R[finite] = turns.as_matrix()
    return R, repairs


def _check_norms(quaternions: Array, frames: NDArray[np.intp]) -> tuple[str, ...]:
    deviation = np.abs(np.linalg.norm(quaternions, axis=-1) - 1.0)
    wrong = ~(deviation <= REPAIRABLE)
    if wrong.any():
        k = int(np.argmax(wrong))
        raise InputError(
            f"the quaternion of frame {frames[k]} has norm {np.linalg.norm(quaternions[k]):.4g}, expected 1; at most "
            f"{REPAIRABLE:g} is repaired"
        )
    repaired = int((deviation > _ROUNDING).sum())
    message = f"{repaired} quaternions, off by up to {deviation.max(initial=0.0):.1e}, were normalized"
    return (message,) if repaired else ()


def _check_angles(angles: Array, frames: NDArray[np.intp]) -> None:
    largest = np.abs(angles).max(axis=-1, initial=0.0)
    if (largest > 2.0 * np.pi + 1e-3).any():
        k = int(np.argmax(largest))
        raise InputError(
            f"rotations go up to {largest[k]:.4g} (frame {frames[k]}), more than a full turn in radians: they look "
            "like degrees, convert them to radians"
        )


def _require_finite(rows: Array, frames: NDArray[np.intp]) -> None:
    broken = ~np.isfinite(rows).all(axis=-1)
    if broken.any():
        k = int(np.argmax(broken))
        value = "NaN" if np.isnan(rows[k]).any() else "infinity"
        more = f" and {int(broken.sum()) - 1} more frames" if broken.sum() > 1 else ""
        raise InputError(f"the pose of frame {frames[k]}{more} holds {value}, expected finite numbers")


def _require_metres(p: Array, frames: NDArray[np.intp]) -> None:
    largest = np.abs(p).max(axis=-1, initial=0.0)
    if (largest > FAR_M).any():
        k = int(np.argmax(largest))
        raise InputError(
            f"positions go up to {largest[k]:.4g} m (frame {frames[k]}), no gripper is more than {FAR_M:g} m from its "
            "robot's base: they look like millimetres, convert them to metres"
        )
