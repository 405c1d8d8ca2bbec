"""Output folders of `suite run`: read, checked for compatibility, and pooled into episodes."""

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

from kinebench_drake.errors import UsageError
from kinebench_drake.io.jsonl import Json, dump
from kinebench_drake.report.run import Run, read_runs
from kinebench_drake.report.suite.episode import EpisodeResult, SuitePart, group_by
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.store import RESULTS

_KIND = "suite"
_NAME = re.compile(r"[A-Za-z0-9_-]{1,40}")
"""Names of splits and variants: parts of file names and of ids in the page."""
_SETTINGS = (
    *("rounds", "control", "action_repeat", "frame_period_s", "clip_timing", "pixels_only"),
    *("prompt_prefix", "prompt_suffix", "prompts", "negative_prompt", "condition"),
)
"""Settings of a run that change the results of its episodes."""
_DIGITS = 6
"""Digits of a hash in a label."""
_MAX_LETTERS = 24
"""Letters of a setting that a label has room for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunFolder:
    """One output folder of a suite run."""

    path: Path
    part: SuitePart
    rows: tuple[SampleRow, ...]
    """Episodes, sorted by id."""
    planned: int | None
    """Episodes of the whole run, ignoring shards and limits; None if unknown."""
    config: Mapping[str, Json]
    """Configuration of the run."""
    tags: Mapping[str, str]
    """Tags of `suite run --tag`."""
    settings: Mapping[str, str]
    """Those of _SETTINGS that are set, as text."""
    spec: str | None
    """First digits of the SHA-256 of the world model's spec; None if unknown."""

    @property
    def name(self) -> str:
        """Last component of the path."""
        return self.path.resolve().name

    @property
    def models(self) -> list[str]:
        """Names of the models in it, in the order of its rows."""
        return list(dict.fromkeys(model_of(row) for row in self.rows))

    @property
    def options(self) -> Mapping[str, str]:
        """Settings and tags by name; a tag overrides a setting."""
        return {**self.settings, **self.tags}


def model_of(row: SampleRow) -> str:
    """Return the name of a row's model."""
    return row.model or "unnamed"


def read_folders(paths: Sequence[Path]) -> list[RunFolder]:
    """Read the output folders of suite runs.

    Raises:
        UsageError: there is none, one is named twice, is broken, unfinished, empty or of another kind of run, or they
            have different schema or suite versions.
    """
    return [_suite_folder(run) for run in read_runs(paths)]


def _suite_folder(run: Run) -> RunFolder:
    if run.kind != _KIND:
        raise UsageError(f"{run.path}: is of a run of kind {run.kind!r}, expected {_KIND!r}")
    suite, split, variant = run.config.get("suite"), run.config.get("split"), run.config.get("variant", "plain")
    if not isinstance(suite, int) or not all(isinstance(v, str) and _NAME.fullmatch(v) for v in (split, variant)):
        raise UsageError(
            f"{run.path / RESULTS}: config names no suite, split and variant, expected those of a suite run"
        )
    return RunFolder(
        path=run.path,
        part=SuitePart(suite=suite, split=str(split), variant=str(variant)),
        rows=run.rows,
        planned=run.planned,
        config=run.config,
        tags=run.tags,
        settings={
            name: _format_setting(run.config[name]) for name in _SETTINGS if run.config.get(name) not in (None, "")
        },
        spec=str(spec)[:_DIGITS] if (spec := run.config.get("world_model_sha256")) else None,
    )


def _format_setting(value: object) -> str:
    """Format a setting for a label; a long text is cut and followed by its hash."""
    if isinstance(value, Mapping):
        value = dump(value).strip()
    if isinstance(value, str) and len(value) > _MAX_LETTERS:
        return f"{value[:_MAX_LETTERS]}… {hashlib.sha256(value.encode()).hexdigest()[:_DIGITS]}"
    return str(value).lower() if isinstance(value, bool) else f"{value:g}" if isinstance(value, float) else str(value)


