"""Closed-form inverse kinematics of the Panda, with the angle of joint 7 as the free parameter.

Joint limits are ignored. For a chosen angle of joint 7 at most 2 x 2 x 2 postures remain: elbow bend (joint 4), wrist
side (joint 6) and shoulder flip (joint 2). Derivation after Y. He and S. Liu, "Analytical Inverse Kinematics for Franka
Emika Panda - a Geometrical Solver for 7-DOF Manipulators with Unconventional Design", ICCMA 2021; here for arrays of
poses and angles.
"""

from collections.abc import Sequence

import numpy as np

from kinebench_drake.geometry import Array, make_pose, rotation_z
from kinebench_drake.models.robot import N_JOINTS

N_BRANCHES = 8
"""Greatest number of postures for a joint-7 angle."""

# Lengths of the URDF [m]: base to shoulder, shoulder to elbow, elbow to wrist, the elbow's offset, wrist to flange
# axis, link 7 to flange.
_D1 = 0.333
_D3 = 0.316
_D5 = 0.384
_A4 = 0.0825
_A7 = 0.088
_D_FLANGE = 0.107
_UPPER = float(np.hypot(_D3, _A4))
_LOWER = float(np.hypot(_D5, _A4))
# Angle at the elbow joint from the shoulder (at q4 = 0) to the wrist.
_ELBOW = float(np.arctan2(_D5, -_A4) - np.arctan2(-_D3, -_A4))
_REACH = _UPPER + _LOWER
# The chain in modified Denavit-Hartenberg parameters (a, d, alpha), as documented by Franka.
_CHAIN = (
    (0.0, _D1, 0.0),
    (0.0, 0.0, -np.pi / 2),
    (0.0, _D3, np.pi / 2),
    (_A4, 0.0, np.pi / 2),
    (-_A4, _D5, -np.pi / 2),
    (0.0, 0.0, np.pi / 2),
    (_A7, 0.0, np.pi / 2),
)


def flange_pose(q: Array) -> Array:
    """Return the pose X_BF (..., 4, 4) [m] of the flange (panda_link8) at joint angles `q` (..., 7) [rad]."""
    X = np.broadcast_to(np.eye(4), (*q.shape[:-1], 4, 4))
    for j, (a, d, alpha) in enumerate(_CHAIN):
        roll = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(alpha), -np.sin(alpha)], [0.0, np.sin(alpha), np.cos(alpha)]])
        X = X @ make_pose(roll @ rotation_z(q[..., j]), roll @ [a, 0.0, d])
    return np.asarray(X + _D_FLANGE * X[..., :, 2:3] * np.array([0.0, 0.0, 0.0, 1.0]))


def reach_window(X_BF: Array) -> tuple[Array, Array, Array]:
    """Return the joint-7 angles at which flange poses (..., 4, 4) are within reach of the stretched arm.

    As joint 7 turns, the wrist moves on a circle; the window is its part within the stretched arm's sphere about the
    shoulder.

    Returns:
        Centre (...) of the window [rad]; its half width (...) [rad], pi if all angles are in it, 0 if none is; distance
        (...) [m] by which the wrist is out of reach at the centre, 0 within reach.
    """
    p = X_BF[..., :3, 3] - _D_FLANGE * X_BF[..., :3, 2] - np.array([0.0, 0.0, _D1])
    x = np.sum(p * X_BF[..., :3, 0], axis=-1)
    y = np.sum(p * X_BF[..., :3, 1], axis=-1)
    side = np.hypot(x, y)
    square = np.sum(p * p, axis=-1) + _A7**2
    cos = (square - _REACH**2) / np.maximum(2 * _A7 * side, 1e-12)
    least = np.sqrt(np.maximum(square - 2 * _A7 * side, 0.0))
    return np.arctan2(-y, x), np.arccos(np.clip(cos, -1.0, 1.0)), np.maximum(least - _REACH, 0.0)


def branch_of(q: Array) -> int:
    """Return the branch of a posture `q` (7,) [rad]: `analytic_ik` of its flange pose and joint 7 has it there.

    By the signs of the angles of elbow, wrist and shoulder in `analytic_ik`. That of the wrist, `half`, has the sign of
    z6 . (way x z5) = along_x z4 . z6, and z4 . z6 = cos q5.
    """
    _, q2, _, q4, q5, _, _ = q
    along_x = np.cos(q4) * _A4 + np.sin(q4) * _D3 - _A4
    return 4 * bool(np.sin(q4 + _ELBOW) < 0.0) + 2 * bool(along_x * np.cos(q5) < 0.0) + bool(q2 < 0.0)


