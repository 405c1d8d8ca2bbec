"""Output folders of `suite run`: read, checked for compatibility, and pooled into episodes."""

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

from kinebench_drake.errors import UsageError
from kinebench_drake.formats.kinebench import is_run, read_rows
from kinebench_drake.io.jsonl import Json, dump
from kinebench_drake.report.run import Run, read_runs
from kinebench_drake.results.aggregate import group_by
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.store import RESULTS
from kinebench_drake.suites.report.episode_result import EpisodeResult, SuitePart

_KIND = "suite"
_NAME = re.compile(r"[A-Za-z0-9_-]{1,40}")
"""Names of splits and variants: parts of file names and of ids in the page."""
_SETTINGS = (
    *("rounds", "control", "frame_period_s", "clip_timing", "pixels_only"),
    *("prompts", "negative_prompt", "condition"),
)
"""Settings of a run that change the results of its episodes."""
_DIGITS = 6
"""Digits of a hash in a label."""
_MAX_LETTERS = 24
"""Letters of a setting that a label has room for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SuiteRun(Run):
    """One output folder of `suite run`."""

    part: SuitePart

    @property
    def models(self) -> list[str]:
        """Names of the models in it, in the order of its rows."""
        return list(dict.fromkeys(model_of(row) for row in self.rows))

    @property
    def settings(self) -> Mapping[str, str]:
        """Those of _SETTINGS that are set, as text."""
        return {
            name: _format_setting(self.config[name]) for name in _SETTINGS if self.config.get(name) not in (None, "")
        }

    @property
    def options(self) -> Mapping[str, str]:
        """Settings and tags by name; a tag overrides a setting."""
        return {**self.settings, **self.tags}

    @property
    def spec(self) -> str | None:
        """First digits of the SHA-256 of the world model's spec; None if unknown."""
        spec = self.config.get("world_model_sha256")
        return str(spec)[:_DIGITS] if spec else None


def model_of(row: SampleRow) -> str:
    """Return the name of a row's model."""
    return row.model or "unnamed"


def read_suite_runs(paths: Sequence[Path]) -> list[SuiteRun]:
    """Read the output folders of suite runs."""
    others = [path for path in paths if path.is_dir() and is_run(path)]
    own = [path for path in paths if path not in others]
    runs = [_check_kind(run) for run in read_runs(own)] if own or not others else []
    return [*runs, *map(_read_kinebench, others)]


def _read_kinebench(path: Path) -> SuiteRun:
    """Read the outcomes of a run of KineBench; its scenes are its own, so they are a part of their own."""
    rows = tuple(read_rows(path))
    header: dict[str, Json] = {"kind": _KIND, "config": {"suite": 0, "split": "kinebench"}}
    return SuiteRun(path=path, rows=rows, results=header, part=SuitePart(suite=0, split="kinebench"))


def _check_kind(run: Run) -> SuiteRun:
    if run.kind != _KIND:
        raise UsageError(f"{run.path}: is of a run of kind {run.kind!r}, expected {_KIND!r}")
    suite = run.config.get("suite")
    split = run.config.get("split")
    variant = run.config.get("variant", "plain")
    if not isinstance(suite, int) or not all(isinstance(v, str) and _NAME.fullmatch(v) for v in (split, variant)):
        raise UsageError(
            f"{run.path / RESULTS}: config names no suite, split and variant, expected those of a suite run"
        )
    return SuiteRun(
        path=run.path,
        rows=run.rows,
        results=run.results,
        part=SuitePart(suite=suite, split=str(split), variant=str(variant)),
    )


def _format_setting(value: object) -> str:
    """Format a setting for a label; a long text is cut and followed by its hash."""
    if isinstance(value, Mapping):
        value = dump(value).strip()
    if isinstance(value, str) and len(value) > _MAX_LETTERS:
        return f"{value[:_MAX_LETTERS]}… {hashlib.sha256(value.encode()).hexdigest()[:_DIGITS]}"
    return str(value).lower() if isinstance(value, bool) else f"{value:g}" if isinstance(value, float) else str(value)


