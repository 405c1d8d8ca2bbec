"""Videos as arrays, whatever they are stored as."""

from collections.abc import Callable, Mapping
from pathlib import Path

from kinebench_drake.errors import InputError
from kinebench_drake.filetypes import FILM_SUFFIXES
from kinebench_drake.grounding.array_file import ARRAY_SUFFIXES, read_array
from kinebench_drake.grounding.decoded import WHOLE, Video, VideoPart
from kinebench_drake.grounding.film import read_film
from kinebench_drake.grounding.frame_folder import read_folder
from kinebench_drake.grounding.hdf5_file import HDF5_SUFFIXES, read_hdf5
from kinebench_drake.grounding.parquet_file import PARQUET_SUFFIXES, read_parquet

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
