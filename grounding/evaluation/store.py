"""Finished measurements on disk, so that an interrupted command goes on where it stopped.

One JSON object a line: key, and what `ClipErrors.to_json` gives. A key tells clip, condition and everything that shapes
the result, so that lines of other weights, seeds or code are passed over, not mixed in.
"""

from collections.abc import Iterable
from hashlib import blake2b
from pathlib import Path
from typing import Any

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.grounding.evaluation.errors import ClipErrors
from kinebench_drake.io.jsonl import append_line, drop_torn_line, read_lines

_GROUNDING = Path(__file__).parents[1]
_CODE = ("*.py", "anomaly/*.py", "stages/**/*.py", "evaluation/*.py", "evaluation/perturbation/*.py")
_MODELS = ("**/*.py", "**/*.json", "**/*.safetensors")
_PRESENTING = frozenset({"figures.py", "tables.py", "summary.py", "reliability.py", "store.py", "anomalies.py"})


def fingerprint(*settings: object, files: Iterable[Path] = ()) -> str:
    """A few characters that change with the settings, with `files`, and with the code and weights of the grounding."""
    hashed = blake2b(repr(settings).encode(), digest_size=8)
    code = [p for pattern in _CODE for p in _GROUNDING.glob(pattern) if p.name not in _PRESENTING]
    models = [p for pattern in _MODELS for p in (_GROUNDING.parent / "models").glob(pattern)]
    for path in [*sorted({*code, *models}), *files]:
        hashed.update(path.name.encode())
        hashed.update(path.read_bytes())
    return hashed.hexdigest()


class TrialStore:
    """Measurements by key; without a file they last as long as the object."""

    def __init__(self, path: Path | None) -> None:
        """Read the file, if there is one; a torn last line is dropped.

        Raises:
            UsageError: the file holds something else.
        """
        self._path = path
        self._rows: dict[str, ClipErrors] = {}
        if path is None or not path.is_file():
            return
        try:
            for row in read_lines(path, _row):
                self._rows[row.pop("key")] = ClipErrors.from_json(row)
        except (InputError, KeyError, TypeError, AttributeError):
            raise UsageError(f"{path.name}: holds no measurements of this version; remove it to start anew") from None
        drop_torn_line(path)

    def __contains__(self, key: str) -> bool:
        """Whether a measurement is there."""
        return key in self._rows

    def __getitem__(self, key: str) -> ClipErrors:
        """A measurement that is there."""
        return self._rows[key]

    def put(self, key: str, errors: ClipErrors) -> None:
        """Keep a measurement and see it to the disk.

        Raises:
            SetupError: writing failed.
        """
        row = errors.to_json()
        self._rows[key] = ClipErrors.from_json(row)  # rounded alike, whether kept or measured now
        if self._path is None:
            return
        self._path.parent.mkdir(parents=True, exist_ok=True)
        append_line(self._path, {"key": key, **row})


def _row(value: object) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InputError("expected an object")
    return value