def pool_episodes(runs: Sequence[SuiteRun]) -> list[EpisodeResult]:
    """List all episodes of some runs, model by model in the order in which the runs name them.

    Runs of one model on one part are pooled into one (such as shards) unless tags, settings or the specs of the world
    models differ; the differences are appended to the model's name, as in "wan (data=25, steps=7500)", of specs where
    the others are equal. If runs of one label hold the same episodes, the names of their folders are appended.

    Raises:
        UsageError: two folders of the same name hold the same episode of a model.
    """
    labels = _label_models(runs)
    order = list(dict.fromkeys(model for run in runs for model in run.models))
    conflicts = _conflicting_specs(runs, labels)
    names = {
        (k, model): f"{label} (spec={runs[k].spec})" if label in conflicts else label
        for (k, model), label in labels.items()
    }
    episodes = [
        (k, EpisodeResult(part=run.part, model=names[k, model_of(row)], folder=run.path, row=row))
        for k, run in enumerate(runs)
        for row in run.rows
    ]
    keys: dict[tuple[str, SuitePart, int], set[object]] = {}
    for k, episode in episodes:
        keys.setdefault((episode.model, episode.part, k), set()).add((episode.key, episode.row.sample_index))
    clashing: set[tuple[str, SuitePart]] = set()
    for (one, these), (other, those) in combinations(keys.items(), 2):
        if one[:2] == other[:2] and these & those:
            a = runs[one[2]]
            b = runs[other[2]]
            if a.name == b.name:
                raise UsageError(
                    f"{a.path} and {b.path} hold the same episodes of {one[0]}: name one of them, or distinguish them "
                    "with `suite run --tag KEY=VALUE`"
                )
            clashing.add(one[:2])
    named = [
        replace(e, model=f"{e.model} [{runs[k].name}]") if (e.model, e.part) in clashing else e for k, e in episodes
    ]
    return sorted(
        named, key=lambda e: (order.index(model_of(e.row)), _natural(e.model), e.part, e.task, _natural(e.row.id))
    )


def spec_warnings(runs: Sequence[SuiteRun]) -> list[str]:
    """Return a warning for each name that several world models have on one part of the suites."""
    return [
        f"{label} is the name of {len(of)} world models ({', '.join(f'{spec} in {run}' for spec, run in of.items())}), "
        "kept apart by their specs; name each with --model NAME or ?name=NAME in its spec"
        for label, of in _conflicting_specs(runs, _label_models(runs)).items()
    ]


def differing_settings(runs: Sequence[SuiteRun]) -> list[str]:
    """List the settings in which some runs differ."""
    settings = [run.settings for run in runs]
    return [name for name in _SETTINGS if len({own.get(name) for own in settings}) > 1]


def _conflicting_specs(
    runs: Sequence[SuiteRun], labels: Mapping[tuple[int, str], str]
) -> dict[str, dict[str | None, str]]:
    """Return the specs of each label that stands for several on one part, each with a folder that has it."""
    specs: dict[tuple[str, SuitePart], dict[str | None, str]] = {}
    for (k, _), label in labels.items():
        specs.setdefault((label, runs[k].part), {}).setdefault(runs[k].spec, runs[k].name)
    return {label: of for (label, _), of in specs.items() if len(of) > 1}


def _label_models(runs: Sequence[SuiteRun]) -> dict[tuple[int, str], str]:
    """Return the label of each model in each run, by number of the run and name: with the options that differ."""
    models = dict.fromkeys(model for run in runs for model in run.models)
    differing = {model: _list_differing([run for run in runs if model in run.models]) for model in models}
    return {(k, model): _label(model, run, differing[model]) for k, run in enumerate(runs) for model in run.models}


def _list_differing(runs: Sequence[SuiteRun]) -> list[str]:
    """List the tags and settings that differ among one model's runs on the same part, tags first."""
    names: set[str] = set()
    for own in group_by(runs, lambda run: run.part).values():
        options = [run.options for run in own]
        names |= {key for some in options for key in some if len({other.get(key) for other in options}) > 1}
    tags = {key for run in runs for key in run.tags}
    return sorted(names, key=lambda key: (key not in tags, key))


def _label(model: str, run: SuiteRun, differing: Sequence[str]) -> str:
    options = [f"{key}={run.options[key]}" for key in differing if key in run.options]
    return f"{model} ({', '.join(options)})" if options else model


def _natural(text: str) -> list[tuple[int, int, str]]:
    """Return a sort key that compares the numbers within names as numbers."""
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in re.split(r"(\d+)", text)]
