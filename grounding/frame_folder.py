"""Folders of frames as arrays, through Pillow."""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from kinebench_drake.errors import InputError, cause
from kinebench_drake.grounding.decoded import Video, check_size

FRAME_SUFFIXES = frozenset({".png", ".jpg", ".jpeg"})


def frame_files(folder: Path) -> list[Path]:
    """The frames of a folder in natural order: frame_2.png before frame_10.png."""
    files = [p for p in folder.iterdir() if p.suffix.lower() in FRAME_SUFFIXES and not p.name.startswith(".")]
    return sorted(files, key=lambda p: ([int(s) if s.isdigit() else s for s in re.split(r"(\d+)", p.name)], p.name))


def read_picture(path: Path) -> NDArray[np.uint8]:
    """A picture (H, W, 3) RGB.

    Raises:
        InputError: it is no readable picture.
    """
    try:
        with Image.open(path) as picture:
            return np.asarray(picture.convert("RGB"), dtype=np.uint8)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise InputError(f"{path.parent.name}/{path.name}: not a readable image ({cause(error)})") from None


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
        check_size(folder, image.nbytes * (len(images) + 1))
        images.append(image)
    return Video(frames=np.stack(images), fps=None, stamps_s=None)
