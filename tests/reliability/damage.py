"""Damage: one file of a valid input made wrong in its bytes, JSON values, arrays, table columns or HDF5 items."""

import copy
import io
import json
import os
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path, PurePosixPath
from random import Random
from typing import Any

import h5py
import numpy as np
import pyarrow
import pyarrow.parquet as parquet

Tree = Mapping[str, bytes]
"""Content of the files of a folder, by relative path."""

PICKLE_MARK = Path(tempfile.gettempdir()) / f"kinebench-drake-pickle-loaded-{os.getpid()}"
"""Folder that a pickled object creates when it is loaded."""
VALUES: tuple[Any, ...] = (
    *(None, True, 0, -1, 3, 2**31, 2**63, -(2**63), 10**400, 0.5, 1e308, 1e-320, float("nan"), float("inf")),
    *("", " ", "nan", "1e999", "..", "/", "../../etc/passwd", "a\0b", "\x1b[2J", "two\nlines", "\ud800", "x" * 10_000),
    *("{episode_chunk:99999999999d}", "{x.__class__}", "v2.1", [], {}, [None], [[1, 2], [3]], [0] * 1000),
    *([[0.0] * 4] * 4, [float("nan")] * 7, {"bytes": "x"}),
)
"""JSON values of wrong types and sizes."""
NUMBERS = (np.nan, np.inf, -np.inf, 0.0, -1.0, 1e-320, 1e300, 1e9, 400.0)
TYPES = ("f2", "f4", "i1", "u8", "?", "c16", "S3", "U4", "M8[s]", "V8", ">f8")
SHAPES = ((10**9, 4, 4), (2**62,), (-1,), (10**9, 64, 64, 3), (0,), (2**31, 2**31), (10**7, 7), ())
NAMES = ("", "../x", "a/b", "T_S", "f\x1b[2J", "é", "x" * 300, "two\nlines", "q", "t_s")
CELLS = ("", "nan", "inf", "-1e999", "0x10", '"', '"1', "1\n2", "1;2", "text", "\0", "9" * 400, "1_000", "x" * 140_000)


def damage(random: Random, tree: Tree) -> dict[str, bytes]:
    """Return the input with one file made wrong, missing, renamed or exchanged for another."""
    damaged = dict(tree)
    name = random.choice(sorted(damaged))
    kind = random.randrange(12)
    if kind == 0 and len(damaged) > 1:
        del damaged[name]
    elif kind == 1:
        suffix = random.choice([".mp4", ".png", ".npz", ".npy", ".json", ".csv", ".h5", ".parquet", ".gif", ""])
        damaged[str(PurePosixPath(name).with_suffix(suffix))] = damaged.pop(name)
    elif kind == 2:
        damaged[name] = damaged[random.choice(sorted(damaged))]
    elif kind <= 5:
        damaged[name] = damage_bytes(random, damaged[name])
    else:
        damaged[name] = DAMAGES.get(PurePosixPath(name).suffix, damage_bytes)(random, damaged[name])
    return damaged


def damage_bytes(random: Random, data: bytes) -> bytes:
    """Change, drop, repeat, cut off or overwrite bytes."""
    begin = random.randrange(len(data) + 1)
    end = min(len(data), begin + random.choice([1, 2, 8, 64, 4096]))
    size = random.choice([1, 2, 4, 8])
    number = random.choice([0, 1, 127, 128, 255, 2**15, 2**16 - 1, 2**31 - 1, 2**32 - 1, 2**63 - 1, 2**64 - 1])
    replacements: tuple[Callable[[], bytes], ...] = (
        lambda: data[:begin],
        lambda: data[end:],
        lambda: data[:begin] + data[end:],
        lambda: data[:end] + data[begin:end] * 9 + data[end:],
        lambda: data[:begin] + bytes([random.choice([0, 32, 255])]) * (end - begin) + data[end:],
        lambda: data[:begin] + random.randbytes(end - begin) + data[end:],
        lambda: data[:begin] + (number % 256**size).to_bytes(size, "little") + data[begin + size :],
        lambda: data[:begin] + (number % 256**size).to_bytes(size, "big") + data[begin + size :],
        lambda: data + random.randbytes(40),
    )
    return random.choice(replacements)()


