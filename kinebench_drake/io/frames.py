"""Frames outside video containers: image folders, HDF5 data sets and parquet columns."""

import io
import re
import struct
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import h5py
import numpy as np
import pyarrow
import pyarrow.parquet as parquet
from numpy.typing import NDArray
from PIL import Image

from kinebench_drake.errors import InputError, cause
from kinebench_drake.io.files import FRAME_SUFFIXES, open_file
from kinebench_drake.io.hdf5 import DAMAGED, is_own, open_hdf5
from kinebench_drake.io.video import Video, VideoPart, check_size

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


HDF5_SUFFIXES = frozenset({".h5", ".hdf5"})

_CODED = (b"\xff\xd8\xff", b"\x89PNG")


def list_films(path: Path) -> list[str]:
    """Names of the data sets that hold a video, in natural order; links to other places are not followed.

    Raises:
        InputError: the file is damaged.
    """
    names: list[str] = []

    def visit(name: str, item: object) -> None:
        readable = isinstance(name, str)  # names in no encoding come as bytes
        if readable and isinstance(item, h5py.Dataset) and is_own(item) and (_is_frames(item) or _is_coded(item)):
            names.append(name)

    try:
        with open_hdf5(path) as file:
            file.visititems(visit)
    except DAMAGED as error:
        raise InputError(f"{path.name}: {cause(error)}") from None
    return sorted(names, key=natural)


def read_hdf5(path: Path, part: VideoPart) -> Video:
    """Read the data set that `part` names, else the only one.

    Raises:
        InputError: the file is damaged, holds no such data set, or several and none is named.
    """
    key = part.key
    if key is None:
        names = list_films(path)
        if len(names) != 1:
            told = ", ".join(names[:8]) or "none"
            raise InputError(f"{path.name}: holds {len(names)} videos ({told}), expected one where none is named")
        (key,) = names
    try:
        with open_hdf5(path) as file:
            data = file.get(key)
            if not isinstance(data, h5py.Dataset) or not is_own(data):
                raise InputError(f"{path.name}: holds no data set {key!r} of its own")
            frames = _decoded(path, data) if _is_coded(data) else _plain(path, data)
    except DAMAGED as error:
        raise InputError(f"{path.name}: {key} cannot be read ({cause(error)})") from None
    try:
        return Video(frames=frames, fps=None, stamps_s=None)
    except InputError as error:
        raise InputError(f"{path.name}: {key} {error}") from None


def _is_frames(data: h5py.Dataset) -> bool:
    return bool(data.dtype == np.uint8 and data.ndim == 4 and data.shape[3] == 3 and data.shape[0])


def _is_coded(data: h5py.Dataset) -> bool:
    """Whether each row begins like a coded picture."""
    rows = data.ndim == 2 and data.dtype == np.uint8
    texts = data.ndim == 1 and (data.dtype.kind == "S" or h5py.check_vlen_dtype(data.dtype) == np.uint8)
    return bool((rows or texts) and data.shape[0]) and _bytes(data[0]).startswith(_CODED)


def _bytes(row: object) -> bytes:
    return row if isinstance(row, bytes) else np.asarray(row).tobytes()


def _plain(path: Path, data: h5py.Dataset) -> NDArray[np.uint8]:
    check_size(path.name, data.size * data.dtype.itemsize)
    return np.ascontiguousarray(data[()])


def _decoded(path: Path, data: h5py.Dataset) -> NDArray[np.uint8]:
    images: list[NDArray[np.uint8]] = []
    for k in range(data.shape[0]):
        image = decode_picture(io.BytesIO(_bytes(data[k])))
        if images and image.shape != images[0].shape:
            raise InputError(f"{path.name}: frame {k} of {data.name} has shape {image.shape}, not {images[0].shape}")
        check_size(path.name, image.nbytes * (k + 1))
        images.append(image)
    return np.stack(images)


PARQUET_SUFFIXES = frozenset({".parquet"})


def read_parquet(path: Path, part: VideoPart) -> Video:
    """Read the pictures of a column, of one episode: structs with a field bytes.

    Raises:
        InputError: the file is damaged, or holds no such pictures.
    """
    if part.key is None or part.episode is None:
        raise InputError(f"{path.name}: a parquet file is a video only as part of a LeRobot dataset; name its folder")
    images: list[NDArray[np.uint8]] = []
    try:
        only = [("episode_index", "==", part.episode)]
        for row in parquet.read_table(path, columns=[part.key], filters=only).column(part.key).to_pylist():
            data = row.get("bytes") if isinstance(row, dict) else None
            if not isinstance(data, bytes):
                raise InputError(f"{path.name}: {part.key} holds no picture in frame {len(images)}")
            image = decode_picture(io.BytesIO(data))
            if images and image.shape != images[0].shape:
                raise InputError(f"{path.name}: frame {len(images)} has shape {image.shape}, not {images[0].shape}")
            check_size(path.name, image.nbytes * (len(images) + 1))
            images.append(image)
    except (OSError, ValueError, TypeError, MemoryError, pyarrow.ArrowException) as error:
        told = cause(error).replace(str(path), path.name)
        raise InputError(f"{path.name}: the pictures of {part.key} cannot be read ({told})") from None
    if not images or (part.frames is not None and len(images) != part.frames):
        told = "" if part.frames is None else f", its description tells {part.frames}"
        raise InputError(f"{path.name}: has {len(images)} frames of episode {part.episode}{told}")
    return Video(frames=np.stack(images), fps=None, stamps_s=None)
