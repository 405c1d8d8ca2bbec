"""Frames of a video put back into the shape of the picture that it was begun with, to look at and to compare."""

from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.grounding.framing import Framing

ImageType = TypeVar("ImageType", np.uint8, np.bool_)


def unframed(framing: Framing, images: NDArray[ImageType]) -> NDArray[ImageType]:
    """Images (T, h, w, ...) without their bars in the shape of the picture; 0 where it was cropped.

    They get the larger of the two scales, so that nothing of them is lost.
    """
    rows, columns = framing.window
    scale = max(framing.scale_x, framing.scale_y)
    size = round(framing.picture_width * scale), round(framing.picture_height * scale)
    if not framing.changes and size == (images.shape[2], images.shape[1]):
        return images
    M = framing.map - [[0.0, 0.0, columns.start], [0.0, 0.0, rows.start]]
    M[:, :2] /= scale
    M[:, 2] += 0.5 * np.diag(M) - 0.5  # OpenCV's centres are integers
    smooth = images.dtype != np.bool_
    flags = (cv2.INTER_LINEAR if smooth else cv2.INTER_NEAREST) | cv2.WARP_INVERSE_MAP
    source = images if smooth else images.astype(np.uint8)
    return np.stack([cv2.warpAffine(image, M, size, flags=flags) for image in source]).astype(images.dtype)
