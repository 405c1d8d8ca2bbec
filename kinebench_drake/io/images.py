"""Image files, and folders of them that are videos."""

import re
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from kinebench_drake.errors import InputError, cause
from kinebench_drake.io.files import IMAGE_SUFFIXES, open_file
from kinebench_drake.io.frames import MAX_PIXELS, collect_frames
from kinebench_drake.io.video import Video

_SIDE_NAME = re.compile(r"(?<![a-z])(depth|disparity|mask|segmentation)(?![a-z])", re.IGNORECASE)
"""Words in the names of pictures beside colour pictures."""
_BIT_DEPTH = 24
"""Place of the bit depth in a png file, before the type of its colours (section 11.2.1 of the format) [bytes]."""
_GREY_16_BIT = bytes([16, 0])
_FORMATS = ("PNG", "JPEG", "WEBP", "BMP")  # whatever the suffix; other formats may start programs or read other files
_DAMAGED = (
    *(OSError, ValueError, SyntaxError, EOFError, MemoryError, TypeError, IndexError, KeyError, OverflowError),
    *(RuntimeError, ZeroDivisionError, AttributeError, struct.error, zlib.error),
    Image.DecompressionBombError,
)
"""Exceptions that Pillow raises for damaged files."""


def natural_key(name: str) -> list[tuple[int, str]]:
    """Return a sort key for natural order: frame_2.png before frame_10.png."""
    numbers = (part.lstrip("0") if k % 2 else part for k, part in enumerate(re.split(r"(\d+)", name)))
    return [(len(part) if k % 2 else 0, part) for k, part in enumerate(numbers)]


def frame_files(folder: Path) -> list[Path]:
    """Return the frames of a folder in natural order; of colour pictures with others beside them the former."""
    return _split_pictures(folder)[0]


def side_files(folder: Path) -> list[Path]:
    """Return the pictures of depth or masks beside the colour pictures of a folder, in natural order."""
    return _split_pictures(folder)[1]


def _split_pictures(folder: Path) -> tuple[list[Path], list[Path]]:
    """Return the frames of a folder, and the other pictures; where all are of one kind they are the frames."""
    files = [p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith(".")]
    files = sorted(files, key=lambda p: (natural_key(p.name), p.name))
    others = [file for file in files if _is_side_picture(file)]
    if len(others) == len(files):
        return files, []
    return [file for file in files if file not in set(others)], others


def _is_side_picture(file: Path) -> bool:
    """Return whether a picture shows depth or a mask: by a word of its name, or as a png of 16-bit grey."""
    if _SIDE_NAME.search(file.stem):
        return True
    if file.suffix.lower() != ".png":
        return False
    try:
        with open_file(file) as stream:
            return stream.read(_BIT_DEPTH + 2)[_BIT_DEPTH:] == _GREY_16_BIT
    except OSError:
        return False


@contextmanager
def _open_stream(file: IO[bytes]) -> Iterator[Image.Image]:
    """Open an encoded image with Pillow."""
    try:
        with Image.open(file, formats=_FORMATS) as image:
            if image.width * image.height > MAX_PIXELS:
                raise ValueError(f"{image.width} x {image.height} pixels, at most {MAX_PIXELS} are accepted")
            yield image
    except _DAMAGED as error:
        raise ValueError(f"no readable png or jpg ({cause(error)})") from None


def _rgb(image: Image.Image) -> NDArray[np.uint8]:
    """Return an image as (H, W, 3) RGB; of 16-bit grey the upper 8 bits, which Pillow would clip to white."""
    if image.mode.startswith("I"):
        image = Image.fromarray((np.asarray(image) >> 8).astype(np.uint8))
    return np.asarray(image.convert("RGB"), dtype=np.uint8)


def decode_image(file: IO[bytes]) -> NDArray[np.uint8]:
    """Decode an image to (H, W, 3) RGB."""
    with _open_stream(file) as image:
        return _rgb(image)


@contextmanager
def open_image(path: Path) -> Iterator[Image.Image]:
    """Open an image file with Pillow.

    Raises:
        InputError: it is not a readable image, or a very large one.
    """
    try:
        with open_file(path) as file, _open_stream(file) as image:
            yield image
    except (OSError, ValueError) as error:
        raise InputError(f"{path.parent.name}/{path.name}: not a readable image ({cause(error)})") from None


def read_image(path: Path) -> NDArray[np.uint8]:
    """Read an image file as (H, W, 3) RGB."""
    with open_image(path) as image:
        return _rgb(image)


def read_folder(folder: Path) -> Video:
    """Read the frames of a folder in natural order.

    Raises:
        InputError: there are none, or one is damaged or of another size.
    """
    files = frame_files(folder)
    if not files:
        raise InputError(f"{folder.name}: the folder holds no png or jpg frames")
    images = ((f"{folder.name}/{file.name}", read_image(file)) for file in files)
    return Video(frames=collect_frames(folder.name, images), fps=None, stamps_s=None)
