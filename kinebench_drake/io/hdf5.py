"""HDF5 files that anybody may have written: only what lies in the file itself is read, and only if it is there."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.io.files import open_file

DAMAGED = (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError, IndexError, MemoryError)
"""What h5py raises over files that are not what they seem."""


@contextmanager
def open_hdf5(path: Path) -> Iterator[h5py.File]:
    """A file to read from.

    Raises:
        ValueError: it is empty, or no HDF5 file.
        OSError: it cannot be read; one of DAMAGED where more is wrong.
    """
    with open_file(path) as raw:
        if not raw.seek(0, 2):
            raise ValueError("the file is empty (0 bytes)")
    try:
        file = h5py.File(path, "r")
    except DAMAGED as error:
        raise ValueError(f"not a readable HDF5 file ({str(error).splitlines()[0]})") from None
    with file:
        yield file


def is_own(data: h5py.Dataset) -> bool:
    """Whether a data set's numbers lie in the file itself, not in another that it names, and are there at all."""
    if data.is_virtual or data.external or data.shape is None:
        return False
    return not data.size or bool(data.id.get_storage_size())


def read_all(data: h5py.Dataset, most_bytes: int) -> NDArray[np.generic]:
    """All of a data set.

    Raises:
        ValueError: it is not in the file, or too large.
    """
    if not is_own(data):
        raise ValueError("its numbers are not in the file")
    if data.size * data.dtype.itemsize > most_bytes:
        raise ValueError(
            f"it takes {data.size * data.dtype.itemsize / 2**20:.0f} MiB, at most {most_bytes >> 20} are taken"
        )
    return np.asarray(data[()])
