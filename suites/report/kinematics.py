"""Kinematic metrics of models on suites: the scaled manipulability cost, table and figure."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.io.figure import LABEL_PT, new_figure, plain, shorten
from kinebench_drake.report.figures import COLOURS, ReportFigure, add_legend, assign_numbers, make_figure, style
from kinebench_drake.report.table import Table, make_table
from kinebench_drake.results.aggregate import Estimate
from kinebench_drake.suites.report.episode_result import (
    COST,
    EpisodeResult,
    executable_share,
    group_by_run,
    list_models,
    mean_over_tasks,
    worst_metric,
)

_METRICS = (
    *("sparc", "sparc_rotation", "ldlj", "manipulability_mean", "ik_success_rate", "slowdown_min", "tracked_fraction"),
    *("gap_gripper_m", "gap_robot_iou"),
)
"""Metrics of the table of the generated motion."""
_PERCENTILES = (10.0, 90.0)
"""Percentiles at the ends of the scale of costs."""
_FOLLOWING = {
    **{"action_error_mm": ("action_error_m", 1e3), "action_shuffled_mm": ("action_shuffled_m", 1e3)},
    "action_error_deg": ("action_error_rad", 180.0 / np.pi),
    "action_shuffled_deg": ("action_shuffled_rad", 180.0 / np.pi),
    "action_error_finger_mm": ("action_error_finger_m", 1e3),
    "action_shuffled_finger_mm": ("action_shuffled_finger_m", 1e3),
    **{"action_following": ("action_following", 1.0), "action_lag_s": ("action_lag_s", 1.0)},
}
"""Metric and factor to its unit, by column of the table of action following."""


def scale_costs(episodes: Iterable[EpisodeResult]) -> list[EpisodeResult]:
    """Scale the manipulability costs of all episodes from their 10th percentile (0) to their 90th (1).

    See `robust_normalize`. Fewer than two costs define no scale: the episodes are returned unchanged.
    """
    episodes = list(episodes)
    costs = np.array([np.nan if (c := e.metric(COST)) is None else c for e in episodes], dtype=np.float64)
    if np.isfinite(costs).sum() < 2:
        return episodes
    scaled = robust_normalize(costs)
    return [replace(e, cost_scaled=float(v) if np.isfinite(v) else None) for e, v in zip(episodes, scaled, strict=True)]


def robust_normalize(values: Array) -> Array:
    """Scale values (N,) to 0 at the lower of _PERCENTILES or below and 1 at the upper one or above.

    clip((v - p_low) / (p_high - p_low), 0, 1) over the finite values, percentiles by linear interpolation; NaN stays
    NaN. If both percentiles are equal there is no scale: smaller values become 0, greater ones 1 and equal ones 0.5.
    The result compares episodes of one report, never of several.
    """
    bottom, top = np.percentile(values[np.isfinite(values)], _PERCENTILES)
    if top > bottom:
        scaled = np.clip((values - bottom) / (top - bottom), 0.0, 1.0)
    else:
        scaled = 0.5 + 0.5 * np.sign(values - bottom)
    return np.asarray(np.where(np.isnan(values), np.nan, scaled))


def tabulate_kinematics(episodes: Sequence[EpisodeResult]) -> Table:
    """Build the table of task-balanced kinematic metrics of every model on every part."""
    names = [name for name in _METRICS if any(e.metric(name) is not None for e in episodes)]
    return make_table(
        "kinematics",
        (
            {
                **{"part": part.title, "model": model, "executable": executable_share(own, episodes)},
                "manipulability_cost_scaled": mean_over_tasks(own, lambda e: e.cost_scaled, 1.0),
                **{name: _mean_metric(own, episodes, name) for name in names},
            }
            for part, model, own in group_by_run(episodes)
        ),
    )


def tabulate_following(episodes: Sequence[EpisodeResult]) -> Table | None:
    """Build the table of how far videos follow the commanded actions; None if no run stated actions."""
    conditioned = [e for e in episodes if "action_error_m" in e.row.metrics]
    if not conditioned:
        return None
    return make_table(
        "following",
        (
            {
                **{"part": part.title, "model": model, "episodes": len({e.row.episode for e in own})},
                **{key: _mean_metric(own, conditioned, name, factor) for key, (name, factor) in _FOLLOWING.items()},
            }
            for part, model, own in group_by_run(conditioned)
        ),
    )


def _mean_metric(
    own: Sequence[EpisodeResult], among: Sequence[EpisodeResult], name: str, factor: float = 1.0
) -> Estimate:
    """Return a metric's mean over tasks times a factor; its bound is of the worst value in `among`."""

    def scale(value: float | None) -> float | None:
        return None if value is None else factor * value

    return mean_over_tasks(own, lambda e: scale(e.metric(name)), scale(worst_metric(name, among)))


def draw_manipulability(episodes: Sequence[EpisodeResult]) -> ReportFigure | None:
    """Draw violins of the scaled manipulability cost by part and model; None if there are no scaled costs."""
    if all(e.cost_scaled is None for e in episodes):
        return None
    scaled = [replace(e, cost_scaled=1.0) if e.cost_scaled is None else e for e in episodes]
    models = list_models(scaled)
    parts = sorted({e.part for e in scaled})
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
        ax.set_xticks(range(len(names)), names, rotation=90)
        ax.set_xlim(-0.6, len(here) - 0.4)
        ax.set_title(plain(part.title), fontsize=LABEL_PT)
    axes[0, 0].set_ylabel("manipulability cost, scaled")
    if not crowded:
        for model in models:
            axes[0, 0].plot(
                [], [], color=style(models.index(model))[0], linewidth=5.0, alpha=0.6, label=plain(shorten(model))
            )
        add_legend(figure, models)
    return make_figure("manipulability", figure)