def analytic_ik(X_BF: Array, q7: Array) -> Array:
    """Return the joint angles (..., 8, 7) [rad] that bring the flange to `X_BF` for joint-7 angles `q7`.

    Poses (..., 4, 4) of panda_link8 in panda_link0 [m] and angles (...) [rad] are broadcast. The branch index is 4 *
    elbow + 2 * wrist + shoulder; a branch is continuous in the pose and q7 away from singularities. Rows are NaN where
    there is no solution. Angles lie in [-pi, pi), except joint 4 in (-3 pi/2, pi/2] and joint 6 in [-pi/2, 3 pi/2), the
    ranges of their limits, and joint 7, as `q7`.
    """
    shape = np.broadcast_shapes(X_BF.shape[:-2], q7.shape)
    X_BF = X_BF[(None,) * (len(shape) + 2 - X_BF.ndim)]
    # Axes of link 6 in the base, and the way from the shoulder to its origin (wrist) along them.
    c = np.cos(q7)
    s = np.sin(q7)
    x7, y7, z7, p = np.moveaxis(X_BF[..., :3, :], (-1, -2), (0, 1))
    x6 = c * x7 - s * y7
    y6 = -z7
    z6 = s * x7 + c * y7
    p = p - _D_FLANGE * z7 - np.reshape([0.0, 0.0, _D1], (3, *[1] * (p.ndim - 1)))
    u = _dot(p, x6) - _A7
    v = _dot(p, y6)
    w = _dot(p, z6)

    signs = np.reshape([1.0, -1.0], (2, *[1] * len(shape)))
    q = np.empty((N_JOINTS, 2, 2, 2, *shape))  # joint, elbow, wrist, shoulder
    with np.errstate(invalid="ignore", divide="ignore"):
        # Elbow: the triangle shoulder, elbow joint, wrist has three known sides.
        bend = np.arccos((_UPPER**2 + _LOWER**2 - u * u - v * v - w * w) / (2 * _UPPER * _LOWER))  # NaN out of reach
        q4 = (signs * bend - _ELBOW + 2 * np.pi * (signs < 0.0))[:, None]  # (elbow, 1, ...)
        q4 -= 2 * np.pi * (q4 > np.pi / 2)
        # In frame 4, whose y is joint 5's axis: from the shoulder to the wrist.
        c4 = np.cos(q4)
        s4 = np.sin(q4)
        along_x = c4 * _A4 + s4 * _D3 - _A4
        along_y = -s4 * _A4 + c4 * _D3 + _D5

        # Wrist: joint 5's axis z5 is normal to z6 and has the component along_y of the way (u, v, w). From here on
        # vectors are in the axes of link 6.
        half = np.arccos(along_y / np.hypot(u, v))  # NaN where joint 6 cannot turn that far
        phi = np.arctan2(v, u) + signs * half  # (elbow, wrist, ...)
        z5 = np.cos(phi), np.sin(phi)
        # Frame 4: y4 = z5, (u, v, w) = along_x x4 + along_y y4 and z4 = x4 x y4.
        x4 = (u - along_y * z5[0]) / along_x, (v - along_y * z5[1]) / along_x, w / along_x
        z4 = -x4[2] * z5[1], x4[2] * z5[0], x4[0] * z5[1] - x4[1] * z5[0]
        # By q5 to frame 5, whose -y is z6; from there by q6 to x6.
        q5 = np.arctan2(x4[2], z4[2])
        q6 = np.arctan2(z5[0], np.cos(q5) * x4[0] - np.sin(q5) * z4[0])
        q6 += 2 * np.pi * (q6 < -np.pi / 2)

        # Shoulder: R_B3 = Rz(q1) Ry(q2) Rz(q3), whose z axis leaves two ways.
        x3 = c4 * x4[0] - s4 * z5[0], c4 * x4[1] - s4 * z5[1], c4 * x4[2]
        z3 = s4 * x4[0] + c4 * z5[0], s4 * x4[1] + c4 * z5[1], s4 * x4[2]
        z3_B = [_dot((x6[k], y6[k], z6[k]), z3) for k in range(3)]
        x3_z, y3_z = (_dot((x6[2], y6[2], z6[2]), axis) for axis in (x3, (-z4[0], -z4[1], -z4[2])))
    q1 = np.arctan2(z3_B[1], z3_B[0])
    q2 = np.arctan2(np.hypot(z3_B[0], z3_B[1]), z3_B[2])
    q3 = np.arctan2(y3_z, -x3_z)
    q[0, :, :, 0], q[1, :, :, 0], q[2, :, :, 0] = q1, q2, q3
    q[0, :, :, 1], q[1, :, :, 1], q[2, :, :, 1] = q1 - np.copysign(np.pi, q1), -q2, q3 - np.copysign(np.pi, q3)
    q[3], q[4], q[5], q[6] = q4[:, :, None], q5[:, :, None], q6[:, :, None], q7
    q = np.moveaxis(q.reshape(N_JOINTS, -1, *shape), (0, 1), (-1, -2))
    q[~np.isfinite(q[..., 4])] = np.nan
    return np.ascontiguousarray(q)


def _dot(a: Array | Sequence[Array], b: Array | Sequence[Array]) -> Array:
    """Return the scalar products (...) of vectors given by component."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