def damage_value(random: Random, value: Any) -> Any:
    """Return a JSON value with one part of it removed, wrapped, renamed or replaced."""
    root = [copy.deepcopy(value)]
    places: list[tuple[Any, Any]] = []
    todo: list[Any] = [root]
    while todo:
        holder = todo.pop()
        for key in list(holder) if isinstance(holder, dict) else range(len(holder)):
            places.append((holder, key))
            if isinstance(holder[key], dict | list):
                todo.append(holder[key])
    holder, key = random.choice(places)
    kind = random.randrange(6)
    if kind == 0 and holder is not root:
        del holder[key]
    elif kind == 1:
        holder[key] = [holder[key]]
    elif kind == 2 and isinstance(holder, dict):
        holder[f"{key} "] = holder.pop(key)
    elif kind == 3 and isinstance(holder[key], int | float):
        holder[key] = holder[key] * random.choice([-1.0, 0.0, 1e-6, 1e3, 1e30])
    else:
        holder[key] = copy.deepcopy(random.choice(VALUES))
    return root[0]


def damage_json(random: Random, data: bytes) -> bytes:
    """Change a value of a JSON text, or its nesting or encoding."""
    if random.random() < 0.2:
        depth = random.choice([50, 900, 200_000])
        texts = (b"[" * depth, b"[" * depth + b"]" * depth, b"\xef\xbb\xbf" + data, data.decode().encode("utf-16"))
        return random.choice([*texts, data.replace(b'"', b"'"), b"9" * 5000, b'"\\ud800"', data + data, b""])
    return json.dumps(damage_value(random, json.loads(data))).encode()


def damage_lines(random: Random, data: bytes) -> bytes:
    """Change, repeat or remove a line of JSON."""
    lines = data.splitlines()
    k = random.randrange(len(lines))
    kind = random.randrange(8)
    lines[k : k + 1] = [] if kind == 0 else [lines[k]] * 2 if kind == 1 else [damage_json(random, lines[k])]
    return b"".join(line + b"\n" for line in lines)


class _Pickled:
    def __reduce__(self) -> tuple[Any, tuple[str]]:
        return os.mkdir, (str(PICKLE_MARK),)


def npy(array: Any, *, pickled: bool = False) -> bytes:
    """Return an array as an npy file."""
    np.lib.format.write_array(buffer := io.BytesIO(), np.asarray(array), allow_pickle=pickled)
    return buffer.getvalue()


def damage_array(random: Random, array: np.ndarray) -> np.ndarray:
    """Return an array of another type, shape or with other values."""
    kind = random.randrange(7)
    if kind == 0:
        return np.zeros(array.shape, dtype=random.choice(TYPES))
    if kind == 1:
        return array.T
    if kind == 2:
        return array[None]
    if kind == 3 and array.ndim:
        return array[: random.randrange(3)]
    if kind == 4 and array.ndim:
        return np.concatenate([array, array[:1]])
    if kind == 5 or not array.size:
        return np.float64(1.0) * np.ones(())
    changed = array.astype(np.float64)
    changed.reshape(-1)[random.randrange(array.size)] = random.choice(NUMBERS)
    return changed


def damage_npy(random: Random, data: bytes) -> bytes:
    """Change an array, let its header lie, or replace it with a pickled object."""
    array = np.load(io.BytesIO(data), allow_pickle=False)
    kind = random.randrange(8)
    if kind == 0:
        return npy(np.array([_Pickled()], dtype=object), pickled=True)
    if kind > 2:
        return npy(damage_array(random, array))
    descriptions = (
        f"{{'descr': '{array.dtype.str}', 'fortran_order': False, 'shape': {random.choice(SHAPES)!r}, }}",
        f"{{'descr': '{array.dtype.str}', 'fortran_order': False, 'shape': {'(' * 500}",
        f"__import__('os').mkdir('{PICKLE_MARK}')",
        "{'descr': '|O', 'fortran_order': False, 'shape': (1,), }",
        "{'descr': [('a', [('b', '<f8', (1000000000,))])], 'fortran_order': False, 'shape': (2,), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (3.5,), }",
    )
    header = random.choice(descriptions).encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + array.tobytes()[:4096]


def damage_npz(random: Random, data: bytes) -> bytes:
    """Change, remove or rename an array of an npz file, or let its directory lie about sizes."""
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        entries = {name: npy(archive[name]) for name in archive.files}
    name = random.choice(sorted(entries))
    kind = random.randrange(8)
    if kind == 0:
        del entries[name]
    elif kind == 1:
        entries[random.choice(NAMES)] = entries.pop(name)
    elif kind == 2:
        entries[name] = entries[random.choice(sorted(entries))]
    else:
        entries[name] = damage_npy(random, entries[name])
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", random.choice([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])) as archive:
        for entry, array in entries.items():
            archive.writestr(f"{entry}.npy", array)
    data = buffer.getvalue()
    if kind == 7 and (at := data.rfind(b"PK\x01\x02")) >= 0:
        return data[: at + 20] + b"\xff\xff\xff\x7f" * 2 + data[at + 28 :]
    return data


