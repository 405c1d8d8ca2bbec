"""All joint angles of the Panda that reach a pose, in closed form, with the last joint's angle as the free parameter.

The arm has seven joints for six coordinates; once joint 7 is chosen, at most 2 x 2 x 2 postures remain: the elbow's
bend (joint 4), the wrist's side (joint 6) and the shoulder's flip (joint 2). Derivation after Y. He and S. Liu,
"Analytical Inverse Kinematics for Franka Emika Panda - a Geometrical Solver for 7-DOF Manipulators with Unconventional
Design", ICCMA 2021; written here for whole arrays of joint-7 angles at once. Joint limits play no part here.
"""

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.geometry import Array
from kinebench_drake.models.panda.robot import HAND_TO_TCP_M

# Lengths of the URDF [m]: base to shoulder, shoulder to elbow, elbow to wrist, the elbow's offset, wrist to flange
# axis, link 7 to hand; and the hand's turn about the flange [rad].
_D1, _D3, _D5, _A4, _A7, _D_HAND = 0.333, 0.316, 0.384, 0.0825, 0.088, 0.107
_HAND_YAW = -np.pi / 4
_UPPER, _LOWER = np.hypot(_D3, _A4), np.hypot(_D5, _A4)
# Angle at the elbow joint from the shoulder (at q4 = 0) to the wrist.
_ELBOW = np.arctan2(_D5, -_A4) - np.arctan2(-_D3, -_A4)


def _wrap(angle: Array) -> Array:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


def _rotation_z(angle: Array) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    R = np.zeros((*np.shape(angle), 3, 3))
    R[..., 0, 0], R[..., 0, 1], R[..., 1, 0], R[..., 1, 1] = c, -s, s, c
    R[..., 2, 2] = 1.0
    return R


def analytic_ik(X_BG: ArrayLike, q7: ArrayLike) -> Array:
    """Joint angles (N, 8, 7) [rad] that reach `X_BG` for each joint-7 angle `q7` (N,) [rad], limits ignored.

    The branch index is 4 * elbow + 2 * wrist + shoulder; a branch is a continuous function of the pose and q7 away
    from singularities. Rows are NaN where there is no solution. Angles lie in [-pi, pi), save joint 4 in
    (-3 pi/2, pi/2] and joint 6 in [-pi/2, 3 pi/2), the turns that hold their limits.

    Args:
        X_BG: pose (4, 4) of panda_hand_tcp in panda_link0 [m].
        q7: joint-7 angles (N,) [rad].
    """
    X_BG, q7 = np.asarray(X_BG, dtype=np.float64), np.atleast_1d(np.asarray(q7, dtype=np.float64))
    n = len(q7)
    # Link 6: its origin is the wrist centre W, which joint 5's axis passes too.
    R_B7 = X_BG[:3, :3] @ _rotation_z(np.array(-_HAND_YAW))
    p_7 = X_BG[:3, 3] - (_D_HAND + HAND_TO_TCP_M) * X_BG[:3, 2]
    R_unturned = R_B7 @ _rotation_z(-q7)  # columns x6, z6, -y6
    x6, z6, y6 = R_unturned[..., 0], R_unturned[..., 1], -R_unturned[..., 2]
    SW = p_7 - _A7 * x6 - [0.0, 0.0, _D1]  # (n, 3) shoulder S to wrist W
    reach = np.linalg.norm(SW, axis=-1)

    # Elbow: the triangle S, elbow joint, W has three known sides.
    with np.errstate(invalid="ignore", divide="ignore"):
        bend = np.arccos((_UPPER**2 + _LOWER**2 - reach**2) / (2 * _UPPER * _LOWER))  # NaN out of reach
        q4 = np.stack([bend - _ELBOW, -bend - _ELBOW + 2 * np.pi])  # (2 elbow, n)
        q4 = q4 - 2 * np.pi * (q4 > np.pi / 2)
        # In frame 4, whose y is joint 5's axis: from S to W.
        c4, s4 = np.cos(q4), np.sin(q4)
        along_x = c4 * _A4 + s4 * _D3 - _A4
        along_y = -s4 * _A4 + c4 * _D3 + _D5

        # Wrist: joint 5's axis z5 is normal to z6 and has the component along_y of S-W.
        u, v = np.sum(SW * x6, axis=-1), np.sum(SW * y6, axis=-1)
        size = np.hypot(u, v)
        half = np.arccos(along_y / size)  # (2, n); NaN where joint 6 cannot turn that far
        phi = np.arctan2(v, u) + np.stack([half, -half], axis=1)  # (2 elbow, 2 wrist, n)
    z5 = np.cos(phi)[..., None] * x6 + np.sin(phi)[..., None] * y6
    # Frame 4: y4 = z5 and S-W = along_x x4 + along_y y4.
    x4 = (SW - along_y[:, None, :, None] * z5) / along_x[:, None, :, None]
    x4 /= np.linalg.norm(x4, axis=-1, keepdims=True)
    z4 = np.cross(x4, z5)
    # From frame 4 by q5 to frame 5, whose -y is z6; from there by q6 to x6.
    q5 = np.arctan2(np.sum(z6 * x4, axis=-1), np.sum(z6 * z4, axis=-1))
    x5 = np.cos(q5)[..., None] * x4 - np.sin(q5)[..., None] * z4
    q6 = np.arctan2(np.sum(x6 * z5, axis=-1), np.sum(x6 * x5, axis=-1))

    # Shoulder: R_B3 = Rz(q1) Ry(q2) Rz(q3), whose z axis leaves two ways.
    q4_all = np.broadcast_to(q4[:, None], z5.shape[:-1])
    c4, s4 = np.cos(q4_all)[..., None], np.sin(q4_all)[..., None]
    x3, z3, y3 = c4 * x4 - s4 * z5, s4 * x4 + c4 * z5, -z4
    q = np.full((2, 2, 2, n, 7), np.nan)
    sine = np.hypot(z3[..., 0], z3[..., 1])
    for shoulder, sign in enumerate((1.0, -1.0)):
        out = q[:, :, shoulder]
        out[..., 0] = np.arctan2(sign * z3[..., 1], sign * z3[..., 0])
        out[..., 1] = np.arctan2(sign * sine, z3[..., 2])
        out[..., 2] = np.arctan2(sign * y3[..., 2], -sign * x3[..., 2])
        out[..., 3], out[..., 4], out[..., 5], out[..., 6] = q4_all, q5, q6, q7
    q[..., 5] += 2 * np.pi * (q[..., 5] < -np.pi / 2)
    q[..., :3] = _wrap(q[..., :3])
    q[~np.isfinite(q).all(axis=-1)] = np.nan
    return np.asarray(np.moveaxis(q, 3, 0).reshape(n, 8, 7))
