"""Displacement of what moves in one clip against another clip of the same scene, by dense optical flow.

It needs neither camera nor pose, so it serves where no gripper can be tracked. What moves are the pixels that differ
from the median of the clip; their flow to the other clip counts if it ends at a like pixel and the flow back returns
(dense inverse search: Kroeger et al., ECCV 2016).
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.io.frames import Frames
from kinebench_drake.segments import evenly

# Chosen by hand; checked by `python -m benchmarks following --pairs FOLDER`.
_MOVING_GREY = 20.0
"""Difference from the median of the clip from which on a pixel moves [of 255]."""
_MEDIAN_FRAMES = 25
"""Frames of this median at most."""
_LEAST_MOVING = 1.5e-3
"""Least share of the pixels of a frame that move, where it is compared: 100 px of 320x192."""
_RETURN_PX = 1.5
"""Greatest distance at which the flow there and back ends from its start [px]."""
_ALIKE_GREY = 40.0
"""Greatest difference of grey between a pixel and its counterpart [of 255]."""
_MATCHED = 0.3
"""Least share of the moving pixels with a counterpart; else the frame is lost."""
_QUALITY = 60
"""JPEG quality of the second coding by which the error is measured."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Displacement:
    """Displacement of what moves in the N compared frames of a clip."""

    frames: NDArray[np.intp]
    """(N,) numbers of the frames in which enough moves."""
    distance_px: Array
    """(N,) median displacement, the error taken out; NaN where most of what moves has no counterpart."""
    error_px: float
    """Root mean square of the same between the clip and a second coding of it."""


def measure_displacement(clip: Frames, reference: Frames) -> Displacement:
    """Return where what moves in `reference` (T, H, W, 3) lies in a clip of as many frames and pixels."""
    moving = _find_moving(reference)
    frames = np.flatnonzero(moving.mean(axis=(1, 2)) >= _LEAST_MOVING)
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    distance_px = np.full(len(frames), np.nan)
    again_px = np.zeros(len(frames))
    for k, number in enumerate(frames):
        start = reference[number]
        distance_px[k] = _displace(flow, start, clip[number], moving[number])
        again_px[k] = np.nan_to_num(_displace(flow, start, recode(start), moving[number]))
    error_px = float(np.sqrt(np.mean(again_px**2))) if len(frames) else 0.0
    return Displacement(
        frames=frames, distance_px=np.sqrt(np.maximum(distance_px**2 - error_px**2, 0.0)), error_px=error_px
    )


def recode(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return an image (H, W, 3) after a second lossy coding."""
    coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), dtype=np.uint8)


def _find_moving(frames: Frames) -> NDArray[np.bool_]:
    """Return the pixels (T, H, W) that differ from the median of the clip, without single ones."""
    still = np.median([frames[k] for k in evenly(len(frames), _MEDIAN_FRAMES)], axis=0)
    square = np.ones((3, 3), np.uint8)
    masks = [(np.abs(frame - still).max(axis=-1) > _MOVING_GREY).astype(np.uint8) for frame in frames]
    return np.stack([cv2.morphologyEx(mask, cv2.MORPH_OPEN, square) > 0 for mask in masks])


def _displace(
    flow: cv2.DISOpticalFlow, start: NDArray[np.uint8], end: NDArray[np.uint8], moving: NDArray[np.bool_]
) -> float:
    """Return the median displacement [px] of the moving pixels (H, W) of one image in another; NaN if they are lost."""
    grey = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (start, end)]
    there = flow.calc(grey[0], grey[1], np.empty(0))
    back = flow.calc(grey[1], grey[0], np.empty(0))
    v, u = np.nonzero(moving)
    step = there[v, u]
    rows = np.clip(np.rint(v + step[:, 1]).astype(np.intp), 0, len(moving) - 1)
    columns = np.clip(np.rint(u + step[:, 0]).astype(np.intp), 0, moving.shape[1] - 1)
    change = np.abs(grey[1][rows, columns].astype(np.float64) - grey[0][v, u])
    returns = (np.linalg.norm(step + back[rows, columns], axis=1) <= _RETURN_PX) & (change <= _ALIKE_GREY)
    if returns.mean() < _MATCHED:
        return float("nan")
    return float(np.median(np.linalg.norm(step[returns], axis=1)))
