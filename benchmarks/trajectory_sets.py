"""Sets of trajectories with ground truth: drawing one by its number, and writing a whole set.

Every trajectory has its own random generator, seeded by the set's seed, its kind and its number: the same arguments
give the same bytes, whatever the number of jobs, and a larger set begins with the smaller one.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.feasible import draw_feasible
from benchmarks.motion import Arm
from benchmarks.moves import Family
from benchmarks.planted import PLANTERS
from benchmarks.trajectory import REASONS, TRUTH, Trajectory, TrajectoryKind, TrajectoryTruth, add_noise, write_truths
from benchmarks.trials import run_all
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.io.jsonl import Json

PLANT_TRIES = 8
"""Attempts to plant a fault into one feasible trajectory."""


class TrajectorySet(Enum):
    """Purpose of a set."""

    FEASIBLE = "feasible"
    """None may be judged infeasible."""
    INFEASIBLE = "infeasible"
    """All kinds of planted faults in turn: each must be detected, with the right reason."""
    NOISY = "noisy"
    """The feasible set as poses with measurement noise: none may be judged infeasible."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """Parameters of a set; picklable."""

    set: TrajectorySet
    seed: int
    noise_m: float = 0.0
    """Standard deviation of the position along each axis, of a noisy set [m]."""
    noise_rad: float = 0.0
    """Standard deviation of the rotation about each axis, of a noisy set [rad]."""


def draw(recipe: Recipe, index: int, arm: Arm) -> tuple[Trajectory, TrajectoryTruth]:
    """Draw trajectory number `index` of a set, with its ground truth."""
    if recipe.set is TrajectorySet.INFEASIBLE:
        return _planted(recipe, index, arm)
    rng = _generator(recipe.seed, TrajectorySet.FEASIBLE, index)  # noise is added to the same trajectories
    base = draw_feasible(rng, arm)
    trajectory = base.trajectory(arm)
    parameters: dict[str, Json] = {"frames": base.frames, "period_s": base.period_s}
    if recipe.set is TrajectorySet.NOISY:
        noise = _generator(recipe.seed, TrajectorySet.NOISY, index)
        trajectory = add_noise(noise, trajectory, recipe.noise_m, recipe.noise_rad)
        parameters |= {"noise_m": recipe.noise_m, "noise_rad": recipe.noise_rad}
        kind = TrajectoryKind.NOISY
    else:
        kind = TrajectoryKind.FEASIBLE
        if base.family is not Family.JOINT or rng.random() < 0.5:  # half of the joint paths are written as joint angles
            trajectory = replace(trajectory, q=None)
    truth = TrajectoryTruth(id=f"{kind.value}-{index:05d}", kind=kind, family=base.family.value, parameters=parameters)
    return trajectory, truth


_STREAMS = {TrajectorySet.FEASIBLE: 0, TrajectorySet.INFEASIBLE: 1, TrajectorySet.NOISY: 3}
"""Numbers of the random streams, the same as in earlier revisions, so that a seed gives the same set."""


def _generator(seed: int, set: TrajectorySet, index: int, attempt: int = 0) -> np.random.Generator:
    return np.random.default_rng([seed, _STREAMS[set], index, attempt])


def _planted(recipe: Recipe, index: int, arm: Arm) -> tuple[Trajectory, TrajectoryTruth]:
    kind = list(PLANTERS)[index % len(PLANTERS)]
    attempt = 0
    while True:
        rng = _generator(recipe.seed, TrajectorySet.INFEASIBLE, index, attempt)
        base = draw_feasible(rng, arm)
        for _ in range(PLANT_TRIES):
            planted = PLANTERS[kind](rng, arm, base)
            if planted is not None:
                parameters = {"frames": base.frames, "period_s": base.period_s, **planted.parameters}
                truth = TrajectoryTruth(
                    id=f"{kind.value}-{index:05d}",
                    kind=kind,
                    family=base.family.value,
                    reasons=REASONS[kind],
                    parameters=parameters,
                )
                return planted.trajectory, truth
        attempt += 1


class _Writer:
    """Draws and writes one trajectory after the other."""

    def __init__(self, recipe: Recipe, out: Path) -> None:
        self._recipe = recipe
        self._out = out
        self._arm = Arm()

    def __call__(self, index: int) -> TrajectoryTruth:
        trajectory, truth = draw(self._recipe, index, self._arm)
        write_atomically(self._out / f"{truth.id}.npz", trajectory.to_bytes())
        return truth


def write_set(recipe: Recipe, count: int, out: Path, *, jobs: int = 1) -> Iterator[TrajectoryTruth]:
    """Write `count` trajectories into a folder, then truth.jsonl; yields each truth when its file is written.

    Raises:
        KinebenchError: writing failed, or a worker died.
    """
    out.mkdir(parents=True, exist_ok=True)
    truths: list[TrajectoryTruth] = []
    for truth in run_all(partial(_Writer, recipe, out), range(count), jobs):
        truths.append(truth)
        yield truth
    write_truths(out / TRUTH, truths)
