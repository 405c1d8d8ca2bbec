"""Gap between the fingers and shape of the hand by the edges of an image, where the pose of the hand is known.

Contours of the fingers are placed at every gap of a grid, and compared with the edges. The contour of the hand lies on
edges as it is, or only resized or stretched. It needs no network, so it holds for looks that the network was not
trained on.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.registration.edges import LEAST_GRADIENT, EdgeMatcher
from kinebench_drake.grounding.registration.image import EdgePoints, GradientImage
from kinebench_drake.grounding.registration.solver import POINTS_INDEPENDENT
from kinebench_drake.grounding.tracking.view import OPENING_SIGNS
from kinebench_drake.models.panda.cad import MAX_FINGER_M
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
_FINGER_POINTS = 150
_FINGER_REACH_PX = 6.0
_MOUNT_FRAMES = 8
_CHANCE = 0.2
"""Share of a contour that lies on edges by chance."""
# Chosen by hand on own renders; checked by `python -m benchmarks evaluate` on these, by `footage` on others' videos.
_SHAPE_CHANGE = 0.35
"""Change of the hand's shape by a fit that has failed."""
_REACHES_PX = (8.0, 6.0, 4.0, 3.0)
"""Farthest image edges in successive passes [px]."""
_LEAST_POINTS = 30
_START_SIZES = (1.0, 0.88, 1.12)
"""Sizes from which the fit starts, over that of the CAD model."""
_MOVED_PX = 1.0
"""Standard deviation of the flange's place in the image [px]."""
_STRETCHED = 0.2
"""Standard deviation of the relative stretch."""
_TUKEY = 4.0
_LEAST_SCATTER_PX = 0.5
_PASSES = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class HandImage:
    """Frame with a hand whose pose is known."""

    image: GradientImage
    X_CP: Array
    """(PARTS, 4, 4) poses of the parts in the camera frame, fingers closed [m]."""


def gap_log_likelihoods(edges: EdgeMatcher, hands: Mapping[int, HandImage]) -> dict[int, Array]:
    """Return the log-likelihood (G,) of each of `GAPS_M`, up to a constant, by frame number.

    The mount of the fingers is the one that matches the edges of all frames better. Fingers of a linkage move along
    curves: they have none.
    """
    if not hands or edges.gripper.linkage is not None:
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
        points = edges.project(edges.gripper.open(X_CP, middle_m / 2), hand.image.camera, _FINGERS, _FINGER_POINTS)
        if points is not None:
            result[gaps] = _contour_log_likelihood(edges, hand, points, GAPS_M[gaps] - middle_m)
    return result


def _contour_log_likelihood(edges: EdgeMatcher, hand: HandImage, points: EdgePoints, changes_m: Array) -> Array:
    """Return the log-likelihoods (M,) of gaps that differ by `changes_m` (M,) from that of the contour [m].

    A point counts by the square of how fast the gap moves it across the contour.
    """
    count = len(changes_m)
    direction = OPENING_SIGNS[points.part][:, None] * hand.X_CP[RobotPart.HAND, :3, 1]
    p_C = (points.p_C + changes_m[:, None, None] / 2 * direction).reshape(-1, 3)
    moved = EdgePoints(
        part=np.tile(points.part, count),
        p_P=np.tile(points.p_P, (count, 1)),
        p_C=p_C,
        pixel=hand.image.camera.project(p_C),
        normal=np.tile(points.normal, (count, 1)),
    )
    shares = edges.edge_shares(hand.image, moved, reach_px=_FINGER_REACH_PX)
    depth = points.p_C[:, 2]
    speed = direction[:, :2] - points.p_C[:, :2] / depth[:, None] * direction[:, 2:]
    weight = np.clip(0.7 / depth * np.abs((speed * points.normal).sum(axis=1)), 0.0, 1.0) ** 2
    return np.asarray((weight * (shares.reshape(count, -1) - _CHANCE)).sum(axis=1))


