"""Arrays made wrong: types, shapes and values, headers that lie, pickled objects that would act if loaded."""

import io
import os
import zipfile
import zlib
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from kinebench_drake.validation.fuzz.octets import mutate_bytes

MARK = "pickle-was-loaded"
"""Folder that a pickled object makes where it is loaded."""
_TYPES = ("f2", "f4", "f8", "g", "i1", "u1", "i8", "u8", "?", "c16", "S3", "U4", "M8[s]", "m8[ns]", "V8", ">f8")
_VALUES = (np.nan, np.inf, -np.inf, 0.0, -1.0, 1e-320, 1e300, 1e9, 400.0, 3.3)
_BOMB_BYTES = 3 * 2**28
_LIES = ((10**9, 4, 4), (2**62,), (-1,), (10**9, 64, 64, 3), (0,), (2**31, 2**31), (10**7, 7), ())


class _Act:
    """Unpickled it makes a folder."""

    def __reduce__(self) -> tuple[Any, tuple[str]]:
        return os.mkdir, (MARK,)


def mutate_npz(rng: Generator, data: bytes) -> bytes:
    """An npz file after a change to one of its arrays, to its entries or to its bytes."""
    if rng.random() < 0.35:
        return mutate_bytes(rng, data)
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        entries = {f"{name}.npy": npy(archive[name]) for name in archive.files}
        names = archive.files
        chosen = names[int(rng.integers(len(names)))]
        array = archive[chosen]
    kind = rng.random()
    if kind < 0.08:
        del entries[f"{chosen}.npy"]
    elif kind < 0.14:
        entries[f"{odd_name(rng)}.npy"] = entries.pop(f"{chosen}.npy")
    elif kind < 0.20:
        entries[f"{names[int(rng.integers(len(names)))]}.npy"] = npy(array)
    else:
        entries[f"{chosen}.npy"] = _mutated(rng, array)
    return _zipped(rng, entries)


def mutate_npy(rng: Generator, data: bytes) -> bytes:
    """An npy file after a change to its array or to its bytes."""
    if rng.random() < 0.35:
        return mutate_bytes(rng, data)
    return _mutated(rng, np.load(io.BytesIO(data), allow_pickle=False))


def npy(array: NDArray[Any], *, pickled: bool = False) -> bytes:
    """An npy file."""
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.asarray(array), allow_pickle=pickled)
    return buffer.getvalue()


def odd_name(rng: Generator) -> str:
    """A name that no array, column or file is expected to have."""
    names = (
        "",
        "../x",
        "/x",
        "a/b",
        "q ",
        "T_S",
        "file",
        "f\x1b[2J",
        "é",
        "x" * 300,
        "\ud800",
        "two\nlines",
        "q",
        "t_s",
    )
    return names[int(rng.integers(len(names)))].encode(errors="replace").decode()


def mutate_array(rng: Generator, array: NDArray[Any]) -> NDArray[Any]:
    """An array of another type, shape or with other values."""
    kind = int(rng.integers(8))
    if kind == 0:
        return np.zeros(array.shape, dtype=_TYPES[int(rng.integers(len(_TYPES)))])
    if kind == 1:
        return array.T
    if kind == 2:
        return array[None] if rng.random() < 0.5 else array[..., None]
    if kind == 3:
        return array[: int(rng.integers(3))]
    if kind == 4:
        return np.asarray(array.reshape(-1)[0] if array.size else array)
    if kind == 5:
        return np.concatenate([array, array[:1]]) if array.ndim else array
    if kind == 6 and array.ndim and array.size:
        return np.asarray(array[int(rng.integers(len(array)))])
    changed = np.array(array, dtype=array.dtype if array.dtype.kind == "f" else np.float64, copy=True).reshape(-1)
    for _ in range(int(rng.integers(1, 4))):
        if changed.size:
            changed[int(rng.integers(changed.size))] = _VALUES[int(rng.integers(len(_VALUES)))]
    return changed.reshape(array.shape)


