"""Run metadata in results.json and run.json, and shards of a run."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, cast

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.io.jsonl import intern_text, read_json
from kinebench_drake.results.store import RESULTS, RUN
from kinebench_drake.types import Json

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True, kw_only=True)
class Shard:
    """One of `count` equal parts of a list: part k has items k, k + count, k + 2 count, ..., counted from 1."""

    index: int
    """Number of the part, 1..count."""
    count: int
    """Number of parts."""

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            UsageError: there is no such part.
        """
        if not 1 <= self.index <= self.count:
            raise UsageError(f"--shard is '{self}', expected I/N with I from 1 to N, such as 1/4")

    def __str__(self) -> str:
        return f"{self.index}/{self.count}"

    @classmethod
    def parse(cls, text: str) -> "Shard":
        """Read "I/N", parts counted 1 .. N.

        Raises:
            UsageError: it is not of that form.
        """
        match = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text.strip())
        if not match:
            raise UsageError(f"--shard is {text!r:.60}, expected I/N with I from 1 to N, such as 1/4")
        return cls(index=int(match[1]), count=int(match[2]))

    def take(self, items: Sequence[Item]) -> list[Item]:
        """This part of `items`."""
        return list(items[self.index - 1 :: self.count])


@dataclass(frozen=True, slots=True, kw_only=True)
class RunMetadata:
    """The part of `results.json` that is known before the first sample is done."""

    schema_version: int
    """Version of the files' format."""
    suite_version: Json
    """Version of the suites; None where none is involved."""
    kind: str
    """What is done with the samples."""
    samples_found: int
    """Samples of the whole run, shard and limit aside."""
    config: Mapping[str, Json]
    """What the run was told."""
    tags: Mapping[str, str]
    """Labels that the user gave."""
    bootstrap_seed: int
    """Seed of the intervals' resampling."""
    versions: Mapping[str, Json]
    """Packages and their versions."""
    code_sha256: str
    weights_sha256: str
    host: Mapping[str, Json]
    """The machine in few words."""

    @property
    def shard(self) -> Shard | None:
        """The part of the samples that was worked on; None for all.

        Raises:
            UsageError: it is told in another form than I/N.
        """
        told = self.config.get("shard")
        return None if told is None else Shard.parse(str(told))

    @property
    def planned(self) -> int:
        """Samples that all shards together have."""
        limit = self.config.get("limit")
        return min(self.samples_found, limit) if isinstance(limit, int) else self.samples_found

    def to_json(self, aggregates: Mapping[str, Json] | None = None) -> dict[str, Json]:
        """The object as written, the numbers over all rows amid it."""
        told = {
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
        return cast(dict[str, Json], intern_text(told))

    @classmethod
    def from_json(cls, data: object) -> "RunMetadata":
        """Header from a parsed `results.json` or `run.json`.

        Raises:
            InputError: a part is missing or has another form.
        """
        if not isinstance(data, dict):
            raise InputError(f"expected an object, found {type(data).__name__}")
        seeds = data.get("seeds")
        told: dict[str, Any] = {
            **{name: data.get(name) for name in cls.__dataclass_fields__},
            "bootstrap_seed": seeds.get("bootstrap") if isinstance(seeds, dict) else None,
        }
        forms = {
            **dict.fromkeys(("schema_version", "samples_found", "bootstrap_seed"), int),
            **dict.fromkeys(("kind", "code_sha256", "weights_sha256"), str),
            **dict.fromkeys(("config", "tags", "versions", "host"), dict),
        }
        for name, form in forms.items():
            if not isinstance(told[name], form):
                raise InputError(f"{name} is {told[name]!r:.60}, expected {form.__name__}")
        return cls(**told)

    def with_config(self, **changes: Json) -> "RunMetadata":
        """The same, told other things."""
        return replace(self, config={**self.config, **changes})


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredMetadata:
    """A header and whether the run it is of came to its end."""

    header: RunMetadata
    finished: bool


def read_metadata(out: Path) -> StoredMetadata | None:
    """The header of an output folder; None if it holds none.

    Raises:
        InputError: the file is damaged.
    """
    for name in (RESULTS, RUN):  # where both are there, the run was stopped with its results written
        path = out / name
        try:
            header = RunMetadata.from_json(read_json(path))
        except FileNotFoundError:
            continue
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
        except (ValueError, InputError) as error:
            raise InputError(f"{path}: is not what a run writes ({error})") from None
        return StoredMetadata(header=header, finished=name == RESULTS)
    return None