def damage_csv(random: Random, data: bytes) -> bytes:
    """Change cells, rows, columns, separators or the encoding of a table."""
    rows = [line.split(",") for line in data.decode().splitlines()]
    k = random.randrange(len(rows))
    j = random.randrange(len(rows[0]))
    kind = random.randrange(6)
    if kind == 0:
        rows = [row[:j] + row[j + 1 :] for row in rows]
    elif kind == 1:
        rows = rows[: k + 1]
    elif kind == 2:
        rows[k] = rows[k] * 2
    else:
        rows[k][j] = random.choice(CELLS)
    text = "\n".join(random.choice([",", ",", ";"]).join(row) for row in rows) + "\n"
    return text.encode(random.choice(["utf-8", "utf-8", "utf-8-sig", "utf-16"]))


def damage_parquet(random: Random, data: bytes) -> bytes:
    """Change, remove or rename a column, or the number of rows."""
    table = parquet.read_table(io.BytesIO(data))
    k = random.randrange(table.num_columns)
    n = table.num_rows
    columns = (
        pyarrow.nulls(n),
        pyarrow.array([float("nan")] * n),
        pyarrow.array([-1] * n),
        pyarrow.array([2**62] * n),
        pyarrow.array(["../../etc/passwd"] * n),
        pyarrow.array([b"\x89PNG\r\n"] * n),
        pyarrow.array([[1.0] * (i % 4) for i in range(n)], pyarrow.list_(pyarrow.float64())),
        pyarrow.array([[None] * 7] * n, pyarrow.list_(pyarrow.float32(), 7)),
        pyarrow.array([{"bytes": b"x", "path": None}] * n),
        pyarrow.array([0] * n, pyarrow.timestamp("ns")),
        pyarrow.array(["a"] * n).dictionary_encode(),
    )
    kind = random.randrange(7)
    if kind == 0:
        table = table.remove_column(k)
    elif kind == 1:
        table = table.rename_columns([random.choice(NAMES) if i == k else c for i, c in enumerate(table.column_names)])
    elif kind == 2:
        table = table.slice(0, random.randrange(2))
    elif kind == 3:
        table = pyarrow.concat_tables([table, table])
    else:
        table = table.set_column(k, table.column_names[k], random.choice(columns))
    parquet.write_table(table, buffer := io.BytesIO())
    return buffer.getvalue()


def damage_hdf5(random: Random, data: bytes) -> bytes:
    """Replace an item of an HDF5 file: other values and types, sizes that are not stored, links to elsewhere."""
    buffer = io.BytesIO(data)
    with h5py.File(buffer, "r+") as file:
        names: list[str] = []
        file.visit(names.append)
        name = random.choice(sorted(names))
        array = file[name][()] if isinstance(file[name], h5py.Dataset) else np.zeros((4, 9))
        kind = random.randrange(10)
        del file[name]
        if kind == 0:
            file[random.choice(NAMES).strip("/.") or "x"] = array
        elif kind == 1:
            file.create_group(name)
        elif kind == 2:
            shape = random.choice([(10**9, 9), (10**5, 10**6), (10**6, 64, 64, 3)])
            file.create_dataset(name, shape=shape, dtype=array.dtype, chunks=tuple(min(n, 64) for n in shape))
        elif kind == 3:
            file[name] = h5py.ExternalLink("../outside.h5", "/secret")
        elif kind == 4:
            file[name] = h5py.SoftLink(random.choice(["/", f"/{name}"]))
        elif kind == 5:
            file.create_dataset(name, data=["text"] * 4, dtype=h5py.string_dtype())
        elif kind == 6:
            file[name] = h5py.Empty("f4")
        elif kind == 7:
            file.create_dataset(name, shape=(4, 9), dtype="f4", external=[("/etc/hostname", 0, 144)])
        else:
            changed = damage_array(random, np.asarray(array))
            file[name] = changed if changed.dtype.kind in "biufcSV" else np.zeros(0)
    return buffer.getvalue()


DAMAGES: Mapping[str, Callable[[Random, bytes], bytes]] = {
    ".json": damage_json,
    ".jsonl": damage_lines,
    ".npz": damage_npz,
    ".npy": damage_npy,
    ".csv": damage_csv,
    ".parquet": damage_parquet,
    ".h5": damage_hdf5,
}
"""What makes a file wrong, by its suffix; of other files the bytes are changed."""
