"""Metadata of a run in results.json and run.json, and shards of a run."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, cast

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.io.jsonl import Json, intern_text, read_json
from kinebench_drake.results.store import RESULTS, RUN

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True, kw_only=True)
class Shard:
    """One of `count` parts of a list: part k holds items k, k + count, k + 2 count, ..., counted from 1."""

    index: int
    """Number of the part, 1..count."""
    count: int
    """Number of parts."""

    def __post_init__(self) -> None:
        """Check the range of the index.

        Raises:
            UsageError: there is no such part.
        """
        if not 1 <= self.index <= self.count:
            raise UsageError(f"$shard is '{self}', expected I/N with I from 1 to N, such as 1/4")

    def __str__(self) -> str:
        return f"{self.index}/{self.count}"

    @classmethod
    def parse(cls, text: str) -> "Shard":
        """Parse "I/N", I from 1 to N.

        Raises:
            UsageError: the text has another form.
        """
        match = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text.strip())
        if not match:
            raise UsageError(f"$shard is {text!r:.60}, expected I/N with I from 1 to N, such as 1/4")
        return cls(index=int(match[1]), count=int(match[2]))

    def take(self, items: Sequence[Item]) -> list[Item]:
        """Return this part of `items`."""
        return list(items[self.index - 1 :: self.count])


@dataclass(frozen=True, slots=True, kw_only=True)
class RunMetadata:
    """Part of `results.json` that does not depend on the samples' results."""

    schema_version: int
    """Version of the file format."""
    suite_version: Json
    """Version of the suites; None if the run uses none."""
    kind: str
    """Kind of run: score, ground, audit or suite."""
    samples_found: int
    """Number of samples of the whole run, regardless of shard and limit."""
    config: Mapping[str, Json]
    """Configuration of the run."""
    tags: Mapping[str, str]
    """Labels of the user."""
    bootstrap_seed: int
    """Seed of the bootstrap intervals."""
    versions: Mapping[str, Json]
    """Versions of packages."""
    code_sha256: str
    weights_sha256: str
    host: Mapping[str, Json]
    """Summary of the machine."""

    @property
    def shard(self) -> Shard | None:
        """Shard of the run; None if it processed all samples."""
        text = self.config.get("shard")
        return None if text is None else Shard.parse(str(text))

    @property
    def planned(self) -> int:
        """Number of samples of all shards together."""
        limit = self.config.get("limit")
        return min(self.samples_found, limit) if isinstance(limit, int) else self.samples_found

    def to_json(self, aggregates: Mapping[str, Json] | None = None) -> dict[str, Json]:
        """Return the JSON object, with the aggregates over all rows in the middle."""
        values = {
            "schema_version": self.schema_version,
            "suite_version": self.suite_version,
            "kind": self.kind,
            "samples_found": self.samples_found,
            **(aggregates or {}),
            "config": self.config,
            "tags": dict(sorted(self.tags.items())),
            "seeds": {"bootstrap": self.bootstrap_seed},
            "versions": self.versions,
            "code_sha256": self.code_sha256,
            "weights_sha256": self.weights_sha256,
            "host": self.host,
        }
        return cast(dict[str, Json], intern_text(values))

    @classmethod
    def from_json(cls, data: object) -> "RunMetadata":
        """Convert a parsed `results.json` or `run.json`.

        Raises:
            InputError: a value is missing or of the wrong type.
        """
        if not isinstance(data, dict):
            raise InputError(f"expected an object, found {type(data).__name__}")
        seeds = data.get("seeds")
        values: dict[str, Any] = {
            **{name: data.get(name) for name in cls.__dataclass_fields__},
            "bootstrap_seed": seeds.get("bootstrap") if isinstance(seeds, dict) else None,
        }
        types = {
            **dict.fromkeys(("schema_version", "samples_found", "bootstrap_seed"), int),
            **dict.fromkeys(("kind", "code_sha256", "weights_sha256"), str),
            **dict.fromkeys(("config", "tags", "versions", "host"), dict),
        }
        for name, kind in types.items():
            if not isinstance(values[name], kind):
                raise InputError(f"{name} is {values[name]!r:.60}, expected {kind.__name__}")
        return cls(**values)


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredMetadata:
    """Metadata of an output folder."""

    run: RunMetadata
    finished: bool
    """True if the run has ended."""


def read_metadata(out: Path) -> StoredMetadata | None:
    """Read the metadata of an output folder; None if it holds none.

    Raises:
        InputError: the file is damaged.
    """
    for name in (RESULTS, RUN):  # if both exist, the run was stopped after it had written its results
        path = out / name
        try:
            run = RunMetadata.from_json(read_json(path))
        except FileNotFoundError:
            continue
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
        except (ValueError, InputError) as error:
            raise InputError(f"{path}: is not what a run writes ({error})") from None
        return StoredMetadata(run=run, finished=name == RESULTS)
    return None
