"""Rows of `samples.jsonl` in little memory: numbers and labels are kept, the rest is read from the file on demand."""

import os
from collections.abc import ItemsView, Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

from kinebench_drake.io.jsonl import Json, dump, intern_text, parse_json

_SHORT = 200
"""Characters of JSON up to which an object is kept; as many samples have the same camera or framing, it is shared."""


class RowFile:
    """A file of lines, open as long as a row refers to it: rows stay readable when the file is replaced."""

    def __init__(self, path: Path) -> None:
        """Open the file.

        Raises:
            OSError: it cannot be opened.
        """
        self._fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)

    def __del__(self) -> None:
        if hasattr(self, "_fd"):
            os.close(self._fd)

    @property
    def size(self) -> int:
        """Size of the file [bytes]."""
        return os.fstat(self._fd).st_size

    def read(self, start: int, size: int) -> bytes:
        """Read a part of the file."""
        return os.pread(self._fd, size, start)


class RowLine:
    """Place of one row in a file."""

    __slots__ = ("file", "size", "start")

    def __init__(self, file: RowFile, start: int, size: int) -> None:
        self.file = file
        self.start = start
        """Offset of the first byte."""
        self.size = size
        """Bytes of the line, with its line feed."""

    def read(self) -> bytes:
        """Return the bytes of the line."""
        return self.file.read(self.start, self.size)


class StoredObject(Mapping[str, Json]):
    """An object of a stored row, such as `details`: read and parsed at each access."""

    __slots__ = ("_line", "_name")

    def __init__(self, line: RowLine, name: str) -> None:
        self._line, self._name = line, name

    def __getitem__(self, key: str) -> Json:
        return self._parse()[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._parse())

    def __len__(self) -> int:
        return len(self._parse())

    def items(self) -> ItemsView[str, Json]:
        """Return names and values; the row is read once."""
        return self._parse().items()

    def __repr__(self) -> str:
        return repr(self._parse())

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (self._parse(),)

    def _parse(self) -> dict[str, Json]:
        row = cast(dict[str, Any], parse_json(self._line.read()))
        return cast(dict[str, Json], intern_text(row[self._name]))


class PackedObject(Mapping[str, Json]):
    """An object with few bytes: its names are shared with all objects of the same names."""

    __slots__ = ("_places", "_values")

    def __init__(self, values: Mapping[str, Json]) -> None:
        self._places, self._values = _places(tuple(values)), tuple(map(_pack_value, values.values()))

    def __getitem__(self, key: str) -> Json:
        return self._values[self._places[key]]

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        return repr(dict(self))

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (dict(self),)


def _pack_value(value: Json) -> Json:
    if value is None or isinstance(value, float | int):  # most values: what follows takes longer
        return value
    if isinstance(value, Mapping | list):
        text = dump(value)
        return _shared(text) if len(text) <= _SHORT else cast(Json, intern_text(value))
    return cast(Json, intern_text(value))


@lru_cache(maxsize=4096)
def _places(names: tuple[str, ...]) -> dict[str, int]:
    return {intern_text(name): k for k, name in enumerate(names)}


@lru_cache(maxsize=4096)
def _shared(text: str) -> Json:
    return cast(Json, intern_text(parse_json(text)))
