"""Reading of a video from any kind of storage: containers, frame folders, arrays, HDF5, parquet."""

import io
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np
import pyarrow
import pyarrow.parquet as parquet
from numpy.typing import NDArray

from kinebench_drake.errors import InputError, cause
from kinebench_drake.io.container import read_container
from kinebench_drake.io.files import VIDEO_SUFFIXES, absence
from kinebench_drake.io.hdf5 import HDF5_SUFFIXES, read_hdf5
from kinebench_drake.io.images import decode_image, read_folder
from kinebench_drake.io.npz import npy_shape, open_npz, read_npy
from kinebench_drake.io.video import WHOLE, Video, VideoPart, check_size, stack_frames

ARRAY_SUFFIXES = frozenset({".npy", ".npz"})
PARQUET_SUFFIXES = frozenset({".parquet"})

_KEYS = ("frames", "video")
"""Default names of the frames in an npz file, in order of preference."""


def read_array(path: Path, part: VideoPart) -> Video:
    """Read an npy file, or an array of an npz file: that of `part`, else `frames`, `video` or the only one.

    Raises:
        InputError: the file is damaged, or the array is not (T, H, W, 3) uint8.
    """
    check = partial(check_size, "the array")
    try:
        if path.suffix.lower() == ".npy":
            frames = read_npy(path, check)
        else:
            with open_npz(path, check) as archive:
                frames = archive[_choose_array(archive.files, part.key)]
        return Video(frames=cast(NDArray[np.uint8], np.ascontiguousarray(frames)), fps=None, stamps_s=None)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from None


def is_video_array(path: Path) -> bool:
    """Return whether an npy or npz file holds an array of the shape (T, H, W, 3), by its header."""
    try:
        if path.suffix.lower() == ".npy":
            shapes = [npy_shape(path)]
        else:
            with open_npz(path) as archive:
                shapes = [archive.shape(name) for name in archive.files]
    except InputError:
        return False
    return any(len(shape) == 4 and shape[3] == 3 for shape in shapes)


def _choose_array(names: list[str], key: str | None) -> str:
    if key is not None:
        if key not in names:
            raise InputError(f"has no array {key!r} ($camera_key), but {', '.join(names)}")
        return key
    if len(names) == 1:
        return names[0]
    default = next((name for name in _KEYS if name in names), None)
    if default is None:
        raise InputError(f"holds {names}, expected one array or one named 'frames'; $camera_key NAME chooses one")
    return default


def read_parquet(path: Path, part: VideoPart) -> Video:
    """Read the images of an episode from a column of structs with a field `bytes` (LeRobot).

    Raises:
        InputError: the file is damaged, or holds no such images.
    """
    if part.key is None or part.episode is None:
        raise InputError(f"{path.name}: a parquet file is a video only as part of a LeRobot dataset; name its folder")
    try:
        frames = stack_frames(path.name, _parquet_images(path, part.key, part.episode))
    except (OSError, ValueError, TypeError, MemoryError, pyarrow.ArrowException) as error:
        reason = cause(error).replace(str(path), path.name)
        raise InputError(f"{path.name}: the images of {part.key} cannot be read ({reason})") from None
    if part.frames is not None and len(frames) != part.frames:
        raise InputError(
            f"{path.name}: has {len(frames)} frames of episode {part.episode}, its metadata says {part.frames}"
        )
    return Video(frames=frames, fps=None, stamps_s=None)


def _parquet_images(path: Path, key: str, episode: int) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    filters = [("episode_index", "==", episode)]
    rows = parquet.read_table(path, columns=[key], filters=filters).column(key).to_pylist()
    if not rows:
        raise InputError(f"{path.name}: has 0 frames of episode {episode}")
    for k, row in enumerate(rows):
        data = row.get("bytes") if isinstance(row, dict) else None
        if not isinstance(data, bytes):
            raise InputError(f"{path.name}: {key} holds no image in frame {k}")
        yield f"{path.name}: frame {k}", decode_image(io.BytesIO(data))


READERS: Mapping[str, Callable[[Path, VideoPart], Video]] = {
    **dict.fromkeys(VIDEO_SUFFIXES, read_container),
    **dict.fromkeys(ARRAY_SUFFIXES, read_array),
    **dict.fromkeys(HDF5_SUFFIXES, read_hdf5),
    **dict.fromkeys(PARQUET_SUFFIXES, read_parquet),
}
"""Reader of a file by its suffix in lower case; files with other suffixes are tried as containers."""


def read_video(path: Path, part: VideoPart = WHOLE) -> Video:
    """Decode a video file, a frame folder (png or jpg in natural order), an npy, npz or HDF5 file, or a part of one.

    Raises:
        InputError: the file is absent, empty, damaged, cut off, or not of the format that its name says.
    """
    if path.is_dir():
        return read_folder(path)
    if not path.is_file():
        raise InputError(f"{path.name}: {absence(path)}")
    if path.stat().st_size == 0:
        raise InputError(f"{path.name}: the file is empty (0 bytes)")
    return READERS.get(path.suffix.lower(), read_container)(path, part)
