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

_UPRIGHT = 0.5
"""Cosine of the angle to the vertical below which an approach axis counts as pointing up or down (60 degrees)."""
_ROUNDING = 1e-5  # deviations within single precision are repaired without a warning
_LAST_ROW = (0.0, 0.0, 0.0, 1.0)


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
    off = np.abs(matrices[:, 3] - _LAST_ROW).max(axis=-1, initial=0.0)
    if (off > REPAIRABLE).any():
        k = int(np.argmax(off > REPAIRABLE))
        row = ", ".join(f"{v:.4g}" for v in matrices[k, 3])
        turned = np.abs(matrices[k, :, 3] - _LAST_ROW).max() <= REPAIRABLE
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
def from_quaternions(p: Array, quaternion: Array) -> tuple[Array, tuple[str, ...]]:
    """Return poses (T, 4, 4) from positions (T, 3) [m] and quaternions wxyz (T, 4), and messages about repairs.

    Raises:
        InputError: a quaternion holds no finite number, or its norm is not 1.
    """
    _require_finite(np.concatenate([p, quaternion], axis=1), np.arange(len(p)))
    deviation = np.abs(np.linalg.norm(quaternion, axis=-1) - 1.0)
    wrong = ~(deviation <= REPAIRABLE)
    if wrong.any():
        k = int(np.argmax(wrong))
        raise InputError(
            f"the quaternion of frame {k} has norm {np.linalg.norm(quaternion[k]):.4g}, expected 1; at most "
            f"{REPAIRABLE:g} is repaired"
        )
    repaired = int((deviation > _ROUNDING).sum())
    message = f"{repaired} quaternions, off by up to {deviation.max(initial=0.0):.1e}, were normalized"
    R = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
    return make_pose(R, p), (*((message,) if repaired else ()), *_suspect_order(R, quaternion))


def _suspect_order(R: Array, quaternion: Array) -> tuple[str, ...]:
    """Return a message if the gripper points up by the rotations (T, 3, 3), and down by the numbers read as x y z w.

    Grippers over a table point down (z of the TCP against z of the base) nearly always.
    """
    swapped = Rotation.from_quat(quaternion).as_matrix()
    if not (np.median(R[:, 2, 2]) > _UPRIGHT and np.median(swapped[:, 2, 2]) < -_UPRIGHT):
        return ()
    return (
        "the gripper points up, but down if the quaternions are x y z w: they are read as w x y z; reorder them if "
        "they are not",
    )


def from_vectors(p: Array, rotation: Array, *, angles: bool) -> Array:
    """Return poses (T, 4, 4) from positions (T, 3) [m] and rotation vectors (T, 3) [rad].

    With `angles` the latter are roll, pitch and yaw about the fixed axes x, y and z, in this order.

    Raises:
        InputError: a number is not finite, or the angles cannot be radians.
    """
    _require_finite(np.concatenate([p, rotation], axis=1), np.arange(len(p)))
    largest = np.abs(rotation).max(axis=-1, initial=0.0)
    limit = 2.0 * np.pi + 1e-3
    if (largest > limit).any():
        k = int(np.argmax(largest))
        raise InputError(
            f"rotations go up to {largest[k]:.4g} (frame {k}), more than a full turn in radians: they look like "
            "degrees, convert them to radians"
        )
    turn = Rotation.from_euler("xyz", rotation) if angles else Rotation.from_rotvec(rotation)
    return make_pose(turn.as_matrix(), p)


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
