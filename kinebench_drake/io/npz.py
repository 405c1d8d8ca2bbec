"""npy and npz files from untrusted sources, read without pickle and within size limits; reproducible npz files."""

import io
import lzma
import math
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np
from numpy.lib.format import read_array_header_1_0, read_array_header_2_0, read_magic
from numpy.typing import NDArray

from kinebench_drake.errors import InputError, cause
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.io.files import open_file

MOST_BYTES = 2**31
"""Default limit of an array [bytes]."""

_DAMAGED = (
    *(OSError, ValueError, EOFError, MemoryError, RuntimeError, OverflowError, TypeError, KeyError, SyntaxError),
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, tokenize.TokenError),
)
"""Exceptions that NumPy and zipfile raise for damaged files."""
_HEADERS = {(1, 0): read_array_header_1_0, (2, 0): read_array_header_2_0}


class Archive:
    """Open npz file."""

    def __init__(self, raw: zipfile.ZipFile, most: int) -> None:
        self._raw = raw
        self._most = most
        self._entries = {entry.filename.removesuffix(".npy"): entry for entry in raw.infolist()}
        self.files = list(self._entries)
        """Names of the arrays."""

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of an array without loading it."""
        with self.open(name) as array:
            return array.shape

    @contextmanager
    def open(self, name: str) -> Iterator["StoredArray"]:
        """Open an array without loading it."""
        with self._raw.open(self._entries[name]) as file:
            yield StoredArray(file, self._entries[name].file_size)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return an array.

        Raises:
            InputError: it is pickled, too large, or its header announces more data than there are.
        """
        with self.open(name) as array:
            return array.load(self._most)


@contextmanager
def open_npz(path: Path, most: int = MOST_BYTES) -> Iterator[Archive]:
    """Open an npz file whose arrays may take at most `most` bytes each when they are loaded.

    Raises:
        InputError: it is absent or damaged; messages do not name it.
    """
    try:
        with open_file(path) as file:
            if not file.seek(0, 2):
                raise InputError("the file is empty (0 bytes)")
            if not zipfile.is_zipfile(file):
                raise InputError("is not a complete zip archive, expected an npz file as np.savez writes it")
            with zipfile.ZipFile(file) as raw:
                yield Archive(raw, most)
    except _DAMAGED as error:
        raise InputError(f"is not a readable npz archive ({cause(error)})") from None


class StoredArray:
    """Array in an open file that begins with its header."""

    def __init__(self, file: IO[bytes], size: int) -> None:
        """Read the header of an array that takes at most `size` bytes with it.

        Raises:
            InputError: the array is pickled, or larger than the file.
        """
        version = read_magic(file)
        if version not in _HEADERS:
            raise InputError(f"is of npy version {version[0]}.{version[1]}, expected 1.0 or 2.0")
        self._file = file
        self.shape, self._by_columns, self.dtype = _HEADERS[version](file)
        if self.dtype.hasobject:
            raise InputError("holds pickled Python objects, which are never loaded: save plain arrays")
        self.nbytes = math.prod(self.shape) * self.dtype.itemsize
        if min(self.shape, default=0) < 0 or self.nbytes > size:
            raise InputError(
                f"its header promises an array of shape {self.shape}, {self.nbytes} bytes, the file holds {size} "
                "bytes: it is damaged"
            )

    def load(self, most: int) -> NDArray[Any]:
        """Return the array.

        Raises:
            InputError: it takes more than `most` bytes, or the file ends before.
        """
        if self.nbytes > most:
            raise InputError(f"unpacks to {self.nbytes / 2**20:.0f} MiB; the limit is {most / 2**20:.0f} MiB")
        order: Literal["F", "C"] = "F" if self._by_columns else "C"
        return np.ndarray(self.shape, self.dtype, bytearray(self._read(self.nbytes)), order=order)

    def rows(self) -> Iterator[NDArray[Any]]:
        """Yield the array row by row, each read when it is asked for.

        Raises:
            InputError: the file ends before, or the array is stored by columns.
        """
        if self._by_columns:
            raise InputError("is in Fortran order; save np.ascontiguousarray(frames)")
        for _ in range(self.shape[0]):
            yield np.frombuffer(self._read(self.nbytes // self.shape[0]), self.dtype).reshape(self.shape[1:])

    def _read(self, size: int) -> bytes:
        data = self._file.read(size)
        if len(data) < size:
            raise InputError("is cut off")
        return data


@contextmanager
def open_npy(path: Path) -> Iterator[StoredArray]:
    """Open the array of an npy file without loading it.

    Raises:
        InputError: it is absent or damaged; messages do not name it.
    """
    try:
        with open_file(path) as file:
            if file.read(2) == b"PK":
                raise InputError("holds several arrays: an npz file is called .npz")
            size = file.seek(0, 2)
            file.seek(0)
            yield StoredArray(file, size)
    except _DAMAGED as error:
        raise InputError(f"is not a readable npy file ({cause(error)})") from None


def read_npy(path: Path, most: int = MOST_BYTES) -> NDArray[np.generic]:
    """Return the array of an npy file, which may take at most `most` bytes."""
    with open_npy(path) as array:
        return array.load(most)


def write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write an npz file; equal arrays give equal bytes."""
    write_atomically(path, pack_arrays(arrays))


def pack_arrays(arrays: Mapping[str, Any]) -> bytes:
    """Return the bytes of an npz file of arrays in the order of the mapping; equal arrays give equal bytes."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()
