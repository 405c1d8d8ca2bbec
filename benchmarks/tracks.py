"""Sets of trajectories with known truth: what is drawn for each number of a set, and a whole set on disk.

Every trajectory has its own random generator, seeded by the set's seed, its kind and its number: the same arguments
give the same bytes, whatever the number of jobs, and a larger set begins with the smaller one.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum
from functools import lru_cache
from pathlib import Path

import numpy as np

from benchmarks.feasible import Feasible, draw_feasible
from benchmarks.motion import Arm
from benchmarks.moves import Family
from benchmarks.perturbed import add_noise, perturb
from benchmarks.planted import PLANTERS
from benchmarks.sample import REASONS, TRUTH, Kind, Trajectory, Truth, write_truth
from kinebench_drake.errors import KinebenchError
from kinebench_drake.executors.base import WorkerCrash
from kinebench_drake.executors.local import LocalExecutor
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.types import Json

_BASES = 200  # feasible trajectories that the perturbed ones are made of
_PLANT_TRIES = 8  # faults drawn into one feasible trajectory before another is taken


class Set(Enum):
    """What a set is for."""

    FEASIBLE = "feasible"
    """None may be called infeasible."""
    INFEASIBLE = "infeasible"
    """All kinds of planted faults in turn: all must be found, and named."""
    PERTURBED = "perturbed"
    """Anything at all: judging may not crash."""
    NOISY = "noisy"
    """The feasible set, given as poses, with measurement noise: none may be called infeasible."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """How to draw a set; picklable."""

    set: Set
    seed: int
    noise_m: float = 0.0
    """Of a noisy set: standard deviation of the position along each axis [m]."""
    noise_rad: float = 0.0
    """The same about each axis [rad]."""


def draw(recipe: Recipe, index: int, arm: Arm) -> tuple[Trajectory, Truth]:
    """Trajectory number `index` of a set, and the truth about it."""
    if recipe.set is Set.PERTURBED:
        return _perturbed(recipe, index, arm)
    if recipe.set is Set.INFEASIBLE:
        return _planted(recipe, index, arm)
    rng = _generator(recipe.seed, Set.FEASIBLE, index)  # noise comes on top of the very same trajectories
    base = draw_feasible(rng, arm)
    trajectory = base.trajectory(arm)
    parameters = _proof(base)
    if recipe.set is Set.NOISY:
        trajectory = add_noise(_generator(recipe.seed, Set.NOISY, index), trajectory, recipe.noise_m, recipe.noise_rad)
        parameters |= {"noise_m": recipe.noise_m, "noise_rad": recipe.noise_rad}
        kind = Kind.NOISY
    else:
        kind = Kind.FEASIBLE
        if base.family is not Family.JOINT or rng.random() < 0.5:  # half of the joint paths are given as such
            trajectory = replace(trajectory, q=None)
    truth = Truth(id=f"{kind.value}-{index:05d}", kind=kind, family=base.family.value, parameters=parameters)
    return trajectory, truth


def _generator(seed: int, what: Set, index: int, attempt: int = 0) -> np.random.Generator:
    return np.random.default_rng([seed, list(Set).index(what), index, attempt])


def _proof(base: Feasible) -> dict[str, Json]:
    shown: dict[str, Json] = {"frames": base.frames, "period_s": base.period_s, "cut": base.cut}
    if base.proof is not None:
        shown |= {
            "position_margin_rad": base.proof.position_margin_rad,
            "velocity_ratio": base.proof.velocity,
            "acceleration_ratio": base.proof.acceleration,
            "jerk_ratio": base.proof.jerk,
            "torque_ratio": base.proof.torque,
            "self_distance_m": base.proof.self_distance_m,
            "table_distance_m": base.proof.table_distance_m,
        }
    return shown


def _planted(recipe: Recipe, index: int, arm: Arm) -> tuple[Trajectory, Truth]:
    kind = list(PLANTERS)[index % len(PLANTERS)]
    attempt = 0
    while True:
        rng = _generator(recipe.seed, Set.INFEASIBLE, index, attempt)
        base = draw_feasible(rng, arm)
        for _ in range(_PLANT_TRIES):
            planted = PLANTERS[kind](rng, arm, base)
            if planted is not None:
                parameters = {"frames": base.frames, "period_s": base.period_s, **planted.parameters}
                name = f"{kind.value}-{index:05d}"
                truth = Truth(
                    id=name, kind=kind, family=base.family.value, reasons=REASONS[kind], parameters=parameters
                )
                return planted.trajectory, truth
        attempt += 1


def _perturbed(recipe: Recipe, index: int, arm: Arm) -> tuple[Trajectory, Truth]:
    rng = _generator(recipe.seed, Set.PERTURBED, index)
    family, good = _base(recipe.seed, index % _BASES, arm)
    trajectory, names = perturb(rng, arm, good)
    truth = Truth(
        id=f"perturbed-{index:05d}",
        kind=Kind.PERTURBED,
        family=family.value,
        parameters={"disturbances": names, "frames": len(trajectory.t_s)},
    )
    return trajectory, truth


@lru_cache(maxsize=_BASES)
def _base(seed: int, index: int, arm: Arm) -> tuple[Family, Trajectory]:
    base = draw_feasible(_generator(seed, Set.FEASIBLE, index), arm, proven=False)
    return base.family, base.trajectory(arm)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Make:
    """Draws and writes one trajectory after the other; picklable."""

    recipe: Recipe
    out: Path

    def __call__(self) -> "_Writer":
        return _Writer(self.recipe, self.out)


class _Writer:
    def __init__(self, recipe: Recipe, out: Path) -> None:
        self._recipe, self._out, self._arm = recipe, out, Arm()

    def __call__(self, index: int) -> Truth:
        trajectory, truth = draw(self._recipe, index, self._arm)
        write_atomically(self._out / f"{truth.id}.npz", trajectory.to_bytes())
        return truth


def make(recipe: Recipe, count: int, out: Path, *, jobs: int = 1) -> Iterator[Truth]:
    """Write `count` trajectories into a folder, then truth.jsonl; yields the truths as they come.

    Raises:
        KinebenchError: writing failed, or a worker died.
    """
    out.mkdir(parents=True, exist_ok=True)
    truths: list[Truth] = []
    for outcome in LocalExecutor(jobs=jobs).run(_Make(recipe=recipe, out=out), range(count)):
        if isinstance(outcome, WorkerCrash):
            raise KinebenchError(f"trajectory {outcome.item} of the {recipe.set.value} set could not be drawn")
        truths.append(outcome.result)
        yield outcome.result
    write_truth(out / TRUTH, truths)
