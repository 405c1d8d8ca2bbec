"""How well anomalies are found, as a picture: a panel a kind, over the size of the fault."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kinebench_drake.drawing import FAINT, POSITION, ROTATION, new_figure
from kinebench_drake.grounding.evaluation.anomalies import ClipFindings
from kinebench_drake.grounding.evaluation.anomaly_table import GATES, GOALS, UNITS, Row, alarms, rows
from kinebench_drake.products import AnomalyKind

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_STYLES = ("-", "--")


def draw_anomalies(findings: Sequence[ClipFindings]) -> "Figure":
    """Area under the curve with its interval and share found in the right frames, over size; gates and goals marked."""
    figure, axes = new_figure(15.0, 7.6, 2, 4, sharey=True)
    table = [row for row in rows(findings) if row.size is not None]
    for ax, kind in zip(axes.flat, AnomalyKind, strict=True):
        _panel(ax, kind, [row for row in table if row.kind is kind])
    for ax in axes[:, 0]:
        ax.set_ylabel("share, area under the curve")
    share = alarms(findings)["any"]
    low, high = share.interval
    figure.suptitle(
        f"Planted anomalies by size, against {share.n} clean videos "
        f"(something found in {share.value:.1%} of these, 95 % interval {low:.1%} to {high:.1%})"
    )
    return figure


def _panel(ax: Any, kind: AnomalyKind, table: Sequence[Row]) -> None:
    unit, factor = UNITS[kind]
    ax.set_title(kind.value.replace("_", " "))
    ax.set_xlabel(f"size [{unit}]")
    ax.axhline(GOALS[kind], color=FAINT, linewidth=1.0, linestyle=":", zorder=1)
    ax.axvspan(0, GATES[kind] * factor * 0.93, color="#f1f2f4", zorder=0, label="below the gate")
    for form, style in zip(sorted({row.form for row in table}), _STYLES, strict=False):
        some = [row for row in table if row.form == form]
        x = np.array([(row.size or 0.0) * factor for row in some])
        value = np.array([row.area.value for row in some])
        bounds = np.array([[row.area.value - row.area.low, row.area.high - row.area.value] for row in some]).T
        name = f", {form}" if form else ""
        ax.errorbar(x, value, bounds, color=POSITION, linestyle=style, marker="o", markersize=4, capsize=3,
                    label=f"area under the curve{name}")  # fmt: skip
        ax.plot(x, [row.located.value for row in some], color=ROTATION, linestyle=style, marker="s", markersize=4,
                label=f"found, frames right{name}")  # fmt: skip
    if table:
        ax.set_xlim(0, max((row.size or 0.0) for row in table) * factor * 1.08)
    ax.set_ylim(-0.03, 1.05)
    ax.legend(fontsize=7, loc="lower right", framealpha=0.9)
