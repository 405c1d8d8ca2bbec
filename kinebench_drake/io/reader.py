"""Reading of a video from any kind of storage: containers, frame folders, arrays, HDF5, parquet."""

import io
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.io.container import read_container
from kinebench_drake.io.files import VIDEO_SUFFIXES, absence
from kinebench_drake.io.frames import collect_frames, require_frames
from kinebench_drake.io.hdf5 import HDF5_SUFFIXES, read_hdf5
from kinebench_drake.io.images import decode_image, read_folder
from kinebench_drake.io.npz import StoredArray, open_npy, open_npz
from kinebench_drake.io.parquet import open_batches
from kinebench_drake.io.video import WHOLE, Video, VideoPart

ARRAY_SUFFIXES = frozenset({".npy", ".npz"})
PARQUET_SUFFIXES = frozenset({".parquet"})

_KEYS = ("frames", "video")
"""Default names of the frames in an npz file, in order of preference."""


def read_array(path: Path, part: VideoPart) -> Video:
    """Read an npy file, or an array of an npz file: that of `part`, else `frames`, `video` or the only one.

    Raises:
        InputError: the file is damaged, or the array is not (T, H, W, 3) uint8.
    """
    try:
        if path.suffix.lower() == ".npy":
            with open_npy(path) as array:
                return _read_rows(path.name, array)
        with open_npz(path) as archive, archive.open(_choose_array(archive.files, part.key)) as array:
            return _read_rows(path.name, array)
    except InputError as error:
        raise InputError(f"{path.name}: {str(error).removeprefix(f'{path.name}: ')}") from None


def _read_rows(name: str, array: StoredArray) -> Video:
    require_frames(name, array.shape, array.dtype)
    images = ((f"{name}: frame {k}", image) for k, image in enumerate(array.rows()))
    return Video(frames=collect_frames(name, images), fps=None, stamps_s=None)


def is_video_array(path: Path) -> bool:
    """Return whether an npy or npz file holds an array of the shape (T, H, W, 3), by its header."""
    try:
        if path.suffix.lower() == ".npy":
            with open_npy(path) as array:
                shapes = [array.shape]
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
    frames = collect_frames(path.name, _parquet_images(path, part.key, part.episode))
    if part.frames is not None and len(frames) != part.frames:
        raise InputError(
            f"{path.name}: has {len(frames)} frames of episode {part.episode}, its metadata says {part.frames}"
        )
    return Video(frames=frames, fps=None, stamps_s=None)


def _parquet_images(path: Path, key: str, episode: int) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    """Read the images of an episode a few at a time, from the row groups that may hold it."""
    count = 0
    with open_batches(path, (key,), where=("episode_index", episode)) as (_, batches):
        for batch in batches:
            for row in batch.column(key).to_pylist():
                data = row.get("bytes") if isinstance(row, dict) else None
                if not isinstance(data, bytes):
                    raise InputError(f"{path.name}: {key} holds no image in frame {count}")
                yield f"{path.name}: frame {count}", decode_image(io.BytesIO(data))
                count += 1
    if not count:
        raise InputError(f"{path.name}: has 0 frames of episode {episode}")


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
