"""The two readings of the gripper: turned by 180 degrees about its own axis it looks almost the same.

Each frame says how much better its CAD coordinates suit the pose as fitted than the turned one; the video as a whole
then picks the sequence of readings that suits the frames and does not spin (Viterbi 1967).
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from kinebench_drake.geometry import Array, invert, make_pose, rotation_angle, rotation_exp, transform_points
from kinebench_drake.grounding.frame_pose import FramePose

X_HALF_TURN = make_pose(rotation_exp([0.0, 0.0, np.pi]), np.zeros(3))
"""Pose (4, 4) of the hand turned by 180 degrees in the hand's frame."""
_EVIDENCE_CAP = 6.0  # the cells of a view are misread together: no frame outweighs several others
_TURN_SIGMA_RAD = np.deg2rad(20.0)  # usual turn from one frame to the next
_TURN_CAP = 40.0  # cost of a jump: half a turn in one frame is no motion of an arm


def flip_evidence(pose: FramePose) -> float:
    """Log-likelihood ratio of the pose as fitted against the turned one, from the CAD coordinates seen."""
    view = pose.view
    cells = view.gripper
    cloud_V = view.rays()[cells] * (view.depth_m[cells] * pose.fit.depth_factor)[:, None]
    p_H = transform_points(invert(pose.X_CH) @ view.crop.X_CV, cloud_V)
    finger = pose.finger_m if np.isfinite(pose.finger_m) else 0.0
    p_H[:, 1] -= view.opening_sign[cells] * finger
    scale = view.coordinates_sigma_m[cells] / np.sqrt(2.0)
    said = view.coordinates_P[cells]
    as_fitted = np.abs(p_H - said).sum(axis=1) / scale
    turned = np.abs(p_H * [-1.0, -1.0, 1.0] - said).sum(axis=1) / scale
    of_hand = float(np.clip((turned - as_fitted).mean(), -_EVIDENCE_CAP, _EVIDENCE_CAP))
    return of_hand + (pose.arm.evidence if pose.arm is not None else 0.0)


def _turn_cost(X_1: Array, X_2: Array) -> float:
    angle = float(rotation_angle(X_1[:3, :3].T @ X_2[:3, :3]))
    return float(min((angle / _TURN_SIGMA_RAD) ** 2, _TURN_CAP))


def resolve_flips(poses: Sequence[FramePose | None]) -> list[FramePose | None]:
    """The poses in the readings that suit the whole video best."""
    known = [(i, pose) for i, pose in enumerate(poses) if pose is not None]
    if not known:
        return list(poses)
    variants = [
        ((pose.X_CH, pose.X_CH @ X_HALF_TURN), np.inf if pose.given else flip_evidence(pose)) for _, pose in known
    ]
    cost = np.array([0.0, variants[0][1]])
    back: list[list[int]] = []
    for previous, current in pairwise(variants):
        step = np.array([[_turn_cost(previous[0][a], current[0][b]) for b in (0, 1)] for a in (0, 1)])
        total = cost[:, None] + step
        back.append(total.argmin(axis=0).tolist())
        cost = total.min(axis=0) + np.array([0.0, current[1]])
    state = int(cost.argmin())
    states = [state]
    for choices in reversed(back):
        state = choices[state]
        states.append(state)
    settled = list(poses)
    for (i, pose), turned in zip(known, reversed(states), strict=True):
        if turned:
            settled[i] = replace(pose, X_CH=pose.X_CH @ X_HALF_TURN)
    return settled