def pool_episodes(folders: Sequence[RunFolder]) -> list[EpisodeResult]:
    """List all episodes of some folders, model by model in the order in which the folders name them.

    Folders of one model on one part are pooled into one run (such as shards) unless tags, settings or the specs of the
    world models differ; the differences are appended to the model's name, as in "wan (data=25, steps=7500)", of specs
    where the others are equal. If folders of one label hold the same episodes, their names are appended.

    Raises:
        UsageError: two folders of the same name hold the same episode of a model.
    """
    labels, order = _label_models(folders), list(dict.fromkeys(model for f in folders for model in f.models))
    conflicts = _conflicting_specs(folders, labels)
    names = {
        (k, model): f"{label} (spec={folders[k].spec})" if label in conflicts else label
        for (k, model), label in labels.items()
    }
    episodes = [
        (index, EpisodeResult(part=f.part, model=names[index, model], folder=f.path, row=row))
        for index, f in enumerate(folders)
        for row in f.rows
        for model in [model_of(row)]
    ]
    keys: dict[tuple[str, SuitePart, int], set[object]] = {}
    for index, episode in episodes:
        keys.setdefault((episode.model, episode.part, index), set()).add((episode.key, episode.row.sample_index))
    clashing: set[tuple[str, SuitePart]] = set()
    for (one, these), (other, those) in combinations(keys.items(), 2):
        if one[:2] == other[:2] and these & those:
            a, b = folders[one[2]], folders[other[2]]
            if a.name == b.name:
                raise UsageError(
                    f"{a.path} and {b.path} hold the same episodes of {one[0]}: name one of them, or distinguish them "
                    "with `suite run --tag KEY=VALUE`"
                )
            clashing.add(one[:2])
    named = [
        replace(e, model=f"{e.model} [{folders[k].name}]") if (e.model, e.part) in clashing else e for k, e in episodes
    ]
    return sorted(
        named, key=lambda e: (order.index(model_of(e.row)), _natural(e.model), e.part, e.task, _natural(e.row.id))
    )


def spec_warnings(folders: Sequence[RunFolder]) -> list[str]:
    """Return a warning for each name that several world models have on one part of the suites."""
    conflicts = _conflicting_specs(folders, _label_models(folders))
    return [
        f"{label} is the name of {len(of)} world models ({', '.join(f'{spec} in {run}' for spec, run in of.items())}), "
        "kept apart by their specs; name each with --model NAME or ?name=NAME in its spec"
        for label, of in conflicts.items()
    ]


def setting_warnings(folders: Sequence[RunFolder], episodes: Sequence[EpisodeResult]) -> list[str]:
    """Return a warning for each model whose runs on different parts have different settings."""
    paths = {model: {e.folder for e in own} for model, own in group_by(episodes, lambda e: e.model).items()}
    warnings = []
    for model, own in paths.items():
        runs = [f for f in folders if f.path in own]
        for name in differing_settings(runs):
            values = ", ".join(f"{f.settings.get(name, 'unset')} in {f.name}" for f in runs)
            warnings.append(f"runs of {model} differ in {name} ({values}): its numbers on them are not comparable")
    return warnings


def differing_settings(folders: Sequence[RunFolder]) -> list[str]:
    """List the settings in which some runs differ."""
    return [name for name in _SETTINGS if len({f.settings.get(name) for f in folders}) > 1]


def _conflicting_specs(
    folders: Sequence[RunFolder], labels: Mapping[tuple[int, str], str]
) -> dict[str, dict[str | None, str]]:
    """Return the specs of each label that stands for several on one part, each with a folder that has it."""
    specs: dict[tuple[str, SuitePart], dict[str | None, str]] = {}
    for (index, _), label in labels.items():
        specs.setdefault((label, folders[index].part), {}).setdefault(folders[index].spec, folders[index].name)
    return {label: of for (label, _), of in specs.items() if len(of) > 1}


def _label_models(folders: Sequence[RunFolder]) -> dict[tuple[int, str], str]:
    """Return the label of each model in each folder, by number of the folder and name: with the options that differ."""
    differing = {model: _differing([f for f in folders if model in f.models]) for f in folders for model in f.models}
    return {(k, model): _label(model, f, differing[model]) for k, f in enumerate(folders) for model in f.models}


def _differing(folders: Sequence[RunFolder]) -> list[str]:
    """List the tags and settings that differ among one model's runs on the same part, tags first."""
    names: set[str] = set()
    for one, other in combinations(folders, 2):
        if one.part == other.part:
            a, b = one.options, other.options
            names |= {key for key in {**a, **b} if a.get(key) != b.get(key)}
    tags = {key for folder in folders for key in folder.tags}
    return sorted(names, key=lambda key: (key not in tags, key))


def _label(model: str, folder: RunFolder, differing: Sequence[str]) -> str:
    options = [f"{key}={folder.options[key]}" for key in differing if key in folder.options]
    return f"{model} ({', '.join(options)})" if options else model


def _natural(text: str) -> list[tuple[int, int, str]]:
    """Return a sort key that compares the numbers within names as numbers."""
    parts = re.split(r"(\d+)", text)
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts]
