"""Thousands of inputs, each a valid one made wrong, read one after the other; what fails is kept."""

import json
import shutil
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinebench_drake.row import Json, dump
from kinebench_drake.validation.fuzz.kinds import KINDS
from kinebench_drake.validation.fuzz.mutation import mutate
from kinebench_drake.validation.fuzz.tree import Tree, write_tree
from kinebench_drake.validation.fuzz.worker import Fate, Outcome, Worker

FAILURES = "failures"
"""Folder of the inputs that failed, each with `failure.json` beside what was read."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """One input and what became of it."""

    number: int
    kind: str
    outcome: Outcome
    wall_s: float


class Campaign:
    """Draws inputs by a seed and their numbers: the same seed, the same inputs."""

    def __init__(self, seed: int) -> None:
        """Make the valid inputs."""
        self._seed = seed
        self._trees = [list(kind.trees()) for kind in KINDS]
        weights = np.array([kind.weight for kind in KINDS])
        self._shares = weights / weights.sum()

    def draw(self, number: int) -> tuple[int, Tree]:
        """Number of an input's kind, and the input."""
        rng = np.random.default_rng([self._seed, number])
        kind = int(rng.choice(len(KINDS), p=self._shares))
        trees = self._trees[kind]
        return kind, mutate(rng, trees[int(rng.integers(len(trees)))])

    def run(self, numbers: Sequence[int], out: Path) -> Iterator[Trial]:
        """Read the inputs of these numbers; those that fail are kept below `out`."""
        home = out / "work"
        shutil.rmtree(home, ignore_errors=True)
        home.mkdir(parents=True)
        worker = Worker(home.resolve())
        try:
            for number in numbers:
                kind, tree = self.draw(number)
                folder = home.resolve() / f"{number}" / "input"
                write_tree(tree, folder)
                begin = time.monotonic()
                outcome = worker.read(kind, folder)
                trial = Trial(number=number, kind=KINDS[kind].name, outcome=outcome, wall_s=time.monotonic() - begin)
                shutil.rmtree(folder.parent, ignore_errors=True)
                if not outcome.fate.good:
                    self._keep(trial, tree, out)
                yield trial
        finally:
            worker.close()
            shutil.rmtree(home, ignore_errors=True)

    def _keep(self, trial: Trial, tree: Tree, out: Path) -> None:
        folder = out / FAILURES / f"{trial.number:06d}"
        shutil.rmtree(folder, ignore_errors=True)
        write_tree(tree, folder / "input")
        told: dict[str, Json] = {
            "seed": self._seed,
            "number": trial.number,
            "kind": trial.kind,
            "fate": trial.outcome.fate.value,
            "told": trial.outcome.told,
        }
        (folder / "failure.json").write_text(dump(told, indent=1))


def table(trials: Sequence[Trial]) -> Iterator[str]:
    """Inputs of each kind: how many, read, refused, failed in what way; the longest time one took."""
    bad = [fate for fate in Fate if not fate.good]
    yield f"{'kind':<22}{'inputs':>8}{'read':>8}{'refused':>9}{'failed':>8}{'longest':>10}  of the failed"
    groups = {kind.name: [trial for trial in trials if trial.kind == kind.name] for kind in KINDS}
    for name, some in {**groups, "all": list(trials)}.items():
        if not some:
            continue
        counts = Counter(trial.outcome.fate for trial in some)
        failed = {fate.value: counts[fate] for fate in bad if counts[fate]}
        told = ", ".join(f"{n} {fate}" for fate, n in failed.items())
        longest = max(trial.wall_s for trial in some)
        yield (
            f"{name:<22}{len(some):>8}{counts[Fate.READ]:>8}{counts[Fate.REFUSED]:>9}{sum(failed.values()):>8}"
            f"{longest:>8.1f} s  {told}"
        )


def distinct(trials: Sequence[Trial]) -> dict[str, list[int]]:
    """Numbers of the failed inputs by what they have in common: the kind of failure and its last line."""
    found: dict[str, list[int]] = {}
    for trial in trials:
        if not trial.outcome.fate.good:
            last = (trial.outcome.told.strip().splitlines() or [""])[-1]
            found.setdefault(f"{trial.outcome.fate.value}: {json.dumps(last)[1:-1][:120]}", []).append(trial.number)
    return found
