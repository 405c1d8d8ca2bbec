"""The gripper bent as video models bend it: a smooth warp of its pixels that no rigid motion explains."""

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.grounding.evaluation.perturbation.seen import Frames, Masks, Seen, centroids, turning

_NODES = 5  # of the field across the gripper
_PERIOD = 8  # frames in which the field becomes another one
_MIN_PX = 20


def deform(frames: Frames, masks: Masks, rng: np.random.Generator, rms_px: float) -> Seen:
    """Warp the gripper so that its pixels move by `rms_px`, root mean square over its mask in every frame.

    What a shift, a turn or another size would explain is taken out of the field, so that the true pose stays the one
    that fits best. Off the gripper the warp fades away.
    """
    nodes = turning(rng, len(frames), _PERIOD, (_NODES, _NODES, 2))
    middle = centroids(masks)
    out = frames.copy()
    for i, mask in enumerate(masks):
        if mask.sum() >= _MIN_PX:
            shift = displacement(mask, nodes[i], middle[i], rms_px)
            v, u = np.mgrid[0 : mask.shape[0], 0 : mask.shape[1]].astype(np.float32)
            x, y = u + shift[..., 0].astype(np.float32), v + shift[..., 1].astype(np.float32)
            out[i] = cv2.remap(frames[i], x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return Seen(frames=out, masks=masks)


def displacement(mask: NDArray[np.bool_], nodes: Array, middle: Array, rms_px: float) -> Array:
    """Where each pixel (H, W) looks instead, as an offset (H, W, 2) [px].

    Args:
        mask: (H, W) the gripper.
        nodes: (n, n, 2) the field on a grid over the gripper, of any size.
        middle: (2,) of the mask [px].
        rms_px: root mean square of the offsets over the mask [px].
    """
    v, u = np.nonzero(mask)
    reach = 1.1 * max(float(np.abs(u - middle[0]).max()), float(np.abs(v - middle[1]).max()), 4.0)
    height, width = mask.shape
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    n = len(nodes)
    at = [((a - m) / reach + 1.0) * (n - 1) / 2 for a, m in ((x, middle[0]), (y, middle[1]))]
    smooth = cv2.resize(nodes.astype(np.float32), (16 * n, 16 * n), interpolation=cv2.INTER_CUBIC)
    maps = [((a + 0.5) * 16 - 0.5).astype(np.float32) for a in at]
    field = np.asarray(
        cv2.remap(smooth, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), dtype=np.float64
    )
    here = np.stack([x - middle[0], y - middle[1]], axis=-1).astype(np.float64)
    field -= _similarity(here[mask], field[mask], here)
    field *= rms_px / max(float(np.sqrt((field[mask] ** 2).sum(axis=1).mean())), 1e-9)
    return field * _window(mask, reach)[..., None]


def _similarity(where: Array, moved: Array, everywhere: Array) -> Array:
    """The part of offsets `moved` (n, 2) at points `where` (n, 2) that shift, turn and size explain, at all points."""
    (x, y), one, none = where.T, np.ones(len(where)), np.zeros(len(where))
    A = np.concatenate([np.stack([one, none, x, -y], axis=1), np.stack([none, one, y, x], axis=1)])
    a, b, size, turn = np.linalg.lstsq(A, moved.T.reshape(-1), rcond=None)[0]
    x, y = everywhere[..., 0], everywhere[..., 1]
    return np.stack([a + size * x - turn * y, b + size * y + turn * x], axis=-1)


def _window(mask: NDArray[np.bool_], reach: float) -> Array:
    """1 on the gripper, falling smoothly to 0 within a third of its reach."""
    away = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 3)
    return np.asarray(0.5 + 0.5 * np.cos(np.pi * np.clip(away / (reach / 3), 0.0, 1.0)), dtype=np.float64)
