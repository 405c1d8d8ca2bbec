"""What motion does to pictures: blur along the way, and earlier frames that shine through."""

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.grounding.evaluation.perturbation.seen import Frames, Masks, Seen, centroids, to_bytes

_STILL_PX = 0.5  # a gripper that moves less from the frame before to the one after has no direction of its own
_SAMPLES_PX = 8  # points of the line for each pixel of its length


def blur_motion(frames: Frames, masks: Masks, rng: np.random.Generator, length_px: float) -> Seen:
    """Smear each picture over `length_px` along the gripper's motion in it.

    A resting gripper is smeared the way it last moved (before it ever moved: a random way).
    """
    out = np.empty_like(frames)
    for i, angle in enumerate(directions(centroids(masks), float(rng.uniform(0, np.pi)))):
        out[i] = cv2.filter2D(frames[i], -1, line_kernel(length_px, angle), borderType=cv2.BORDER_REPLICATE)
    return Seen(frames=out, masks=masks)


def directions(points: Array, start: float) -> Array:
    """Angle (T,) [rad] of the motion of `points` (T, 2); `start` before any motion."""
    n = len(points)
    angle, angles = start, []
    for i in range(n):
        step = points[min(i + 1, n - 1)] - points[max(i - 1, 0)]
        if np.hypot(*step) > _STILL_PX:
            angle = float(np.arctan2(step[1], step[0]))
        angles.append(angle)
    return np.array(angles)


def line_kernel(length_px: float, angle: float) -> NDArray[np.float32]:
    """A centred line of a length [px] and direction [rad] as a kernel of sum 1: the way light falls along it."""
    half = int(np.ceil(length_px / 2)) + 1
    kernel = np.zeros((2 * half + 1, 2 * half + 1))
    count = max(1, round(_SAMPLES_PX * length_px))
    s = ((np.arange(count) + 0.5) / count - 0.5) * length_px
    x, y = half + s * np.cos(angle), half + s * np.sin(angle)
    u, v = np.floor(x).astype(int), np.floor(y).astype(int)
    for du, wu in ((0, 1 - (x - u)), (1, x - u)):
        for dv, wv in ((0, 1 - (y - v)), (1, y - v)):
            np.add.at(kernel, (v + dv, u + du), wu * wv)
    return np.asarray(kernel / kernel.sum(), dtype=np.float32)


def ghost(frames: Frames, masks: Masks, rng: np.random.Generator, weight: float) -> Seen:
    """Let the two frames before shine through with `weight` (0..1) together, as blending of frames does."""
    past = [frames[np.maximum(np.arange(len(frames)) - lag, 0)].astype(np.float32) for lag in (1, 2)]
    return Seen(frames=to_bytes((1 - weight) * frames + weight * (past[0] + past[1]) / 2), masks=masks)
