"""Folders of frames as arrays, through Pillow."""

import re
import struct
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from kinebench_drake.errors import InputError, cause
from kinebench_drake.filetypes import FRAME_SUFFIXES
from kinebench_drake.grounding.decoded import Video, check_size
from kinebench_drake.plainfile import open_file

_FORMATS = ("PNG", "JPEG", "WEBP", "BMP")  # whatever they are called; others may start programs or read other files
_DAMAGED = (
    *(OSError, ValueError, SyntaxError, EOFError, MemoryError, TypeError, IndexError, KeyError, OverflowError),
    *(RuntimeError, ZeroDivisionError, AttributeError, struct.error, zlib.error),
    *(Image.DecompressionBombError, Image.DecompressionBombWarning),
)
"""What Pillow raises over files that are not what they seem."""


def natural(name: str) -> list[tuple[int, str]]:
    """By this key frame_2.png comes before frame_10.png."""
    parts = enumerate(re.split(r"(\d+)", name))
    numbers = (part.lstrip("0") if k % 2 else part for k, part in parts)
    return [(len(part) if k % 2 else 0, part) for k, part in enumerate(numbers)]


def frame_files(folder: Path) -> list[Path]:
    """The frames of a folder in natural order: frame_2.png before frame_10.png."""
    files = [p for p in folder.iterdir() if p.suffix.lower() in FRAME_SUFFIXES and not p.name.startswith(".")]
    return sorted(files, key=lambda p: (natural(p.name), p.name))


def decode_picture(file: IO[bytes]) -> NDArray[np.uint8]:
    """A picture (H, W, 3) RGB.

    Raises:
        ValueError: it is no readable picture, or a very large one.
    """
    with opened_picture(file) as picture:
        return np.asarray(picture.convert("RGB"), dtype=np.uint8)


@contextmanager
def opened_picture(file: IO[bytes]) -> Iterator[Image.Image]:
    """A picture as Pillow has it.

    Raises:
        ValueError: it is no readable picture, or a very large one.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(file, formats=_FORMATS) as picture:
                yield picture
    except _DAMAGED as error:
        raise ValueError(f"no readable png or jpg ({cause(error)})") from None


@contextmanager
def open_picture(path: Path) -> Iterator[Image.Image]:
    """A picture as Pillow has it.

    Raises:
        InputError: it is no readable picture, or a very large one.
    """
    try:
        with open_file(path) as file, opened_picture(file) as picture:
            yield picture
    except (OSError, ValueError) as error:
        raise InputError(f"{path.parent.name}/{path.name}: not a readable image ({cause(error)})") from None


def read_picture(path: Path) -> NDArray[np.uint8]:
    """A picture (H, W, 3) RGB.

    Raises:
        InputError: it is no readable picture.
    """
    with open_picture(path) as picture:
        return np.asarray(picture.convert("RGB"), dtype=np.uint8)


def read_folder(folder: Path) -> Video:
    """The frames of a folder in natural order.

    Raises:
        InputError: there are none, or one is damaged or of another size.
    """
    files = frame_files(folder)
    if not files:
        raise InputError(f"{folder.name}: the folder holds no png or jpg frames")
    images: list[NDArray[np.uint8]] = []
    for file in files:
        image = read_picture(file)
        if images and image.shape != images[0].shape:
            raise InputError(
                f"{folder.name}/{file.name}: size {image.shape[1]} x {image.shape[0]}, the first frame has "
                f"{images[0].shape[1]} x {images[0].shape[0]}"
            )
        check_size(folder.name, image.nbytes * (len(images) + 1))
        images.append(image)
    return Video(frames=np.stack(images), fps=None, stamps_s=None)
