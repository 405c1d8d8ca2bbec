"""Names that tell runs apart: the model's, and as much of tags and settings as it takes."""

import re
from collections.abc import Mapping, Sequence
from itertools import combinations

from kinebench_drake.errors import UsageError
from kinebench_drake.suite_report.episode import Episode, Part, group
from kinebench_drake.suite_report.folder import Folder, model_of


def gather(folders: Sequence[Folder]) -> list[Episode]:
    """All episodes of some folders, model by model in the order in which the folders name them.

    Runs of one model on one part are one run (as shards are) unless tags or settings differ; what differs is put behind
    the model's name, as in "wan (data=25, steps=7500)". If they hold the same episodes all the same, the folders' names
    are put behind it.

    Raises:
        UsageError: two folders hold the same episode of a model, and nothing tells them apart.
    """
    telling = {model: _telling([f for f in folders if model in f.models]) for f in folders for model in f.models}
    episodes = [
        (index, Episode(part=f.part, model=_label(model_of(row), f, telling), folder=f.path, row=row))
        for index, f in enumerate(folders)
        for row in f.rows
    ]
    held: dict[tuple[str, Part, int], set[object]] = {}
    for index, episode in episodes:
        held.setdefault((episode.model, episode.part, index), set()).add(episode.key)
    clashing: set[tuple[str, Part]] = set()
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
        Episode(part=e.part, model=f"{e.model} [{folders[k].name}]", folder=e.folder, row=e.row)
        if (e.model, e.part) in clashing
        else e
        for k, e in episodes
    ]
    order = {model: number for number, model in enumerate(telling)}
    return sorted(named, key=lambda e: (order[model_of(e.row)], _natural(e.model), e.part, e.task, _natural(e.row.id)))


def models_of(episodes: Sequence[Episode]) -> list[str]:
    """Labels of the models, in the order of the episodes."""
    return list(group(episodes, lambda e: e.model))


def _facts(folder: Folder) -> Mapping[str, str]:
    """Tags and settings; a tag wins."""
    return {**folder.settings, **folder.tags}


def _telling(folders: Sequence[Folder]) -> list[str]:
    """Names of the tags and settings that differ among one model's runs on the same part, tags first."""
    found: dict[str, None] = {}
    for one, other in combinations(folders, 2):
        if one.part == other.part:
            a, b = _facts(one), _facts(other)
            found |= dict.fromkeys(key for key in {**a, **b} if a.get(key) != b.get(key))
    tags = {key for folder in folders for key in folder.tags}
    return sorted(found, key=lambda key: (key not in tags, key))


def _label(model: str, folder: Folder, telling: Mapping[str, Sequence[str]]) -> str:
    facts = _facts(folder)
    told = [f"{key}={facts[key]}" for key in telling[model] if key in facts]
    return f"{model} ({', '.join(told)})" if told else model


def _natural(text: str) -> list[tuple[int, int, str]]:
    """Key that sorts the numbers within names as numbers."""
    parts = re.split(r"(\d+)", text)
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts]
