"""Tables made wrong: csv and parquet with other columns, types, lengths and gaps."""

import io

import pyarrow
import pyarrow.parquet as parquet
from numpy.random import Generator

from kinebench_drake.validation.fuzz.arrays import odd_name
from kinebench_drake.validation.fuzz.octets import mutate_bytes

_CELLS = (
    *("", " ", "nan", "inf", "-1e999", "1e308", "0x10", "1,2", '"', '"1', "1\n2", "1;2", "text", "\0", "\x1b[2J", "١"),
    *(
        "9" * 400,
        "1_000",
        "1 2",
        "0.1.2",
        "x" * 140_000,
        "-0",
        "true",
        "=1+1",
        "\ud800",
        "../../etc/passwd",
        "clip.mp4",
    ),
)


def mutate_csv(rng: Generator, data: bytes) -> bytes:
    """A csv file after changes to its cells, rows or columns, or to its bytes."""
    if rng.random() < 0.3:
        return mutate_bytes(rng, data)
    rows = [line.split(",") for line in data.decode().splitlines()]
    for _ in range(min(int(rng.geometric(0.6)), 4)):
        k = int(rng.integers(len(rows))) if rng.random() < 0.7 else 0
        row = rows[k] or [""]
        j = int(rng.integers(len(row)))
        kind = int(rng.integers(8))
        if kind == 0:
            rows = [r[:j] + r[j + 1 :] for r in rows]
        elif kind == 1:
            row.insert(j, _cell(rng))
        elif kind == 2:
            rows = rows[: k + 1] if rng.random() < 0.5 else [rows[0], *rows] if rows else rows
        elif kind == 3:
            rows[k] = [*row, *row]
        else:
            row[j] = _cell(rng)
        rows = rows or [[""]]
    end = str(rng.choice(["\n", "\n", "\r\n", "\r"]))
    text = end.join(str(rng.choice([",", ",", ",", ",", ";", "\t"])).join(row) for row in rows) + end
    return text.encode(str(rng.choice(["utf-8", "utf-8", "utf-8-sig", "utf-16"])), errors="surrogatepass")


def _cell(rng: Generator) -> str:
    return _CELLS[int(rng.integers(len(_CELLS)))]


def mutate_parquet(rng: Generator, data: bytes) -> bytes:
    """A parquet file after changes to its columns, or to its bytes."""
    if rng.random() < 0.5:
        return mutate_bytes(rng, data)
    table = parquet.read_table(io.BytesIO(data))
    for _ in range(min(int(rng.geometric(0.7)), 3)):
        if not table.num_columns:
            break
        k = int(rng.integers(table.num_columns))
        kind = int(rng.integers(6))
        if kind == 0:
            table = table.remove_column(k)
        elif kind == 1:
            table = table.rename_columns([odd_name(rng) if i == k else n for i, n in enumerate(table.column_names)])
        elif kind == 2:
            table = table.slice(0, int(rng.integers(2)))
        elif kind == 3:
            table = pyarrow.concat_tables([table, table])
        else:
            table = table.set_column(k, table.column_names[k], _column(rng, table.num_rows))
    parquet.write_table(table, buffer := io.BytesIO())
    return buffer.getvalue()


def _column(rng: Generator, rows: int) -> pyarrow.Array:
    """A column that nobody expects."""
    columns: tuple[pyarrow.Array, ...] = (
        pyarrow.nulls(rows),
        pyarrow.array([None, *[1.0] * rows][:rows], pyarrow.float64()),
        pyarrow.array([float("nan")] * rows),
        pyarrow.array([-1] * rows),
        pyarrow.array([2**62] * rows),
        pyarrow.array(["../../etc/passwd"] * rows),
        pyarrow.array([b"\x89PNG\r\n"] * rows),
        pyarrow.array([[1.0] * (k % 4) for k in range(rows)], pyarrow.list_(pyarrow.float64())),
        pyarrow.array([[[1.0]]] * rows),
        pyarrow.array([[None] * 7] * rows, pyarrow.list_(pyarrow.float32(), 7)),
        pyarrow.array([[float("inf")] * 9] * rows),
        pyarrow.array([{"bytes": b"x", "path": None}] * rows),
        pyarrow.array([True] * rows),
        pyarrow.array([0] * rows, pyarrow.timestamp("ns")),
        pyarrow.array(["a"] * rows).dictionary_encode(),
        pyarrow.array([[["x"]]] * rows, pyarrow.list_(pyarrow.list_(pyarrow.string()))),
    )
    return columns[int(rng.integers(len(columns)))]
