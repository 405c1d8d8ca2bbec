"""Lines of `samples.jsonl` on disk: what takes most bytes of a row is read from them on demand."""

import os
from collections.abc import ItemsView, Iterator, Mapping
from pathlib import Path
from typing import Any, cast

from kinebench_drake.io.jsonl import Json, intern_text, parse_json


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
    """Place of one row in a file: offset of its first byte and number of bytes."""

    __slots__ = ("file", "size", "start")

    def __init__(self, file: RowFile, start: int, size: int) -> None:
        self.file = file
        self.start = start
        self.size = size

    def read(self) -> bytes:
        """Return the bytes of the line, with its line feed."""
        return self.file.read(self.start, self.size)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(None), ()  # in another process the file is not open


class StoredObject(Mapping[str, Json]):
    """An object of a stored row, such as `details`: read and parsed at each access."""

    __slots__ = ("_line", "_name")

    def __init__(self, line: RowLine, name: str) -> None:
        self._line = line
        self._name = name

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
