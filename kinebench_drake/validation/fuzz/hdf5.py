"""HDF5 files made wrong: other types, sizes that nobody stored, links to elsewhere and nowhere."""

import io

import h5py
import numpy as np
from numpy.random import Generator

from kinebench_drake.validation.fuzz.arrays import mutate_array, odd_name
from kinebench_drake.validation.fuzz.octets import mutate_bytes

_HUGE = ((10**9, 9), (10**5, 10**6), (10**6, 64, 64, 3), (99_999, 9))


def mutate_hdf5(rng: Generator, data: bytes) -> bytes:
    """An HDF5 file after a change to one of its items, or to its bytes."""
    if rng.random() < 0.5:
        return mutate_bytes(rng, data)
    buffer = io.BytesIO(data)
    with h5py.File(buffer, "r+") as file:
        names: list[str] = []
        file.visit(names.append)
        name = names[int(rng.integers(len(names)))]
        held = file[name][()] if isinstance(file[name], h5py.Dataset) else np.zeros((4, 9))
        kind = int(rng.integers(15))
        del file[name]
        if kind == 1:
            file[odd_name(rng).strip("/.") or "x"] = held
        elif kind == 2:
            file.create_group(name)
        elif kind == 3:
            shape = _HUGE[int(rng.integers(len(_HUGE)))]
            file.create_dataset(name, shape=shape, dtype=held.dtype, chunks=tuple(min(n, 64) for n in shape))
        elif kind == 4:
            file[name] = h5py.ExternalLink("../outside.h5", "/secret")
        elif kind == 5:
            file[name] = h5py.SoftLink("/" if rng.random() < 0.3 else f"/{name}")
        elif kind == 6:
            layout = h5py.VirtualLayout(shape=(4, 9), dtype="f4")
            layout[:] = h5py.VirtualSource("outside.h5", "secret", shape=(4, 9))
            file.create_virtual_dataset(name, layout)
        elif kind == 7:
            file.create_dataset(name, data=["text"] * 4, dtype=h5py.string_dtype())
        elif kind == 8:
            file[name] = h5py.Empty("f4")
        elif kind == 9:
            file[name] = np.zeros(4, dtype=[("a", "f8"), ("b", "i4")])
        elif kind == 10:
            file[name] = np.dtype("f8")
        elif kind == 11:
            file.create_dataset(name, data=[file.ref] * 4, dtype=h5py.ref_dtype)
        elif kind == 12:
            rows = file.create_dataset(name, (4,), dtype=h5py.vlen_dtype(np.uint8))
            rows[0] = np.frombuffer(b"\x89PNG", dtype=np.uint8)
        elif kind == 13:
            file.create_dataset(name, shape=(4, 9), dtype="f4", external=[("/etc/hostname", 0, 144)])
        elif kind:
            array = np.asarray(held)
            file[name] = mutate_array(rng, array) if array.dtype.kind in "iuf" else np.zeros(0)
    return buffer.getvalue()
