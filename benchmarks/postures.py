"""All postures of the Panda that reach a pose, by a derivation of its own.

The arm in modified Denavit-Hartenberg parameters as its maker documents them (Franka Control Interface documentation,
"Robot and interface specifications"). Once joint 7 is chosen, frame 6 is known and the shoulder can be expressed in it;
two equations of the form A cos x + B sin x = C give joints 4 and 6, joint 5 follows, and joints 1 to 3 are the
z-y-z Euler angles of what remains. The audit solves the same problem in another way: neither can hide the other's
mistakes.
"""

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.panda.robot import HAND_TO_TCP_M

SHOULDER_M, OFFSET_M, FLANGE_M = 0.333, 0.088, 0.107 + HAND_TO_TCP_M
"""The shoulder's height, flange axis to wrist, wrist to TCP along the flange axis [m]."""

_D3, _D5, _A4 = 0.316, 0.384, 0.0825
_HAND_YAW = -np.pi / 4


def all_postures(plant: ArmPlant, X_BG: Array, q7: Array) -> Array:
    """Joint angles (N, 8, 7) [rad] that reach a pose (4, 4) [m] with joint 7 at `q7` (N,) [rad], limits ignored.

    NaN where there is none. Every angle is turned to within pi of the middle of its joint's range.
    """
    R_06 = X_BG[:3, :3] @ _about_z(-q7 - _HAND_YAW) @ _about_x(-np.pi / 2)
    wrist = X_BG[:3, 3] - FLANGE_M * X_BG[:3, 2] - OFFSET_M * R_06[:, :, 0]
    to_shoulder = np.array([0.0, 0.0, SHOULDER_M]) - wrist
    x, y, z = np.moveaxis(np.einsum("nji,nj->ni", R_06, to_shoulder), -1, 0)[:, :, None, None]
    sign = np.array([1.0, -1.0])
    with np.errstate(invalid="ignore", divide="ignore"):
        # Joint 4: the distance of shoulder and wrist.
        P, Q = 2.0 * (_D3 * _D5 - _A4**2), -2.0 * _A4 * (_D3 + _D5)
        C = np.sum(to_shoulder**2, axis=-1)[:, None, None] - (2.0 * _A4**2 + _D3**2 + _D5**2)
        q4 = np.arctan2(Q, P) + sign[:, None] * np.arccos(C / np.hypot(P, Q))  # (n, 2, 1)
        s4_x = _A4 - _A4 * np.cos(q4) - _D3 * np.sin(q4)
        s4_y = _A4 * np.sin(q4) - _D3 * np.cos(q4) - _D5
        # Joint 6: the shoulder's place along joint 5's axis is the same in frames 4 and 5.
        arc = np.arcsin(s4_y / np.hypot(x, y))
        q6 = np.where(sign > 0, arc, np.pi - arc) - np.arctan2(y, x)  # (n, 2, 2)
        # Joint 5: and its place across that axis.
        q5 = np.arctan2(z / s4_x, (np.cos(q6) * x - np.sin(q6) * y) / s4_x)
    q4 = np.broadcast_to(q4, q6.shape)
    found = np.isfinite(q5) & np.isfinite(q6)
    q4, q5, q6 = (np.where(found, q, 0.0) for q in (q4, q5, q6))
    R_36 = _about_x(np.pi / 2) @ _about_z(q4) @ _about_x(-np.pi / 2) @ _about_z(q5) @ _about_x(np.pi / 2) @ _about_z(q6)
    R = R_06[:, None, None] @ np.swapaxes(R_36, -1, -2)
    q = np.full((len(q7), 2, 2, 2, 7), np.nan)
    for i, s in enumerate(sign):
        q[:, :, :, i, 0] = np.arctan2(s * R[..., 1, 2], s * R[..., 0, 2])
        q[:, :, :, i, 1] = s * np.arctan2(np.hypot(R[..., 0, 2], R[..., 1, 2]), R[..., 2, 2])
        q[:, :, :, i, 2] = np.arctan2(s * R[..., 2, 1], -s * R[..., 2, 0])
        for joint, angle in ((3, q4), (4, q5), (5, q6)):
            q[:, :, :, i, joint] = angle
    q[..., 6] = q7[:, None, None, None]
    q[~found] = np.nan
    middle = 0.5 * (plant.lower + plant.upper)
    q = (q - middle + np.pi) % (2.0 * np.pi) - np.pi + middle
    return np.asarray(q.reshape(len(q7), 8, 7))


def _about_x(angle: float) -> Array:
    c, s = round(np.cos(angle)), round(np.sin(angle))  # of quarter turns
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _about_z(angle: Array) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    R = np.zeros((*np.shape(angle), 3, 3))
    R[..., 0, 0], R[..., 0, 1], R[..., 1, 0], R[..., 1, 1] = c, -s, s, c
    R[..., 2, 2] = 1.0
    return R
