"""Response of numbers to planted faults."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property

import numpy as np
from scipy.stats import false_discovery_control

from benchmarks.faults.fault import GRADES, unit_of
from benchmarks.validity import ValidityTrial
from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array
from kinebench_drake.results.direction import HIGHER_IS_BETTER
from kinebench_drake.runs.evaluator import KINEMATIC_METRICS
from kinebench_drake.runs.score import VISUAL_METRICS
from kinebench_drake.stats import (
    IntervalEstimate,
    paired_mean_difference,
    percentile_interval,
    resampled_counts,
    sign_test,
)

NUMBERS = ("executable", "feasible", *(name for name in VISUAL_METRICS if name != "anomalies"), *KINEMATIC_METRICS)
"""Numbers that the study is about."""
SEPARATION = 0.8
"""Least area under the ROC curve of a number that separates faulty videos from clean ones."""
DECIMALS = 6
"""Decimals to which values are compared: 1e-6 m is the tolerance of inverse kinematics."""
FALSE_DISCOVERIES = 0.05
"""Expected share of chance results among all responses (Benjamini and Hochberg 1995)."""


class Verdict(Enum):
    """Response of a number to a kind of fault."""

    SEPARATES = "separates"
    """Worse, by so much that the greatest size shows without the clean video of the same episode."""
    RESPONDS = "responds"
    """Worse than in the clean video of the same episode."""
    SILENT = "silent"
    """No response that is distinct from chance."""
    IMPROVES = "improves"
    """Better than in the clean video: the number is not for this fault."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Grade:
    """Kind and size of a fault."""

    kind: AnomalyKind
    size: float

    @property
    def number(self) -> str:
        """Size in the unit of `unit_of`."""
        return f"{self.size * GRADES[self.kind].factor:g}"

    @property
    def label(self) -> str:
        """Size with its unit."""
        unit = unit_of(self.kind)
        return f"{self.number} {unit.removesuffix('s') if self.number == '1' else unit}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """Response of a number to a grade, over episodes that have both videos."""

    episodes: int
    change: IntervalEstimate | None
    """Mean change against the clean video where both have the number; None if no episode has."""
    nulls: int
    """Faulty videos in which the number is null although the clean one has it."""
    worse: int
    """Episodes in which it gets worse; a null is the worst value."""
    better: int
    area: IntervalEstimate
    """Area under the ROC curve of faulty against clean videos, 0.5: no separation, 1: all faulty ones are worse."""

    @property
    def p_value(self) -> float:
        """Two-sided p-value of the sign test of worse against better."""
        return sign_test(self.worse, self.better)


class Study:
    """Trials of a study by episode and grade."""

    def __init__(self, trials: Sequence[ValidityTrial], seed: int = 0) -> None:
        """Sort the trials.

        Raises:
            InputError: there is no clean video.
        """
        self.clean = {t.episode: t for t in trials if t.kind is None}
        """Trials without a fault, by episode."""
        self.faulty: dict[Grade, dict[str, ValidityTrial]] = {}
        """Trials with a fault, by grade and episode."""
        for t in trials:
            if t.kind is not None:
                self.faulty.setdefault(Grade(kind=t.kind, size=t.size), {})[t.episode] = t
        if not self.clean:
            raise InputError("the study has no clean video")
        self.trials = tuple(trials)
        self._seed = seed

    @property
    def kinds(self) -> list[AnomalyKind]:
        """Kinds of faults, in the order of `AnomalyKind`."""
        return [kind for kind in AnomalyKind if any(grade.kind is kind for grade in self.faulty)]

    def grades(self, kind: AnomalyKind) -> list[Grade]:
        """Return the grades of a kind, from the least size to the greatest."""
        return sorted((grade for grade in self.faulty if grade.kind is kind), key=lambda grade: grade.size)

    @cached_property
    def responses(self) -> Mapping[tuple[str, Grade], Response]:
        """Response of each number to each grade."""
        return {(name, grade): self._response(name, grade) for name in NUMBERS for grade in self.faulty}

    @cached_property
    def _significant(self) -> frozenset[tuple[str, Grade]]:
        """Responses that are distinct from chance."""
        keys = list(self.responses)
        adjusted = false_discovery_control([self.responses[key].p_value for key in keys])
        return frozenset(key for key, p in zip(keys, adjusted, strict=True) if p <= FALSE_DISCOVERIES)

    def is_significant(self, name: str, grade: Grade) -> bool:
        """Return whether a number's response to a grade is distinct from chance, among all responses."""
        return (name, grade) in self._significant

    def verdict(self, name: str, kind: AnomalyKind) -> Verdict:
        """Return the response of a number to a kind: IMPROVES if it does at any size, else at the greatest size."""
        grades = self.grades(kind)
        for grade in grades:
            response = self.responses[name, grade]
            if self.is_significant(name, grade) and response.better > response.worse:
                return Verdict.IMPROVES
        if not self.is_significant(name, grades[-1]):
            return Verdict.SILENT
        return Verdict.SEPARATES if self.responses[name, grades[-1]].area.value >= SEPARATION else Verdict.RESPONDS

    def _response(self, name: str, grade: Grade) -> Response:
        episodes = sorted(self.faulty[grade].keys() & self.clean.keys())
        pairs = [(self.clean[e].numbers.get(name), self.faulty[grade][e].numbers.get(name)) for e in episodes]
        numbers = np.array([(float(c), float(f)) for c, f in pairs if c is not None and f is not None]).reshape(-1, 2)
        clean, faulty = (badness(name, side) for side in zip(*pairs, strict=True))
        rng = np.random.default_rng(self._seed)
        return Response(
            episodes=len(episodes),
            change=paired_mean_difference(numbers[:, 1], numbers[:, 0], rng) if len(numbers) else None,
            nulls=sum(c is not None and f is None for c, f in pairs),
            worse=int((faulty > clean).sum()),
            better=int((faulty < clean).sum()),
            area=_area(clean, faulty, rng),
        )


def badness(name: str, values: Sequence[float | bool | None]) -> Array:
    """Return values (N,) of a number such that greater is worse; infinite for null.

    They are rounded to DECIMALS: residuals of inverse kinematics below its tolerance are equal.
    """
    sign = -1.0 if name in HIGHER_IS_BETTER else 1.0
    return np.array([np.inf if v is None else sign * round(float(v), DECIMALS) for v in values])


def _area(clean: Array, faulty: Array, rng: np.random.Generator) -> IntervalEstimate:
    """Return the area under the ROC curve (Hanley and McNeil 1982) of the same N episodes; equal values count half.

    The interval resamples episodes with both their videos.
    """
    wins = (faulty[:, None] > clean).astype(np.float64) + 0.5 * (faulty[:, None] == clean)
    counts = resampled_counts(len(clean), rng)
    draws = np.einsum("ri,ij,rj->r", counts, wins, counts, optimize=True) / len(clean) ** 2
    low, high = percentile_interval(draws)
    return IntervalEstimate(value=float(wins.mean()), low=low, high=high)
