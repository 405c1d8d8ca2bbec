"""Kinematic metrics of models on suites: the scaled manipulability cost, table and figure."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from kinebench_drake.io.figure import new_figure, plain, shorten
from kinebench_drake.report.figures import COLOURS, ReportFigure, add_legend, assign_numbers, style
from kinebench_drake.report.metric import BY_NAME
from kinebench_drake.report.suite.episode import (
    COST,
    EXECUTABLE_COLUMN,
    EpisodeResult,
    executable_share,
    group_by_run,
    list_models,
    mean_over_tasks,
    worst_metric,
)
from kinebench_drake.report.suite.success import COST_COLUMN
from kinebench_drake.report.table import Column, Table, plain_columns
from kinebench_drake.results.aggregate import Estimate, robust_normalize

_METRICS = (
    ("sparc", "SPARC", "{:.2f}"),
    ("sparc_rotation", "SPARC, rotation", "{:.2f}"),
    ("ldlj", "Log dimensionless jerk", "{:.2f}"),
    ("manipulability_mean", "Manipulability", "{:.4f}"),
    ("ik_success_rate", "IK success", "{:.1%}"),
    ("slowdown_min", "Slow-down needed", "{:.2f}"),
    ("tracked_fraction", "Frames tracked", "{:.1%}"),
    ("gap_gripper_m", "Generated to executed [m]", "{:.4f}"),
    ("gap_robot_iou", "Robot overlap", "{:.2f}"),
)


def scale_costs(episodes: Iterable[EpisodeResult]) -> list[EpisodeResult]:
    """Scale the manipulability costs of all episodes from their 10th percentile (0) to their 90th (1).

    See `aggregate.robust_normalize`. Fewer than two costs define no scale: the episodes are returned unchanged.
    """
    episodes = list(episodes)
    costs = np.array([np.nan if (c := e.metric(COST)) is None else c for e in episodes], dtype=np.float64)
    if np.isfinite(costs).sum() < 2:
        return episodes
    scaled = robust_normalize(costs)
    return [replace(e, cost_scaled=float(v) if np.isfinite(v) else None) for e, v in zip(episodes, scaled, strict=True)]


def tabulate_kinematics(episodes: Sequence[EpisodeResult], seed: int = 0) -> Table:
    """Build the table of task-balanced kinematic metrics of every model on every part."""
    metrics = [m for m in _METRICS if any(e.metric(m[0]) is not None for e in episodes)]
    worst = {name: worst_metric(name, episodes) for name, *_ in metrics}
    return Table(
        name="kinematics",
        title="Motion of the generated gripper",
        note="Means over tasks of the episodes that have the metric, with 95 % bootstrap intervals over episodes "
        "within tasks; successes and failures alike. Bound: the mean if the other episodes had the worst value of all.",
        columns=(
            *plain_columns(part="Suite", model="Model"),
            EXECUTABLE_COLUMN,
            COST_COLUMN,
            *(
                Column(key=name, label=label, pattern=pattern, meaning=BY_NAME[name].meaning, estimated=True)
                for name, label, pattern in metrics
            ),
        ),
        rows=tuple(
            (
                part.title,
                model,
                executable_share(own, seed, episodes),
                mean_over_tasks(own, lambda e: e.cost_scaled, seed, 1.0),
                *(
                    mean_over_tasks(own, lambda e, name=name: e.metric(name), seed, worst[name])  # type: ignore[misc]
                    for name, *_ in metrics
                ),
            )
            for part, model, own in group_by_run(episodes)
        ),
    )


_FOLLOWING = (
    ("action_error_m", "action_error_mm", "Error [mm]", 1e3, "{:.1f}"),
    ("action_shuffled_m", "action_shuffled_mm", "Shuffled [mm]", 1e3, "{:.1f}"),
    ("action_error_rad", "action_error_deg", "Error [degrees]", 180.0 / np.pi, "{:.1f}"),
    ("action_shuffled_rad", "action_shuffled_deg", "Shuffled [degrees]", 180.0 / np.pi, "{:.1f}"),
    ("action_error_finger_m", "action_error_finger_mm", "Error, fingers [mm]", 1e3, "{:.1f}"),
    ("action_shuffled_finger_m", "action_shuffled_finger_mm", "Shuffled, fingers [mm]", 1e3, "{:.1f}"),
    ("action_following", "action_following", "Following", 1.0, "{:.2f}"),
    ("action_lag_s", "action_lag_s", "Delay [s]", 1.0, "{:.2f}"),
)
"""Metrics of action following: key and label in the table, factor to its unit, format."""


def tabulate_following(episodes: Sequence[EpisodeResult], seed: int = 0) -> Table | None:
    """Build the table of how far videos follow the commanded actions; None if no run stated actions."""
    conditioned = [e for e in episodes if "action_error_m" in e.row.metrics]
    if not conditioned:
        return None

    def mean(own: Sequence[EpisodeResult], name: str, factor: float) -> Estimate:
        worst = worst_metric(name, conditioned)
        return mean_over_tasks(
            own,
            lambda e: None if (value := e.metric(name)) is None else factor * value,
            seed,
            None if worst is None else factor * worst,
        )

    return Table(
        name="following",
        title="Following of actions",
        note="Differences between the generated and the commanded gripper: an episode's median over frames, a lost "
        "frame worse than any other; means over tasks with 95 % bootstrap intervals over episodes within tasks. "
        "Shuffled: against the commanded frames in random order. Following: 1 - error / shuffled error of the "
        "position, 1 for a video that obeys, 0 for one that does not depend on the actions. Delay: that with the least "
        "error, if following exceeds 0.5.",
        columns=(
            *plain_columns(part="Suite", model="Model", episodes="Episodes"),
            *(
                Column(key=key, label=label, pattern=pattern, meaning=BY_NAME[name].meaning, estimated=True)
                for name, key, label, _, pattern in _FOLLOWING
            ),
        ),
        rows=tuple(
            (
                part.title,
                model,
                len({e.row.episode for e in own}),
                *(mean(own, name, factor) for name, _, _, factor, _ in _FOLLOWING),
            )
            for part, model, own in group_by_run(conditioned)
        ),
    )


def draw_manipulability(episodes: Sequence[EpisodeResult]) -> ReportFigure | None:
    """Draw violins of the scaled manipulability cost by part and model; None if there are no scaled costs."""
    if all(e.cost_scaled is None for e in episodes):
        return None
    scaled = [replace(e, cost_scaled=1.0) if e.cost_scaled is None else e for e in episodes]
    models, parts = list_models(scaled), sorted({e.part for e in scaled})
    crowded = len(models) > len(COLOURS)
    widths = [len(list_models(e for e in scaled if e.part == p)) for p in parts]
    figure, axes = new_figure(
        max(6.4, 1.6 + (0.4 if crowded else 0.8) * sum(widths)),
        5.8 if crowded else 4.4,
        1,
        len(parts),
        sharey=True,
        gridspec_kw={"width_ratios": widths},
    )
    for ax, part in zip(axes[0], parts, strict=True):
        here = [m for m in models if any(e.part == part and e.model == m for e in scaled)]
        numbers = assign_numbers(models, here)
        for k, model in enumerate(here):
            costs = [e.cost_scaled for e in scaled if e.part == part and e.model == model and e.cost_scaled is not None]
            colour = style(numbers[model])[0]
            if len(costs) > 1 and np.ptp(costs) > 0:
                for body in ax.violinplot(costs, [k], widths=0.8, showextrema=False)["bodies"]:
                    body.set(facecolor=colour, edgecolor=colour, alpha=0.35)
            low, middle, high = np.percentile(costs, [25, 50, 75])
            ax.plot([k, k], [low, high], color=colour, linewidth=3.2, solid_capstyle="butt")
            ax.plot([k], [middle], marker="o", color="white", markeredgecolor=colour, markersize=5)
        names = [plain(shorten(n)) for n in here] if crowded else []
        ax.set_xticks(range(len(names)), names, fontsize=8, rotation=90)
        ax.set_xlim(-0.6, len(here) - 0.4)
        ax.set_title(plain(part.title), fontsize=9)
        ax.tick_params(axis="y", labelsize=8)
    axes[0, 0].set_ylabel("manipulability cost, scaled", fontsize=9)
    if not crowded:
        for model in models:
            axes[0, 0].plot(
                [], [], color=style(models.index(model))[0], linewidth=5.0, alpha=0.6, label=plain(shorten(model))
            )
        add_legend(figure, models)
    return ReportFigure(
        name="manipulability",
        title="Manipulability cost by suite and model",
        caption="Distribution over episodes of the mean manipulability cost (lower is better), scaled so that 0 is the "
        "10th and 1 the 90th percentile of all episodes in this report, where those without "
        "a cost are, too; bars from the first to the third quartile, dots at the median.",
        figure=figure,
    )
