"""Resolution of 180-degree flips: rotated half a turn about its approach axis, the gripper looks almost the same.

Each frame yields a log-likelihood ratio of the fitted pose against the flipped one; the sequence of flips over the
video that fits all frames and avoids sudden rotations is found by dynamic programming (Viterbi 1967).
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from kinebench_drake.geometry import Array, invert, make_pose, rotation_angle, rotation_exp, transform_points
from kinebench_drake.grounding.tracking.pose import FramePose

X_HALF_TURN = make_pose(rotation_exp([0.0, 0.0, np.pi]), np.zeros(3))
"""Pose (4, 4) of the flipped hand in the hand frame: 180 degrees about z."""
_EVIDENCE_CAP = 6.0  # label errors of one view are correlated: no frame outweighs several others
_CAP_WITH_EDGES = 2.0  # where poses had to be fitted to edges, the CAD coordinates are less sure
_ROTATION_SIGMA_RAD = np.deg2rad(20.0)  # usual rotation between frames
_ROTATION_CAP = 40.0  # cost of a jump: half a turn in one frame is no motion of an arm


def flip_evidence(pose: FramePose) -> float:
    """Return the log-likelihood ratio of the fitted pose against the flipped one, given the CAD coordinates."""
    view = pose.view
    cells = view.gripper
    cloud_V = view.rays()[cells] * (view.depth_m[cells] * pose.hand.depth_factor)[:, None]
    p_H = transform_points(invert(pose.X_CH) @ view.crop.X_CV, cloud_V)
    finger = pose.finger_m if np.isfinite(pose.finger_m) else 0.0
    p_H[:, 1] -= view.opening_sign[cells] * finger
    scale = view.coordinates_sigma_m[cells] / np.sqrt(2.0)
    estimated_H = view.coordinates_P[cells]
    as_fitted = np.abs(p_H - estimated_H).sum(axis=1) / scale
    flipped = np.abs(p_H * [-1.0, -1.0, 1.0] - estimated_H).sum(axis=1) / scale
    of_hand = float((flipped - as_fitted).mean())
    if pose.arm is None:
        return float(np.clip(of_hand, -_EVIDENCE_CAP, _EVIDENCE_CAP))
    cap = _EVIDENCE_CAP if np.isnan(pose.arm.edge_agreement) else _CAP_WITH_EDGES
    return float(np.clip(of_hand, -cap, cap)) + pose.arm.evidence


def _rotation_cost(X_1: Array, X_2: Array) -> float:
    angle = float(rotation_angle(X_1[:3, :3].T @ X_2[:3, :3]))
    return float(min((angle / _ROTATION_SIGMA_RAD) ** 2, _ROTATION_CAP))


def resolve_flips(poses: Sequence[FramePose | None]) -> list[FramePose | None]:
    """Return the poses, each as fitted or flipped, that fit the whole video best."""
    measured = [(i, pose) for i, pose in enumerate(poses) if pose is not None]
    if not measured:
        return list(poses)
    variants = [
        ((pose.X_CH, pose.X_CH @ X_HALF_TURN), np.inf if pose.from_prior else flip_evidence(pose))
        for _, pose in measured
    ]
    cost = np.array([0.0, variants[0][1]])
    back: list[list[int]] = []
    for previous, current in pairwise(variants):
        step = np.array([[_rotation_cost(previous[0][a], current[0][b]) for b in (0, 1)] for a in (0, 1)])
        total = cost[:, None] + step
        back.append(total.argmin(axis=0).tolist())
        cost = total.min(axis=0) + np.array([0.0, current[1]])
    state = int(cost.argmin())
    states = [state]
    for choices in reversed(back):
        state = choices[state]
        states.append(state)
    resolved = list(poses)
    for (i, pose), flipped in zip(measured, reversed(states), strict=True):
        if flipped:
            resolved[i] = replace(pose, X_CH=pose.X_CH @ X_HALF_TURN)
    return resolved
