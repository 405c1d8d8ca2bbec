"""How success grows with demonstrations and optimisation steps, by the difficulty of tasks."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from kinebench_drake.report.suite.episode import EpisodeResult, group
from kinebench_drake.report.suite.folders import RunFolder, model_of
from kinebench_drake.report.suite.tally import mean
from kinebench_drake.results.aggregate import Estimate

SUITE = 3
"""Number of the suite that asks for it."""
TAGS = ("data", "steps")
"""Tags that name a run's demonstrations of each task and its optimisation steps."""
ALL = "all"
UNKNOWN = "unknown"
"""Difficulty of tasks that are not the suites'."""


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class TrainingBudget:
    """What a model was trained with."""

    data: int
    """Demonstrations of each task."""
    steps: int
    """Optimisation steps."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scaling:
    """Success of one model after different trainings."""

    model: str
    """Its plain name."""
    levels: tuple[str, ...]
    """Difficulties that its tasks have, and ALL."""
    success: Mapping[tuple[TrainingBudget, str], Estimate]
    """Task-balanced success of each training and difficulty."""

    @property
    def trainings(self) -> list[TrainingBudget]:
        """What it was trained with, the least data first."""
        return sorted({training for training, _ in self.success})


def study_scaling(
    folders: Sequence[RunFolder], episodes: Sequence[EpisodeResult], difficulties: Mapping[str, str], seed: int = 0
) -> list[Scaling]:
    """Task-balanced success of each model's runs on suite 3 by training and difficulty; runs of a training are pooled.

    Args:
        folders: the runs; those without readable tags are passed over.
        episodes: their episodes.
        difficulties: name of each task's difficulty, in rising order of difficulty.
        seed: of the intervals' resampling.
    """
    trained: dict[Path | None, TrainingBudget] = {
        f.path: training for f in folders if f.part.suite == SUITE and (training := training_of(f))
    }
    chosen = [e for e in episodes if e.folder in trained]
    found = []
    for model, own in group(chosen, lambda e: model_of(e.row)).items():
        level = {e.task: difficulties.get(e.task, UNKNOWN) for e in own}
        order = [*dict.fromkeys(difficulties.values()), UNKNOWN]
        levels = [name for name in order if name in level.values()]
        success = {}
        for training, runs in group(own, lambda e: trained[e.folder]).items():
            for name in (*levels, ALL):
                some = [e for e in runs if name in (ALL, level[e.task])]
                if some:
                    success[training, name] = mean(some, lambda e: e.hit, seed)
        found.append(Scaling(model=model, levels=(*levels, ALL), success=success))
    return found


def training_of(folder: RunFolder) -> TrainingBudget | None:
    """What the tags of a run say of its training; None unless both do."""
    data, steps = (_count(folder.tags.get(name, "")) for name in TAGS)
    return None if data is None or steps is None else TrainingBudget(data=data, steps=steps)


def untagged(folders: Sequence[RunFolder]) -> list[Path]:
    """Runs on suite 3 whose tags do not tell their training."""
    return [f.path for f in folders if f.part.suite == SUITE and training_of(f) is None]


def task_difficulties() -> dict[str, str]:
    """Difficulty of each task of the suites, the easy ones first."""
    from kinebench_drake.suites.tasks.card import Difficulty
    from kinebench_drake.suites.tasks.registry import TASKS

    cards = sorted((task.card for task in TASKS.values()), key=lambda card: list(Difficulty).index(card.difficulty))
    return {card.id: card.difficulty.value for card in cards}


def _count(text: str) -> int | None:
    """A count such as "7500" or "7.5k"."""
    match = re.fullmatch(r"(\d{1,9}(?:\.\d{1,3})?)(k?)", text.strip().lower())
    if not match:
        return None
    value = float(match[1]) * (1000.0 if match[2] else 1.0)
    return int(value) if value == int(value) and value > 0 else None
