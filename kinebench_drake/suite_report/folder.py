"""Output folders of `suite run`, read back: only such as can be put together."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.report.page import read_results
from kinebench_drake.results import RESULTS, SAMPLES, read_rows
from kinebench_drake.row import Json, SampleRow
from kinebench_drake.suite_report.episode import Part

KIND = "suite"
SETTINGS = ("rounds", "control", "action_repeat", "frame_period_s", "pixels_only", "negative_prompt")
"""Settings of a run that change what its episodes come to."""
_LONG = 24
"""Letters of a setting that a label has room for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Folder:
    """One output folder of a suite run."""

    path: Path
    """Where it lies."""
    part: Part
    """What it was about."""
    rows: tuple[SampleRow, ...]
    """Its episodes, by id."""
    planned: int | None
    """Episodes that the whole run has, shards and limits aside; None where it is not told."""
    tags: Mapping[str, str]
    """Labels that the user gave."""
    settings: Mapping[str, str]
    """Its SETTINGS in words."""
    schema_version: Json
    """Version of the files' format."""
    suite_version: Json
    """Version of the suites."""

    @property
    def name(self) -> str:
        """Its last name."""
        return self.path.resolve().name

    @property
    def models(self) -> list[str]:
        """Names of the models in it, in the order of its rows."""
        return list(dict.fromkeys(model_of(row) for row in self.rows))


def model_of(row: SampleRow) -> str:
    """Name of a row's model."""
    return row.model or "unnamed"


def read_folders(paths: Sequence[Path]) -> list[Folder]:
    """Read the output folders of suite runs.

    Raises:
        UsageError: there is none, one is named twice, is broken, unfinished, empty or of another kind of run, or they
            have different schema or suite versions.
    """
    if not paths:
        raise UsageError("no folder named, expected the output folders of `kinebench-drake suite run`")
    seen: set[Path] = set()
    for path in paths:
        if path.resolve() in seen:
            raise UsageError(f"{path}: named twice; its episodes would count twice")
        seen.add(path.resolve())
    folders = [read_folder(path) for path in paths]
    first = folders[0]
    for folder in folders[1:]:
        for name in ("schema_version", "suite_version"):
            one, other = getattr(first, name), getattr(folder, name)
            if one != other:
                raise UsageError(
                    f"{first.path} has {name} {one} and {folder.path} {other}: their numbers cannot be put together; "
                    "run one of them anew with the other's version"
                )
    return folders


def read_folder(path: Path) -> Folder:
    """Read one output folder.

    Raises:
        UsageError: it is broken, unfinished, empty or of another kind of run.
    """
    if not (path / SAMPLES).is_file():
        raise UsageError(f"{path}: holds no {SAMPLES}, expected the output folder of a suite run")
    if not (path / RESULTS).is_file():
        raise UsageError(f"{path}: holds no {RESULTS}; run the same `suite run` again to finish it")
    try:
        rows, results = read_rows(path), read_results(path)
    except InputError as error:
        raise UsageError(str(error)) from None
    if results.get("kind") != KIND:
        raise UsageError(f"{path}: is of a run of kind {results.get('kind')!r}, expected {KIND!r}")
    if not rows:
        raise UsageError(f"{path}: holds no episode")
    config, tags, planned = results.get("config"), results.get("tags"), results.get("samples_found")
    config = config if isinstance(config, Mapping) else {}
    suite, split, variant = config.get("suite"), config.get("split"), config.get("variant", "plain")
    if not isinstance(suite, int) or not isinstance(split, str) or not isinstance(variant, str):
        raise UsageError(f"{path / RESULTS}: config names no suite, split and variant, expected those of a suite run")
    return Folder(
        path=path,
        part=Part(suite=suite, split=split, variant=variant),
        rows=tuple(rows[id] for id in sorted(rows)),
        planned=planned if isinstance(planned, int) else None,
        tags={key: str(value) for key, value in tags.items()} if isinstance(tags, Mapping) else {},
        settings={name: _words(config[name]) for name in SETTINGS if config.get(name) not in (None, "")},
        schema_version=results.get("schema_version"),
        suite_version=results.get("suite_version"),
    )


def _words(value: Json) -> str:
    """A setting in a label; long texts are cut, and told apart by their hash."""
    if isinstance(value, str) and len(value) > _LONG:
        return f"{value[:_LONG]}… {hashlib.sha256(value.encode()).hexdigest()[:6]}"
    return str(value).lower() if isinstance(value, bool) else f"{value:g}" if isinstance(value, float) else str(value)
