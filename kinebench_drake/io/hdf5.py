"""HDF5 files from untrusted sources: only data stored in the file itself is read, also as video frames."""

import io
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError, cause
from kinebench_drake.io.files import open_file
from kinebench_drake.io.frames import Image, collect_frames, require_frames
from kinebench_drake.io.images import decode_image, natural_key
from kinebench_drake.io.video import Video, VideoPart

HDF5_SUFFIXES = frozenset({".h5", ".hdf5"})
_DAMAGED = (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError, IndexError, MemoryError)
"""Exceptions that h5py raises for damaged files."""

_IMAGE_MAGIC = (b"\xff\xd8\xff", b"\x89PNG")
_MOST_ROW = 2**26
_MOST_CHUNK = 2**29
"""Most bytes of an encoded image, and of the values that are stored, and thus read, together."""


@contextmanager
def open_hdf5(path: Path, what: str = "its content") -> Iterator[h5py.File]:
    """Open a file for reading `what`; defects that are met within the context count, too.

    Raises:
        InputError: it is empty, no HDF5 file, cannot be read, or is damaged.
    """
    try:
        with open_file(path) as raw:
            if not raw.seek(0, 2):
                raise InputError(f"{path.name}: the file is empty (0 bytes)")
        file = h5py.File(path, "r")
    except _DAMAGED as error:
        reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
        raise InputError(f"{path.name}: not a readable HDF5 file ({reason})") from None
    try:
        with file:
            yield file
    except _DAMAGED as error:
        raise InputError(f"{path.name}: {what} cannot be read ({cause(error)})") from None


def is_own(data: h5py.Dataset) -> bool:
    """Return whether the values of a data set are stored in the file itself, not in another file that it names."""
    if data.is_virtual or data.external or data.shape is None:
        return False
    return not data.size or bool(data.id.get_storage_size())


def read_all(data: h5py.Dataset, most_bytes: int) -> NDArray[np.generic]:
    """Return all values of a data set.

    Raises:
        ValueError: they are not in the file, or too large.
    """
    if not is_own(data):
        raise ValueError("its numbers are not in the file")
    if data.size * data.dtype.itemsize > most_bytes:
        raise ValueError(
            f"it takes {data.size * data.dtype.itemsize / 2**20:.0f} MiB, at most {most_bytes >> 20} are accepted"
        )
    return np.asarray(data[()])


def list_hdf5_videos(path: Path) -> list[str]:
    """Return the names of the data sets that hold a video, in natural order; external links are not followed.

    Raises:
        InputError: the file is damaged.
    """
    names: list[str] = []

    def visit(name: str, item: object) -> None:
        readable = isinstance(name, str)  # names that are not valid text come as bytes
        if readable and isinstance(item, h5py.Dataset) and is_own(item) and (_is_frames(item) or _is_encoded(item)):
            names.append(name)

    with open_hdf5(path) as file:
        file.visititems(visit)
    return sorted(names, key=natural_key)


def read_hdf5(path: Path, part: VideoPart) -> Video:
    """Read the data set that `part` names, else the only one, as frames.

    Raises:
        InputError: the file is damaged, holds no such data set, or several and none is named.
    """
    key = part.key
    if key is None:
        names = list_hdf5_videos(path)
        if len(names) != 1:
            listing = ", ".join(names[:8]) or "none"
            raise InputError(f"{path.name}: holds {len(names)} videos ({listing}), expected one if none is named")
        (key,) = names
    with open_hdf5(path, key) as file:
        data = file.get(key)
        if not isinstance(data, h5py.Dataset) or not is_own(data):
            raise InputError(f"{path.name}: holds no data set {key!r} of its own")
        name = f"{path.name}: {key}"
        images = _decode(data) if _is_encoded(data) else _frames(name, data)
        frames = collect_frames(name, ((f"{name}: frame {k}", image) for k, image in enumerate(images)))
    return Video(frames=frames, fps=None, stamps_s=None)


def _is_frames(data: h5py.Dataset) -> bool:
    return bool(data.dtype == np.uint8 and data.ndim == 4 and data.shape[3] == 3 and data.shape[0])


def _is_encoded(data: h5py.Dataset) -> bool:
    """Return whether each row begins like an encoded image."""
    rows = data.ndim == 2 and data.dtype == np.uint8
    texts = data.ndim == 1 and (data.dtype.kind == "S" or h5py.check_vlen_dtype(data.dtype) == np.uint8)
    if not (rows or texts) or not data.shape[0]:
        return False
    _require_small_rows(data)
    return _bytes(data[0]).startswith(_IMAGE_MAGIC)


def _require_small_rows(data: h5py.Dataset) -> None:
    """Check before reading how much a row of a data set takes, and the chunk that holds it."""
    row, chunk = (math.prod(shape) * data.dtype.itemsize for shape in (data.shape[1:], data.chunks or ()))
    if row > _MOST_ROW or chunk > _MOST_CHUNK:
        raise ValueError(
            f"the rows of {data.name} take {row / 2**20:.0f} MiB, its chunks {chunk / 2**20:.0f} MiB; at most "
            f"{_MOST_ROW >> 20} and {_MOST_CHUNK >> 20} are accepted"
        )


def _bytes(row: object) -> bytes:
    return row if isinstance(row, bytes) else np.asarray(row).tobytes()


def _decode(data: h5py.Dataset) -> Iterator[Image]:
    return (decode_image(io.BytesIO(_bytes(data[k]))) for k in range(data.shape[0]))


def _frames(name: str, data: h5py.Dataset) -> Iterator[Image]:
    """Read frames, together those that share chunks."""
    require_frames(name, data.shape, data.dtype)
    _require_small_rows(data)
    depth = min(data.chunks[0] if data.chunks else 1, _MOST_CHUNK // data[0].nbytes)
    for start in range(0, data.shape[0], depth):
        yield from data[start : start + depth]
