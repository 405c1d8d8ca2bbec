"""The suites as data: which tasks, which seeds, which half of assets and looks; and the episodes that follow."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache
from importlib.resources import files
from itertools import product
from typing import ClassVar

from pydantic import ConfigDict, TypeAdapter

from kinebench_drake.errors import UsageError
from kinebench_drake.suites.episode import Episode, compose, episode_id
from kinebench_drake.suites.split import Pool
from kinebench_drake.suites.tasks.registry import TASKS
from kinebench_drake.suites.tasks.task import TaskVariant

_STRICT = ConfigDict(extra="forbid")
NUMBERS = (0, 1, 2, 3)
"""Numbers of the suites."""
VERSION = "1"
"""Of all suites together: another one whenever an episode of the same id is no longer the same."""


class Relation(Enum):
    """What an unseen task has to do with trained ones."""

    RECOMBINATION = "recombination"
    """Trained parts put together anew, elsewhere or the other way round."""
    HARDER = "harder"
    """A trained task that asks for more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeSpec:
    """What determines one episode."""

    task: str
    """Plain task id."""
    seed: int
    """Seed of the scene."""
    pool: Pool
    """Assets and looks to draw from."""
    variant: TaskVariant
    """Version of the scene."""

    @property
    def id(self) -> str:
        """Id of the episode."""
        return episode_id(self.task, self.seed, self.pool, self.variant)

    def episode(self) -> Episode:
        """The episode itself."""
        return compose(self.task, self.seed, pool=self.pool, variant=self.variant)


@dataclass(frozen=True, slots=True, kw_only=True)
class Split:
    """A part of a suite's episodes."""

    __pydantic_config__: ClassVar[ConfigDict] = _STRICT
    tasks: str
    """Name of the suite's list of tasks that it is about."""
    pool: Pool
    """Assets and looks to draw from."""
    seeds: tuple[int, int]
    """First seed of each task, and the first that is not the split's any more."""
    about: str
    """What it is for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Transfer:
    """Why an unseen task tells of transfer."""

    __pydantic_config__: ClassVar[ConfigDict] = _STRICT
    task: str
    """The unseen task."""
    relation: Relation
    """What it has to do with trained ones."""
    of: tuple[str, ...]
    """These trained tasks."""
    reason: str
    """What must be understood to do it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOut:
    """Why a task is not part of a suite."""

    __pydantic_config__: ClassVar[ConfigDict] = _STRICT
    task: str
    """The task."""
    reason: str
    """Why it is neither trained nor judged."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingPlan:
    """One training run of a study."""

    demonstrations: int
    """Demonstrations of each task."""
    steps: int
    """Optimisation steps."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SuiteStudy:
    """A grid of training runs."""

    __pydantic_config__: ClassVar[ConfigDict] = _STRICT
    demonstrations: tuple[int, ...]
    """Demonstrations of each task; the smaller sets are the beginnings of the larger ones."""
    steps: tuple[int, ...]
    """Optimisation steps."""

    def trainings(self) -> list[TrainingPlan]:
        """All runs, the cheapest data first."""
        return [TrainingPlan(demonstrations=n, steps=steps) for n, steps in product(self.demonstrations, self.steps)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Suite:
    """One of the suites."""

    __pydantic_config__: ClassVar[ConfigDict] = _STRICT
    number: int
    """Its number."""
    title: str
    """Its name."""
    about: str
    """What it asks."""
    evaluated: str
    """Name of the split that models are judged on."""
    tasks: Mapping[str, tuple[str, ...]]
    """Lists of plain task ids by name."""
    splits: Mapping[str, Split]
    """Splits by name."""
    transfers: tuple[Transfer, ...] = ()
    """Why its unseen tasks tell of transfer."""
    left_out: tuple[LeftOut, ...] = ()
    """Tasks that are no part of it."""
    study: SuiteStudy | None = None
    """TrainingPlan runs it asks for."""

    def split_name(self, name: str | None) -> str:
        """Name of a split; that which is judged if none is given, or if "test" is and no split is called so.

        Raises:
            UsageError: there is no such split.
        """
        if name is None or (name == "test" and name not in self.splits):
            return self.evaluated
        if name not in self.splits:
            raise UsageError(f"suite {self.number} has no split {name!r}; it has {', '.join(self.splits)}")
        return name

    def tasks_of(self, split: str, chosen: Sequence[str] | None = None) -> tuple[str, ...]:
        """Tasks of a split, or those chosen from them, in the suite's order.

        Raises:
            UsageError: there is no such split, or a chosen task is not in it.
        """
        name = self.split_name(split)
        own = self.tasks[self.splits[name].tasks]
        for task in chosen or ():
            if task not in TASKS:
                raise UsageError(f"no task {task!r}; there are {', '.join(TASKS)}")
            if task not in own:
                raise UsageError(f"{task} is not in suite {self.number}'s split {name}, which has {', '.join(own)}")
        return own if chosen is None else tuple(task for task in own if task in chosen)

    def draws(
        self, split: str, task: str, count: int, *, offset: int = 0, variant: TaskVariant = TaskVariant.PLAIN
    ) -> list[EpisodeSpec]:
        """The first `count` episodes of a task from the split's seed number `offset` on, none of them made yet.

        Raises:
            UsageError: the split has not as many seeds.
        """
        part = self.splits[self.split_name(split)]
        first, end = part.seeds
        if offset < 0 or count < 0 or first + offset + count > end:
            raise UsageError(
                f"suite {self.number}'s split {split} has {end - first} seeds a task; --seed {offset} with {count} "
                "episodes leaves them"
            )
        seeds = range(first + offset, first + offset + count)
        return [EpisodeSpec(task=task, seed=seed, pool=part.pool, variant=variant) for seed in seeds]

    def episodes(
        self,
        split: str,
        count: int,
        *,
        tasks: Sequence[str] | None = None,
        offset: int = 0,
        variant: TaskVariant = TaskVariant.PLAIN,
    ) -> list[Episode]:
        """`count` episodes of each of a split's tasks: a larger count begins with the episodes of a smaller one.

        Raises:
            UsageError: split, tasks or seeds are not the suite's, or a task has no such variant.
        """
        return [
            draw.episode()
            for task in self.tasks_of(split, tasks)
            for draw in self.draws(split, task, count, offset=offset, variant=variant)
        ]


@lru_cache
def load_suite(number: int) -> Suite:
    """The suite of a number.

    Raises:
        UsageError: there is none.
    """
    if number not in NUMBERS:
        raise UsageError(f"no suite {number}; there are {', '.join(map(str, NUMBERS))}")
    text = (files("kinebench_drake.suites") / "data" / f"suite{number}.json").read_text(encoding="utf-8")
    return TypeAdapter(Suite).validate_json(text)