@dataclass(frozen=True, slots=True, kw_only=True)
class HandShape:
    """Shape of the hand in an image, relative to that of the CAD model at its pose."""

    log_scale: float = 0.0
    """Logarithm of its size."""
    stretch: float = 0.0
    """Change of its shape at the same size: norm of the traceless part of the stretch in the image."""
    gain: float = 0.0
    """How much more of its contour lies on image edges than that of the CAD model."""


def fit_shape(edges: EdgeMatcher, image: GradientImage, X_CP: Array) -> HandShape | None:
    """Fit an affine map in the image, about the flange, of the hand's contour to image edges.

    None if the contour is too short or nothing fits.

    Parts are at `X_CP` (PARTS, 4, 4) in the camera frame [m]. Each pass is a linear fit of the distances to the nearest
    edges across the contour, with Tukey's weights.
    """
    points = edges.project(X_CP, image.camera, (RobotPart.HAND,))
    if points is None or len(points.pixel) < _LEAST_POINTS:
        return None
    share = float(edges.edge_shares(image, points).mean())
    if share >= bounds.CONFIRMATION:
        return HandShape()
    flange = image.camera.project(X_CP[RobotPart.HAND, :3, 3])
    fits = [_fit(image, points, flange, size * np.eye(2)) for size in _START_SIZES]
    shares = [float(edges.edge_shares(image, _mapped(points, flange, *fit)).mean()) for fit in fits]
    best = max(share, *shares)
    A = fits[int(np.argmax(shares))][0] if best > share else np.eye(2)
    symmetric = 0.5 * (A + A.T)
    scale = 0.5 * float(np.trace(symmetric))
    stretch = float(np.linalg.norm(symmetric - scale * np.eye(2)))
    has_failed = np.hypot(scale - 1.0, stretch) > _SHAPE_CHANGE
    return None if has_failed else HandShape(log_scale=float(np.log(scale)), stretch=stretch, gain=best - share)


def _mapped(points: EdgePoints, flange: Array, A: Array, shift: Array) -> EdgePoints:
    """Return contour points mapped by `A` (2, 2) about the flange (2,) and moved by `shift` (2,) [px]."""
    normal = points.normal @ np.linalg.inv(A)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return replace(points, pixel=flange + shift + (points.pixel - flange) @ A.T, normal=normal)


def _fit(image: GradientImage, points: EdgePoints, flange: Array, A: Array) -> tuple[Array, Array]:
    """Return the map (2, 2) and shift (2,) [px] that put the contour on edges nearby, from the map `A` on."""
    arm_px = points.pixel - flange
    length = float(np.abs(arm_px).max())
    prior = np.diag([_MOVED_PX**-2.0] * 2 + [(_STRETCHED * length) ** -2.0] * 4)
    x = np.concatenate([np.zeros(2), (length * (A - np.eye(2))).ravel()])
    for reach_px in _REACHES_PX:
        mapped = _mapped(points, flange, np.eye(2) + x[2:].reshape(2, 2) / length, x[:2])
        offset, strength = image.find_edges(mapped, reach_px)
        on_edge = strength > LEAST_GRADIENT
        if on_edge.sum() < _LEAST_POINTS:
            break
        across = mapped.normal[:, :, None] * arm_px[:, None, :] / length
        design = np.column_stack([mapped.normal, across.reshape(len(offset), 4)])
        target = offset + design @ x
        weight = on_edge.astype(np.float64)
        for _ in range(_PASSES):
            weighted = design * (POINTS_INDEPENDENT * weight / max(1.0, weight.sum()))[:, None]
            x = np.linalg.solve(weighted.T @ design + prior, weighted.T @ target)
            error = np.abs(target - design @ x)
            scatter = max(1.4826 * float(np.median(error[on_edge])), _LEAST_SCATTER_PX)
            weight = on_edge * np.clip(1.0 - (error / (_TUKEY * scatter)) ** 2, 0.0, 1.0) ** 2
    return np.eye(2) + x[2:].reshape(2, 2) / length, x[:2]
