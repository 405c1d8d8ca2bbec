"""Suites: tasks, seeds and pools of their splits, and the episodes that result from them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.resources import files
from typing import ClassVar

from pydantic import ConfigDict, TypeAdapter

from kinebench_drake.errors import UsageError, suggestion
from kinebench_drake.suites.composition import Episode, Pool, compose, episode_id
from kinebench_drake.suites.families.registry import TASKS, OwnTask, load_task
from kinebench_drake.suites.families.task import TaskVariant

NUMBERS = (0, 1, 2, 3)
"""Numbers of the suites."""
VERSION = "1"
"""Version of all suites, changed whenever an episode of the same id changes."""


class _Strict:
    """Base of the records of a suite's file, which have no other keys."""

    __slots__ = ()
    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid")


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeSpec:
    """Values that determine an episode."""

    task: str
    """Plain task id."""
    seed: int
    pool: Pool
    """Assets and looks to draw from."""
    variant: TaskVariant

    @property
    def id(self) -> str:
        """Id of the episode."""
        return episode_id(self.task, self.seed, self.pool, self.variant)

    def episode(self) -> Episode:
        """Compose the episode."""
        return compose(self.task, self.seed, pool=self.pool, variant=self.variant)


@dataclass(frozen=True, slots=True, kw_only=True)
class Split(_Strict):
    """Subset of a suite's episodes."""

    tasks: str
    """Name of the suite's list of tasks."""
    pool: Pool
    """Assets and looks to draw from."""
    seeds: tuple[int, int]
    """First seed of each task, and the end (exclusive)."""
    about: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Suite(_Strict):
    """Suite of tasks and splits."""

    number: int
    title: str
    about: str
    """Question that the suite answers."""
    evaluated: str
    """Name of the split for evaluation."""
    tasks: Mapping[str, tuple[str, ...]]
    """Lists of plain task ids by name."""
    splits: Mapping[str, Split]
    """Splits by name."""
    transfers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Trained tasks that each unseen task derives from."""

    def split_name(self, name: str | None) -> str:
        """Return the name of a split; that for evaluation for None, or for "test" if no split has this name.

        Raises:
            UsageError: there is no such split.
        """
        if name is None or (name == "test" and name not in self.splits):
            return self.evaluated
        if name not in self.splits:
            raise UsageError(f"suite {self.number} has no split {name!r}; it has {', '.join(self.splits)}")
        return name

    def tasks_of(self, split: str, chosen: Sequence[str] | None = None) -> tuple[str, ...]:
        """Return the tasks of a split, or the chosen ones, in the suite's order, then those of the user's own.

        Raises:
            UsageError: there is no such split, or a chosen task is not in it.
        """
        name = self.split_name(split)
        own = self.tasks[self.splits[name].tasks]
        for task in chosen or ():
            if task not in TASKS:
                raise UsageError(f"no task {task!r}{suggestion(task, TASKS)}; there are {', '.join(TASKS)}")
            if task not in own and not isinstance(task, OwnTask):
                raise UsageError(f"{task} is not in suite {self.number}'s split {name}, which has {', '.join(own)}")
        if chosen is None:
            return own
        return (*(task for task in own if task in chosen), *(task for task in chosen if isinstance(task, OwnTask)))

    def specs(
        self,
        split: str,
        count: int,
        *,
        tasks: Sequence[str] | None = None,
        offset: int = 0,
        variant: TaskVariant = TaskVariant.PLAIN,
    ) -> list[EpisodeSpec]:
        """Return `count` episodes of each task of a split, from its seed number `offset` on.

        A larger count begins with the episodes of a smaller one.

        Raises:
            UsageError: split, tasks or seeds are not in the suite.
        """
        part = self.splits[self.split_name(split)]
        first, end = part.seeds
        if offset < 0 or count < 0 or first + offset + count > end:
            raise UsageError(
                f"suite {self.number}'s split {split} has {end - first} seeds a task; $seed {offset} with {count} "
                "episodes leaves them"
            )
        seeds = range(first + offset, first + offset + count)
        return [
            EpisodeSpec(task=task, seed=seed, pool=part.pool, variant=variant)
            for task in self.tasks_of(split, tasks)
            for seed in seeds
        ]


@lru_cache
def load_suite(number: int) -> Suite:
    """Load a suite.

    Raises:
        UsageError: there is no such suite.
    """
    if number not in NUMBERS:
        raise UsageError(f"no suite {number}; there are {', '.join(map(str, NUMBERS))}")
    text = (files("kinebench_drake.suites") / "data" / f"suite{number}.json").read_text(encoding="utf-8")
    return TypeAdapter(Suite).validate_json(text)


def task_names(names: str | Sequence[str] | None) -> list[str] | None:
    """Parse task names, a list or comma-separated, with or without namespace, into plain ids without duplicates.

    A name `FILE.py:Class` loads a task of the user's own.
    """
    if names is None:
        return None
    return list(dict.fromkeys(map(_task_id, names.split(",") if isinstance(names, str) else names)))


def _task_id(name: str) -> str:
    if isinstance(name, OwnTask):
        return name
    name = name.strip()
    return load_task(name) if ".py:" in name else name.removeprefix("KineBench/")


def chosen_tasks(suite: Suite, split: str, names: str | Sequence[str] | None, variant: TaskVariant) -> tuple[str, ...]:
    """Return the named tasks of a split, which must have the variant, or all that have it.

    Raises:
        UsageError: a named task does not have it, or no task has.
    """
    tasks = suite.tasks_of(split, task_names(names))
    named = names is not None
    having = [task for task in tasks if variant in TASKS[task].card.variants]
    if not having or (named and len(having) < len(tasks)):
        which = ", ".join(task for task in tasks if task not in having) if named else "no task of this split"
        verb = "has no" if named else "has the"
        all_having = ", ".join(name for name, task in TASKS.items() if variant in task.card.variants)
        raise UsageError(f"{which} {verb} variant {variant.value!r}; tasks that have it: {all_having}")
    return tuple(having)
