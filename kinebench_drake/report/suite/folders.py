"""Output folders of `suite run`, read back: only such as can be put together."""

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.report.page import read_results
from kinebench_drake.report.suite.episode import EpisodePart, EpisodeResult, group
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.store import RESULTS, SAMPLES, read_rows
from kinebench_drake.types import Json

KIND = "suite"
SETTINGS = ("rounds", "control", "action_repeat", "frame_period_s", "pixels_only", "negative_prompt")
"""Settings of a run that change what its episodes come to."""
_LONG = 24
"""Letters of a setting that a label has room for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunFolder:
    """One output folder of a suite run."""

    path: Path
    """Where it lies."""
    part: EpisodePart
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


def read_folders(paths: Sequence[Path]) -> list[RunFolder]:
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


def read_folder(path: Path) -> RunFolder:
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
    return RunFolder(
        path=path,
        part=EpisodePart(suite=suite, split=split, variant=variant),
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


def gather(folders: Sequence[RunFolder]) -> list[EpisodeResult]:
    """All episodes of some folders, model by model in the order in which the folders name them.

    Runs of one model on one part are one run (as shards are) unless tags or settings differ; what differs is put behind
    the model's name, as in "wan (data=25, steps=7500)". If they hold the same episodes all the same, the folders' names
    are put behind it.

    Raises:
        UsageError: two folders hold the same episode of a model, and nothing tells them apart.
    """
    telling = {model: _telling([f for f in folders if model in f.models]) for f in folders for model in f.models}
    episodes = [
        (index, EpisodeResult(part=f.part, model=_label(model_of(row), f, telling), folder=f.path, row=row))
        for index, f in enumerate(folders)
        for row in f.rows
    ]
    held: dict[tuple[str, EpisodePart, int], set[object]] = {}
    for index, episode in episodes:
        held.setdefault((episode.model, episode.part, index), set()).add(episode.key)
    clashing: set[tuple[str, EpisodePart]] = set()
    for (one, these), (other, those) in combinations(held.items(), 2):
        if one[:2] == other[:2] and these & those:
            a, b = folders[one[2]], folders[other[2]]
            if a.name == b.name:
                raise UsageError(
                    f"{a.path} and {b.path} hold the same episodes of {one[0]}: name one of them, or tell them apart "
                    "with `suite run --tag KEY=VALUE`"
                )
            clashing.add(one[:2])
    named = [
        EpisodeResult(part=e.part, model=f"{e.model} [{folders[k].name}]", folder=e.folder, row=e.row)
        if (e.model, e.part) in clashing
        else e
        for k, e in episodes
    ]
    order = {model: number for number, model in enumerate(telling)}
    return sorted(named, key=lambda e: (order[model_of(e.row)], _natural(e.model), e.part, e.task, _natural(e.row.id)))


def models_of(episodes: Sequence[EpisodeResult]) -> list[str]:
    """Labels of the models, in the order of the episodes."""
    return list(group(episodes, lambda e: e.model))


def _facts(folder: RunFolder) -> Mapping[str, str]:
    """Tags and settings; a tag wins."""
    return {**folder.settings, **folder.tags}


def _telling(folders: Sequence[RunFolder]) -> list[str]:
    """Names of the tags and settings that differ among one model's runs on the same part, tags first."""
    found: dict[str, None] = {}
    for one, other in combinations(folders, 2):
        if one.part == other.part:
            a, b = _facts(one), _facts(other)
            found |= dict.fromkeys(key for key in {**a, **b} if a.get(key) != b.get(key))
    tags = {key for folder in folders for key in folder.tags}
    return sorted(found, key=lambda key: (key not in tags, key))


def _label(model: str, folder: RunFolder, telling: Mapping[str, Sequence[str]]) -> str:
    facts = _facts(folder)
    told = [f"{key}={facts[key]}" for key in telling[model] if key in facts]
    return f"{model} ({', '.join(told)})" if told else model


def _natural(text: str) -> list[tuple[int, int, str]]:
    """Key that sorts the numbers within names as numbers."""
    parts = re.split(r"(\d+)", text)
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts]
