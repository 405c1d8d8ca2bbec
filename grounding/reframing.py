"""From a video, its camera and the picture it was begun with to frames that a camera can be given for."""

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.grounding.alignment import align
from kinebench_drake.grounding.bars import find_bars
from kinebench_drake.grounding.decoded import MIN_SIDE_PX
from kinebench_drake.grounding.framing import SQUARE, Framing


def find_framing(frames: NDArray[np.uint8], camera: Camera, picture: NDArray[np.uint8] | None) -> Framing:
    """Where a camera's picture is in the frames of a video.

    The first frame tells, where it shows the picture that the video was begun with; a camera of exactly the video's
    size, and not the picture's, is the video's own. Else a video of the camera's shape is the camera's picture scaled,
    and one of another shape has bars around it, or cannot be measured.

    Args:
        frames: (T, H, W, 3) RGB.
        camera: of the picture, at any size of the same shape, or of the video.
        picture: (h, w, 3) RGB, the first frame that the video's maker was given; None if unknown.

    Raises:
        UnmeasurableError: the shapes differ, and nothing tells what was cut off or added.
    """
    video, taken = (frames.shape[2], frames.shape[1]), (camera.width, camera.height)
    filled = Framing.filling(taken, video)
    same = abs(filled.scale_x / filled.scale_y - 1.0) <= SQUARE
    framing: Framing | None = None
    if picture is not None and _shows(camera, picture) and (taken != video or taken == picture.shape[1::-1]):
        framing = align(picture, frames[0])
    if framing is None and same:
        return filled
    framing = framing or find_bars(frames, taken)
    if framing is None:
        sought = (
            "no bars of one colour were found around a picture of the camera's shape"
            if picture is None
            else "neither the first frame's picture nor bars were found in it"
        )
        raise UnmeasurableError(
            f"camera is {camera.width} x {camera.height}, the video {video[0]} x {video[1]}: the aspect ratios differ, "
            f"and {sought}; give the video's own camera.json, or the picture it was begun with (first_frame)"
        )
    rows, columns = framing.window
    sides = columns.stop - columns.start, rows.stop - rows.start
    if min(sides) < MIN_SIDE_PX:
        raise UnmeasurableError(f"shows {sides[0]} x {sides[1]} px between its bars, each side needs {MIN_SIDE_PX} px")
    return framing


def _shows(camera: Camera, picture: NDArray[np.uint8]) -> bool:
    """Whether the camera is the picture's: its shape is."""
    height, width = picture.shape[:2]
    return bool(abs(camera.width * height / (camera.height * width) - 1.0) <= SQUARE)
