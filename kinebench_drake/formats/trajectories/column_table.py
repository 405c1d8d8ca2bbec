"""Tables: the numbers of a trajectory's file by column, whatever its format, and references to some of them."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.formats.trajectories.trajectory import MAX_FRAMES, require_numbers
from kinebench_drake.geometry import Array

_REFERENCE = re.compile(r"(?P<column>.+?)\[(?P<first>\d*)(?P<slice>:?)(?P<end>\d*)\]")


@dataclass(frozen=True, slots=True, kw_only=True)
class NumberColumn:
    """Numbers of each frame under one name."""

    name: str
    size: int
    """Numbers per frame; a 4x4 matrix counts 16."""
    names: tuple[str, ...] = ()
    """Names of the numbers; empty if they are missing."""

    def describe(self) -> str:
        """Return name and numbers for a message."""
        if self.size == 1 and not self.names:
            return self.name
        first = ", ".join(self.names[:9]) + (", ..." if self.size > 9 else "")
        return f"{self.name} ({first if self.names else self.size})"


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnTable:
    """Columns of one trajectory; valid while its file is open."""

    columns: tuple[NumberColumn, ...]
    load: Callable[[str], NDArray[np.generic]]
    """Returns the values (T, ...) of a column."""
    t_s: NDArray[np.generic] | None = None
    """(T,) times that the format defines [s]; None if they are in a column, or follow from `rate_hz`."""
    rate_hz: float | None = None
    """Frames per second by the metadata [Hz]."""
    optional: frozenset[str] = frozenset()
    """Columns that are read only if the user names them: commands, velocities, computed values."""

    def numbers(self, references: Sequence[str]) -> Array:
        """Return the numbers (T, n) that `references` name, in their order.

        Raises:
            InputError: a reference fits nothing or several columns, or a column holds no real numbers.
        """
        parts = [self._part(reference) for reference in references]
        lengths = {len(part) for part in parts}
        if len(lengths) > 1:
            raise InputError(f"{', '.join(references)} have {' and '.join(map(str, sorted(lengths)))} rows")
        return np.concatenate(parts, axis=1)

    def size(self, references: Sequence[str]) -> int:
        """Return how many numbers per frame `references` name."""
        return sum(len(self._indices(reference)[1]) for reference in references)

    def actions(self, references: Sequence[str]) -> Array | None:
        """Return the actions (T, n) for the numbers that `references` name; None without one column of actions alike.

        Raises:
            InputError: as for `numbers`.
        """
        places = [self._indices(reference) for reference in references]
        columns = [c for c in self.columns if re.split(r"[./]", c.name)[-1] in ("action", "actions")]
        if len(columns) != 1 or any(c.size != columns[0].size or c is columns[0] for c, _ in places):
            return None
        return self._part(columns[0].name)[:, [index for _, indices in places for index in indices]]

    def array(self, name: str) -> NDArray[np.generic] | None:
        """Return the values of a column as stored; None if there is no such column."""
        return self.load(name) if any(column.name == name for column in self.columns) else None

    def describe(self) -> str:
        """Return the columns for a message."""
        texts = [column.describe() for column in self.columns]
        return "; ".join(texts[:12]) + ("; ..." if len(texts) > 12 else "") if texts else "no column of numbers"

    def _part(self, reference: str) -> Array:
        column, indices = self._indices(reference)
        values = require_numbers(column.name, self.load(column.name))
        if len(values) > MAX_FRAMES:
            raise InputError(f"has {len(values)} frames, at most {MAX_FRAMES} are accepted: cut it into parts")
        rows = values.reshape(len(values), int(np.prod(values.shape[1:])))
        if max(indices, default=-1) >= rows.shape[1]:
            raise InputError(f"{column.name} holds {rows.shape[1]} numbers per frame, {column.size} are described")
        return rows[:, indices]

    def _indices(self, reference: str) -> tuple[NumberColumn, list[int]]:
        """Return column and numbers of a reference: `NAME`, `NAME[3]`, `NAME[0:7]`, or the name of one number."""
        for column in self.columns:
            if column.name == reference:
                return column, list(range(column.size))
        match = _REFERENCE.fullmatch(reference)
        for column in self.columns:
            if match and column.name == match["column"]:
                first = int(match["first"] or 0)
                end = int(match["end"] or column.size) if match["slice"] else first + 1
                if not first < end <= column.size:
                    raise InputError(f"{reference}: {column.name} holds {column.size} numbers per frame")
                return column, list(range(first, end))
        own = [(c, [c.names.index(reference)]) for c in self.columns if reference in c.names]
        own = [place for place in own if place[0].name not in self.optional] or own
        if len(own) != 1:
            where = f"is in {', '.join(c.name for c, _ in own)}" if own else "is no column and no number"
            raise InputError(f"{reference!r} {where}; found {self.describe()}")
        return own[0]


def reference(column: NumberColumn, indices: Sequence[int]) -> list[str]:
    """Return references to some numbers of a column, in their order, runs of consecutive ones as one."""
    if list(indices) == list(range(column.size)):
        return [column.name]
    runs: list[list[int]] = []
    for index in indices:
        if runs and index == runs[-1][-1] + 1:
            runs[-1].append(index)
        else:
            runs.append([index])
    return [f"{column.name}[{run[0]}:{run[-1] + 1}]" if len(run) > 1 else f"{column.name}[{run[0]}]" for run in runs]
