"""Frames of a video: an array, which a temporary file holds where it takes more memory."""

import os
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import IO, TypeAlias

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError, cause
from kinebench_drake.io.progress import count_steps

Image: TypeAlias = NDArray[np.uint8]
"""(H, W, 3) RGB."""
Frames: TypeAlias = NDArray[np.uint8]
"""(T, H, W, 3) RGB."""
MAX_FRAMES = 2000
"""Most frames of a video: the measurements of each stay in memory, about 0.9 MB."""
MAX_PIXELS = 4096 * 4096
"""Most pixels of a frame: decoders hold up to 17 of them."""
MAX_BYTES = 2**34
"""Most bytes of all frames."""
MEMORY_BYTES = 2**29
"""Bytes of frames above which they are kept in a file, whose pages the system may take from memory."""
_ON_DISK = Path("/var/tmp")
"""Folder of large temporary files unless TMPDIR names one; /tmp often is a part of the memory."""


def require_frames(name: str, shape: tuple[int, ...], dtype: object) -> None:
    """Check that an array of this shape and type holds the frames of a video, called `name` in messages.

    Raises:
        InputError: it is not (T, H, W, 3) uint8, there are none, or they are too many or too large.
    """
    if dtype != np.uint8 or len(shape) != 4 or shape[3] != 3:
        hint = "; looks channel-first: transpose(0, 2, 3, 1)" if len(shape) == 4 and shape[1] == 3 else ""
        raise InputError(f"{name}: found {dtype} of shape {shape}, expected uint8 (T, H, W, 3) in RGB{hint}")
    if 0 in shape:
        raise InputError(f"{name}: holds no frame")
    require_size(name, shape)


def require_size(name: str, shape: tuple[int, ...]) -> None:
    """Refuse frames of a `shape` (T, H, W, 3) that are too many or too large, `name` being that of the video.

    Raises:
        InputError: they are.
    """
    count, height, width = shape[:3]
    if count > MAX_FRAMES:
        raise InputError(f"{name} has more than {MAX_FRAMES} frames; cut it into shorter clips")
    if height * width > MAX_PIXELS:
        raise InputError(f"{name} has frames of {width} x {height} pixels, at most {MAX_PIXELS} are accepted")
    if 3 * count * height * width > MAX_BYTES:
        raise InputError(f"{name} exceeds {MAX_BYTES / 2**30:.0f} GiB when decoded; cut it into shorter clips")


def collect_frames(name: str, images: Iterable[tuple[str, Image]]) -> Frames:
    """Collect images (H, W, 3), each with its name, as the frames of a video, called `name` in messages.

    Raises:
        InputError: there are none, they differ in size, are too many or too large, or the disk is full.
    """
    array = np.empty((0, 0, 0, 3), np.uint8)
    file = None
    count = 0
    for label, image in count_steps(images, "frames read"):
        if count and image.shape != array.shape[1:]:
            (height, width) = image.shape[:2]
            (first_height, first_width) = array.shape[1:3]
            raise InputError(f"{label}: size {width} x {height}, the first frame has {first_width} x {first_height}")
        require_size(name, (count + 1, *image.shape))
        if not count:  # pages of it that are never written take no memory
            array = np.empty((max(1, MEMORY_BYTES // image.nbytes), *image.shape), np.uint8)
        if count < len(array):
            array[count] = image
        else:
            file = file or _write_all(name, array)
            _write(name, file, image)
        count += 1
    if not count:
        raise InputError(f"{name}: holds no frame")
    if file is None:
        return array[:count]
    with file:  # the map keeps what it holds
        return np.memmap(file, np.uint8, "r+", shape=(count, *array.shape[1:])).view(np.ndarray)


def map_frames(frames: Frames, change: Callable[[int, Image], Image]) -> Frames:
    """Return the frames after a `change` of each, which also receives its number."""
    return collect_frames("the video", (("", change(k, frame)) for k, frame in enumerate(frames)))


def _write_all(name: str, array: Image) -> IO[bytes]:
    """Return a temporary file that begins with the frames of an array."""
    folder = None if "TMPDIR" in os.environ or not os.access(_ON_DISK, os.W_OK) else _ON_DISK
    try:
        file = tempfile.TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115 - closed once it is mapped
    except OSError as error:
        raise _full(name, error) from None
    _write(name, file, array)
    return file


def _write(name: str, file: IO[bytes], array: Image) -> None:
    data = np.ascontiguousarray(array).data.cast("B")
    try:
        while data:
            data = data[file.write(data) :]
    except OSError as error:
        raise _full(name, error) from None


def _full(name: str, error: OSError) -> InputError:
    return InputError(f"{name}: no temporary space for its frames ({cause(error)}); TMPDIR names another folder")
