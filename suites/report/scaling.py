"""Success against demonstrations and optimisation steps, by difficulty of the tasks (suite 3)."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kinebench_drake.io.figure import new_figure
from kinebench_drake.report.figures import ReportFigure, make_figure, style
from kinebench_drake.report.table import Column, Table, make_table
from kinebench_drake.results.aggregate import Estimate, group_by
from kinebench_drake.suites.report.episode_result import EpisodeResult, mean_over_tasks
from kinebench_drake.suites.report.pooling import SuiteRun, model_of

SUITE = 3
"""Number of the suite of the scaling study."""
ALL_LEVELS = "all"
_UNKNOWN = "unknown"
"""Difficulty of tasks that are not in the suites."""


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class TrainingBudget:
    """Training data and steps of a model."""

    data: int
    """Demonstrations per task; tag `data`."""
    steps: int
    """Optimisation steps; tag `steps`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scaling:
    """Success of one model after different trainings."""

    model: str
    """Plain name."""
    levels: tuple[str, ...]
    """Difficulties of its tasks in rising order, and ALL_LEVELS."""
    success: Mapping[tuple[TrainingBudget, str], Estimate]
    """Task-balanced success by training and difficulty."""

    @property
    def budgets(self) -> list[TrainingBudget]:
        """Training budgets, the least data first."""
        return sorted({budget for budget, _ in self.success})


def study_scaling(
    runs: Sequence[SuiteRun], episodes: Sequence[EpisodeResult], difficulties: Mapping[str, str]
) -> list[Scaling]:
    """Compute each model's task-balanced success on suite 3 by training and difficulty, pooling runs of one training.

    Args:
        runs: those without valid tags are skipped.
    """
    budgets: dict[Path, TrainingBudget] = {
        run.path: budget for run in runs if run.part.suite == SUITE and (budget := budget_of(run))
    }
    studies = []
    for model, own in group_by((e for e in episodes if e.folder in budgets), lambda e: model_of(e.row)).items():
        level = {e.task: difficulties.get(e.task, _UNKNOWN) for e in own}
        order = [*dict.fromkeys(difficulties.values()), _UNKNOWN]
        levels = (*(name for name in order if name in level.values()), ALL_LEVELS)
        success = {}
        for budget, trained in group_by(own, lambda e: budgets[e.folder]).items():
            for name in levels:
                some = [e for e in trained if name in (ALL_LEVELS, level[e.task])]
                if some:
                    success[budget, name] = mean_over_tasks(some, lambda e: e.hit)
        studies.append(Scaling(model=model, levels=levels, success=success))
    return studies


def budget_of(run: SuiteRun) -> TrainingBudget | None:
    """Parse the tags `data` and `steps` of a run; None unless both are counts."""
    data, steps = (_parse_count(run.tags.get(name, "")) for name in ("data", "steps"))
    return None if data is None or steps is None else TrainingBudget(data=data, steps=steps)


def _parse_count(text: str) -> int | None:
    """Parse a count such as "7500" or "7.5k"; None if it is none."""
    match = re.fullmatch(r"(\d{1,9}(?:\.\d{1,3})?)(k?)", text.strip().lower())
    if not match:
        return None
    value = float(match[1]) * (1000.0 if match[2] else 1.0)
    return int(value) if value == int(value) and value > 0 else None


def untagged(runs: Sequence[SuiteRun]) -> list[SuiteRun]:
    """List the runs on suite 3 whose tags name no training budget."""
    return [run for run in runs if run.part.suite == SUITE and budget_of(run) is None]


def task_difficulties() -> dict[str, str]:
    """Return the difficulty of each task of the suites, the easy ones first."""
    from kinebench_drake.suites.families.registry import TASKS
    from kinebench_drake.suites.families.task import Difficulty

    cards = sorted((task.card for task in TASKS.values()), key=lambda card: list(Difficulty).index(card.difficulty))
    return {card.id: card.difficulty.value for card in cards}


def tabulate_scaling(studies: Sequence[Scaling]) -> Table:
    """Build the table of success by model, training and difficulty."""
    levels = [*dict.fromkeys(level for s in studies for level in s.levels[:-1]), *(s.levels[-1] for s in studies[:1])]
    lines = [(s, budget) for s in studies for budget in s.budgets]
    return make_table(
        "scaling",
        ({"model": s.model, "data": budget.data, "steps": budget.steps} for s, budget in lines),
        more=[
            (
                Column(key=f"success_{level}", label=level.capitalize(), pattern="{:.1%}", estimated=True),
                [s.success.get((budget, level)) for s, budget in lines],
            )
            for level in levels
        ],
    )


def draw_scaling(study: Scaling, name: str) -> ReportFigure | None:
    """Draw success against demonstrations and against steps, by difficulty; None unless one of them was varied."""
    budgets = study.budgets
    varied = [
        (label, along, across, pattern)
        for label, along, across, pattern in (
            ("demonstrations per task", "data", "steps", "{:,} steps"),
            ("optimisation steps", "steps", "data", "{:,} demonstrations"),
        )
        if len(budgets) > len({getattr(b, across) for b in budgets})
    ]
    if not varied:
        return None
    figure, axes = new_figure(
        2.5 * len(study.levels) + 1.6, 0.5 + 2.6 * len(varied), len(varied), len(study.levels), sharey=True
    )
    for row, (label, along, across, pattern) in zip(axes, varied, strict=True):
        for ax, level in zip(row, study.levels, strict=True):
            values = sorted({getattr(b, across) for b in budgets})
            for k, value in enumerate(values):
                line = [b for b in budgets if getattr(b, across) == value and (b, level) in study.success]
                if line:
                    shift = 1.03 ** (k - 0.5 * (len(values) - 1))  # keeps lines from hiding each other
                    estimates = [study.success[b, level] for b in line]
                    _draw_line(ax, [getattr(b, along) * shift for b in line], estimates, k, pattern.format(value))
            ticks = sorted({getattr(b, along) for b in budgets})
            ax.set_xscale("log")
            ax.set_xticks(ticks, [f"{tick:,}" for tick in ticks], fontsize=7)
            ax.minorticks_off()
            ax.margins(x=0.12)
            ax.set_ylim(-0.04, 1.04)
            ax.tick_params(axis="y", labelsize=8)
            ax.set_title(level, fontsize=9)
            ax.set_xlabel(label, fontsize=8)
        row[0].set_ylabel("success", fontsize=9)
        row[-1].legend(fontsize=7, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return make_figure("scaling", figure, name=name, model=study.model)


def _draw_line(ax: Any, x: Sequence[float], estimates: Sequence[Estimate], index: int, label: str) -> None:
    colour, marker = style(index)
    points = [(at, e) for at, e in zip(x, estimates, strict=True) if e.mean is not None]
    ax.plot([a for a, _ in points], [e.mean for _, e in points], color=colour, marker=marker, markersize=4, label=label)
    for at, e in points:
        if e.low is not None and e.high is not None:
            ax.plot([at, at], [e.low, e.high], color=colour, linewidth=1.0, alpha=0.7)
