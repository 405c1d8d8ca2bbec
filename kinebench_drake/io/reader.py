"""One reader for videos in every kind of storage: containers, image folders, arrays, HDF5, parquet."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.io.container import read_film
from kinebench_drake.io.files import FILM_SUFFIXES
from kinebench_drake.io.frames import HDF5_SUFFIXES, PARQUET_SUFFIXES, read_folder, read_hdf5, read_parquet
from kinebench_drake.io.npz import open_npz, read_npy
from kinebench_drake.io.video import WHOLE, Video, VideoPart, check_size

ARRAY_SUFFIXES = frozenset({".npy", ".npz"})

_KEYS = ("frames", "video")


def read_array(path: Path, part: VideoPart) -> Video:
    """Read an npy file, or the array of an npz file that `part` names: else the one called frames, or the only one.

    Raises:
        InputError: the file is damaged, or the array is not (T, H, W, 3) uint8.
    """
    check = partial(check_size, "the array")
    try:
        if path.suffix.lower() == ".npy":
            frames = read_npy(path, check)
        else:
            with open_npz(path, check) as archive:
                frames = archive[_chosen(archive.files, part.key)]
        return Video(frames=cast(NDArray[np.uint8], np.ascontiguousarray(frames)), fps=None, stamps_s=None)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from None


def _chosen(names: list[str], key: str | None) -> str:
    if key is not None:
        if key not in names:
            raise InputError(f"has no array {key!r} (--camera-key), but {', '.join(names)}")
        return key
    if len(names) == 1:
        return names[0]
    found = [name for name in _KEYS if name in names]
    if not found:
        raise InputError(f"holds {names}, expected one array or one named 'frames'; --camera-key NAME chooses one")
    return found[0]


Reader = Callable[[Path, VideoPart], Video]

READERS: Mapping[str, Reader] = {
    **dict.fromkeys(FILM_SUFFIXES, read_film),
    **dict.fromkeys(ARRAY_SUFFIXES, read_array),
    **dict.fromkeys(HDF5_SUFFIXES, read_hdf5),
    **dict.fromkeys(PARQUET_SUFFIXES, read_parquet),
}
"""What reads a file, by its suffix in lower case; other files are tried as films."""


def read_video(path: Path, part: VideoPart = WHOLE) -> Video:
    """Decode a film, a folder of frames (png or jpg in natural order), an npy, npz or HDF5 file, or part of one.

    Raises:
        InputError: the file is absent, empty, damaged, cut off, or not what its name says.
    """
    if path.is_dir():
        return read_folder(path)
    if not path.is_file():
        raise InputError(f"{path.name}: there is no such file")
    if path.stat().st_size == 0:
        raise InputError(f"{path.name}: the file is empty (0 bytes)")
    return READERS.get(path.suffix.lower(), read_film)(path, part)