def _mutated(rng: Generator, array: NDArray[Any]) -> bytes:
    kind = rng.random()
    if kind < 0.08:
        return npy(np.array([_Act()], dtype=object), pickled=True)
    if kind < 0.16:
        return _lying(rng, array)
    if kind < 0.18:
        return npy(np.zeros(3, dtype=[("a", "f8"), ("b", "U3")]))
    if kind < 0.30:
        return mutate_bytes(rng, npy(array))
    with np.errstate(all="ignore"):
        return npy(mutate_array(rng, array) if array.dtype.kind in "biuf" else np.zeros((2, 2)))


def _lying(rng: Generator, array: NDArray[Any]) -> bytes:
    """An npy file whose header tells of more than is there, or is no header."""
    shape = _LIES[int(rng.integers(len(_LIES)))]
    headers = (
        f"{{'descr': '{array.dtype.str}', 'fortran_order': {bool(rng.integers(2))}, 'shape': {shape!r}, }}",
        f"{{'descr': '{array.dtype.str}', 'fortran_order': False, 'shape': {'(' * 500}",
        "__import__('os').mkdir('" + MARK + "')",
        "{'descr': '|O', 'fortran_order': False, 'shape': (1,), }",
        "{'descr': [('a', [('b', '<f8', (1000000000,))])], 'fortran_order': False, 'shape': (2,), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (3.5,), }",
        "{'descr': '<f8', 'shape': (3,), }",
    )
    header = headers[0 if rng.random() < 0.6 else int(rng.integers(len(headers)))].encode()
    return b"\x93NUMPY\x01\x00" + (len(header) + 1).to_bytes(2, "little") + header + b"\n" + array.tobytes()[:4096]


def _zipped(rng: Generator, entries: dict[str, bytes]) -> bytes:
    """A zip archive, now and then one that lies about what is in it."""
    buffer = io.BytesIO()
    method = int(rng.choice([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA]))
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, data in entries.items():
            archive.writestr(zipfile.ZipInfo(name.replace("\0", "") or "x"), data, compress_type=method)
    kind, data = rng.random(), buffer.getvalue()
    if kind < 0.01:
        return _bomb(next(iter(entries), "t_s.npy"))
    if kind < 0.06:  # sizes in the central directory
        at = data.rfind(b"PK\x01\x02")
        return data[: at + 20] + b"\xff\xff\xff\x7f\xff\xff\xff\x7f" + data[at + 28 :]
    return data


@lru_cache(maxsize=8)
def _bomb(name: str) -> bytes:
    """A small archive with a very large array of zeros."""
    text = io.BytesIO()
    np.lib.format.write_array_header_1_0(text, {"descr": "<f8", "fortran_order": False, "shape": (_BOMB_BYTES // 8,)})
    header = text.getvalue()
    pack = zlib.compressobj(9, zlib.DEFLATED, -15)
    chunk = b"\0" * 2**20
    crc, parts = zlib.crc32(header), [pack.compress(header)]
    for _ in range(_BOMB_BYTES // len(chunk)):
        crc = zlib.crc32(chunk, crc)
        parts.append(pack.compress(chunk))
    packed = b"".join([*parts, pack.flush()])
    size = len(header) + _BOMB_BYTES
    title = name.encode()
    sizes = crc.to_bytes(4, "little") + len(packed).to_bytes(4, "little") + size.to_bytes(4, "little")
    common = b"\x14\0\0\0\x08\0\0\0\x21\0" + sizes + len(title).to_bytes(2, "little") + b"\0\0"
    local = b"PK\x03\x04" + common + title + packed
    central = b"PK\x01\x02\x14\0" + common + b"\0" * 14 + title
    end = b"PK\x05\x06\0\0\0\0\x01\0\x01\0" + len(central).to_bytes(4, "little") + len(local).to_bytes(4, "little")
    return local + central + end + b"\0\0"
