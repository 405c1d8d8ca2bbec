"""Gap between the fingers by the edges of an image, where the pose of the hand is known.

Contours of the fingers are placed at every gap of a grid, and compared with the edges of the image. It needs no
network, so it holds for looks that the network was not trained on.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.grounding.registration.edges import EdgeMatcher
from kinebench_drake.grounding.registration.image import EdgePoints, GradientImage
from kinebench_drake.grounding.tracking.view import OPENING_SIGNS
from kinebench_drake.models.panda.cad import MAX_FINGER_M, open_fingers
from kinebench_drake.models.panda.description import RobotPart
from kinebench_drake.segments import evenly

GAP_STEP_M = 0.002
"""Step of the grid of gaps [m]."""
GAPS_M = np.arange(0.0, 2 * MAX_FINGER_M + GAP_STEP_M / 2, GAP_STEP_M)
"""Grid of gaps between the pads [m]."""
MOUNTS_M = (0.0, -0.006)
"""Shifts of the fingers along z of panda_hand [m]: in franka_description, and in robosuite (`panda_gripper.xml` puts
them at 52.4 mm from the hand in place of 58.4)."""
_FINGERS = (RobotPart.LEFT_FINGER, RobotPart.RIGHT_FINGER)
_OCCLUSIONS = 6
"""Number of gaps at which it is determined what hides the fingers."""
_POINTS = 150
_REACH_PX = 6.0
_MOUNT_FRAMES = 8
_CHANCE = 0.2
"""Share of a contour that lies on edges by chance."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HandImage:
    """Frame with a hand whose pose is known."""

    image: GradientImage
    X_CP: Array
    """(PARTS, 4, 4) poses of the parts in the camera frame, fingers closed [m]."""


def gap_log_likelihoods(edges: EdgeMatcher, hands: Mapping[int, HandImage]) -> dict[int, Array]:
    """Return the log-likelihood (G,) of each of `GAPS_M`, up to a constant, by frame number.

    The mount of the fingers is the one that matches the edges of all frames better.
    """
    if not hands:
        return {}
    sample = [list(hands)[i] for i in evenly(len(hands), _MOUNT_FRAMES)]
    best = [sum(_log_likelihood(edges, hands[i], mount).max() for i in sample) for mount in MOUNTS_M]
    mount = MOUNTS_M[int(np.argmax(best))]
    return {i: _log_likelihood(edges, hand, mount) for i, hand in hands.items()}


def _log_likelihood(edges: EdgeMatcher, hand: HandImage, mount_m: float) -> Array:
    X_CP = hand.X_CP.copy()
    X_CP[_FINGERS, :3, 3] += mount_m * X_CP[_FINGERS, :3, 2]
    result = np.zeros(len(GAPS_M))
    for gaps in np.array_split(np.arange(len(GAPS_M)), _OCCLUSIONS):
        middle_m = float(GAPS_M[gaps].mean())
        points = edges.project(open_fingers(X_CP, middle_m / 2), hand.image.camera, _FINGERS, _POINTS)
        if points is not None:
            result[gaps] = _contour_log_likelihood(edges, hand, points, GAPS_M[gaps] - middle_m)
    return result


def _contour_log_likelihood(edges: EdgeMatcher, hand: HandImage, points: EdgePoints, changes_m: Array) -> Array:
    """Return the log-likelihoods (M,) of gaps that differ by `changes_m` (M,) from that of the contour [m].

    A point counts by the square of how fast the gap moves it across the contour.
    """
    camera = hand.image.camera
    y_C = hand.X_CP[RobotPart.HAND, :3, 1]
    count = len(changes_m)
    direction = OPENING_SIGNS[points.part][:, None] * y_C
    p_C = (points.p_C + changes_m[:, None, None] / 2 * direction).reshape(-1, 3)
    moved = EdgePoints(
        part=np.tile(points.part, count),
        p_P=np.tile(points.p_P, (count, 1)),
        p_C=p_C,
        pixel=camera.project(p_C),
        normal=np.tile(points.normal, (count, 1)),
    )
    shares = edges.edge_shares(hand.image, moved, reach_px=_REACH_PX)
    depth = points.p_C[:, 2]
    speed = direction[:, :2] - points.p_C[:, :2] / depth[:, None] * direction[:, 2:]
    weight = np.clip(0.7 / depth * np.abs((speed * points.normal).sum(axis=1)), 0.0, 1.0) ** 2
    return np.asarray((weight * (shares.reshape(count, -1) - _CHANCE)).sum(axis=1))
