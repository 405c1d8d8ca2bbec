"""Parquet files from untrusted sources, read in batches: a small file may unpack to any number of rows."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pyarrow
import pyarrow.compute as compute
from pyarrow import parquet

from kinebench_drake.errors import InputError, cause
from kinebench_drake.io.files import MOST_BYTES, Budget, open_file

_ROWS = 64  # read at once: 64 images of 4 MiB


@contextmanager
def open_batches(
    path: Path,
    columns: Sequence[str] = (),
    optional: Sequence[str] = (),
    where: tuple[str, int] | None = None,
    *,
    every: bool = False,
) -> Iterator[tuple[pyarrow.Schema, Iterator[pyarrow.RecordBatch]]]:
    """Open a parquet file: schema and rows of all of `columns`, and those of `optional` that it has; or `every` one.

    Only rows are read `where` a column has a value, if the file has this column.

    Raises:
        InputError: the file cannot be read, is damaged, also in the rows read within the context, or lacks a column.
    """
    try:
        with open_file(path) as raw, parquet.ParquetFile(raw) as file:
            names = file.schema_arrow.names
            chosen = names if every else [*columns, *(name for name in optional if name in names)]
            if absent := [name for name in chosen if name not in names]:
                raise ValueError(f"it has no column {absent[0]!r}")
            where = where if where and where[0] in names else None
            schema = pyarrow.schema([file.schema_arrow.field(name) for name in chosen])
            yield schema, _batches(file, chosen, where)
    except (OSError, ValueError, TypeError, MemoryError, pyarrow.ArrowException) as error:
        reason = cause(error).replace(str(path), path.name)  # Arrow's messages contain paths of this machine
        raise InputError(f"{path.name} is not a readable parquet file ({reason})") from None


def _batches(
    file: parquet.ParquetFile, columns: list[str], where: tuple[str, int] | None
) -> Iterator[pyarrow.RecordBatch]:
    for number in range(file.num_row_groups):
        group = file.metadata.row_group(number)
        chunks = [group.column(k) for k in range(group.num_columns)]
        if where and any(c.path_in_schema == where[0] and not _may_hold(c.statistics, where[1]) for c in chunks):
            continue
        read = [c for c in chunks if any(c.path_in_schema.startswith(name) for name in columns)]
        if any(c.num_values > MOST_BYTES for c in read):
            raise ValueError(f"a column holds {max(c.num_values for c in read)} values in one row group")
        for batch in file.iter_batches(_ROWS, [number], [*columns, *(where[:1] if where else ())]):
            if where:
                batch = batch.filter(compute.equal(batch[where[0]], where[1]))
            if batch.num_rows:
                yield batch.select(columns)


def _may_hold(statistics: parquet.Statistics | None, value: int) -> bool:
    if statistics is None or not statistics.has_min_max:
        return True
    return bool(statistics.min <= value <= statistics.max)


def read_table(
    path: Path,
    columns: Sequence[str] = (),
    optional: Sequence[str] = (),
    where: tuple[str, int] | None = None,
    *,
    every: bool = False,
) -> pyarrow.Table:
    """Read columns of a parquet file as `open_batches` does."""
    budget = Budget(MOST_BYTES, InputError(f"{path.name}: its rows take more than {MOST_BYTES >> 20} MiB"))
    with open_batches(path, columns, optional, where, every=every) as (schema, batches):
        kept = []
        for batch in batches:
            budget.take(batch.nbytes)
            kept.append(batch)
        return pyarrow.Table.from_batches(kept, schema)
