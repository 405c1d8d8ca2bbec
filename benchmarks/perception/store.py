"""Measurements on disk, so that an interrupted command resumes: JSON Lines, each line a key and a measurement.

A key identifies the clip, the condition and all that shapes the result: lines of other code, weights or seeds are
ignored.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import GetCoreSchemaHandler, PlainSerializer, TypeAdapter
from pydantic_core import CoreSchema, core_schema

import kinebench_drake
from benchmarks.perception.sources import trace_sources
from kinebench_drake.errors import InputError, SetupError, UsageError
from kinebench_drake.executors.base import Executor, MakeWorker, Observer, WorkerCrash
from kinebench_drake.geometry import Array
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.io.jsonl import append_line, read_lines

Record = TypeVar("Record")
"""Dataclass; its arrays are annotated as `Stored`."""
Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class Stored:
    """Annotation of an array in a record: nested lists of numbers in the file, null for NaN."""

    format: str
    """Format that the numbers are rounded to, such as ".3f"."""
    dtype: type[np.generic] = np.float64

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(
            lambda value: np.array(value, dtype=self.dtype),
            serialization=core_schema.plain_serializer_function_ser_schema(lambda array: self._plain(array.tolist())),
        )

    def _plain(self, value: Any) -> Any:
        if isinstance(value, list):
            return [self._plain(item) for item in value]
        return float(format(value, self.format)) if np.isfinite(value) else None


Flags = Annotated[NDArray[np.bool_], Stored("d", np.bool_)]
"""Array of booleans in a record, 0 and 1 in the file."""
Confidences = Annotated[Array, Stored(".4f")]
Micro = Annotated[Array, Stored(".6f")]
Milli = Annotated[float, PlainSerializer(lambda value: round(value, 3))]
"""Number in a record, rounded to three decimals in the file."""


def drop_torn_line(path: Path) -> None:
    """Remove an unfinished last line, so that lines can be appended."""
    if path.is_file():
        data = path.read_bytes()
        whole = data[: data.rfind(b"\n") + 1]
        if len(whole) < len(data):
            write_atomically(path, whole)


def fingerprint(*settings: object, modules: Iterable[str] = (), files: Iterable[Path] = ()) -> str:
    """Return a hash of settings, of the code and the models that a measurement depends on, and of files.

    Args:
        settings: anything whose `repr` is the same for the same setting.
        modules: names of measuring modules; they count with every module that they import, without docstrings and
            comments, and with the weights and calibrations in models/.
        files: further files that shape the result.
    """
    digest = blake2b(repr(settings).encode(), digest_size=8)
    code = trace_sources(*modules)
    for source in code:
        digest.update(f"{source.name} {source.code}\n".encode())
    models = Path(kinebench_drake.__file__).parent / "models"
    data = sorted([*models.rglob("*.json"), *models.rglob("*.safetensors")]) if code else []
    for path in [*data, *files]:
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


class MeasurementStore(Generic[Record]):
    """Measurements by key, kept in a file; in memory only if there is no file."""

    def __init__(self, path: Path | None, record: type[Record]) -> None:
        """Read the measurements of a file, if it exists; a torn last line is dropped.

        Raises:
            UsageError: the file holds something else.
        """
        self._path = path
        self._adapter = TypeAdapter(record)
        self._records: dict[str, Record] = {}
        if path is None or not path.is_file():
            return
        try:
            for row in read_lines(path, _row):
                key = row.pop("key")
                self._records[key] = self._adapter.validate_python(row)
        except (InputError, KeyError, ValueError, TypeError, AttributeError):
            raise UsageError(f"{path.name}: holds no measurements of this version; remove it to start anew") from None
        drop_torn_line(path)

    def __contains__(self, key: str) -> bool:
        """Return whether the measurement exists."""
        return key in self._records

    def __getitem__(self, key: str) -> Record:
        """Return an existing measurement."""
        return self._records[key]

    def put(self, key: str, record: Record) -> None:
        """Add a measurement; it is on disk when this returns.

        Raises:
            SetupError: writing failed.
        """
        row = self._adapter.dump_python(record, mode="json")
        # The same rounding, whether read from the file or measured now.
        self._records[key] = self._adapter.validate_python(row)
        if self._path is not None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            append_line(self._path, {"key": key, **row})

    def complete(
        self,
        items: Sequence[Item],
        key: Callable[[Item], str],
        executor: Executor,
        make_worker: MakeWorker[Item, Record],
        observer: Observer,
        label: Callable[[Item], str],
    ) -> list[Record]:
        """Measure the items that are not in the store yet; return the measurements of all, in the order of the items.

        Raises:
            SetupError: a worker died, or writing failed; finished measurements are stored.
        """
        todo = [item for item in items if key(item) not in self]
        observer.start(len(items), len(items) - len(todo))
        for outcome in executor.run(make_worker, todo):
            name = label(outcome.item)
            if isinstance(outcome, WorkerCrash):
                raise SetupError(f"{name}: {outcome.reason}; run the same command again, what is finished is kept")
            self.put(key(outcome.item), outcome.result)
            observer.advance(name)
        return [self[key(item)] for item in items]


def _row(value: object) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InputError("expected an object")
    return value
