"""Curves of success against error, one small panel a task."""

from collections.abc import Sequence
from math import ceil
from typing import TYPE_CHECKING, Any

from kinebench_drake.drawing import new_figure
from kinebench_drake.suites.closedloop.tolerance import Attempt, Error
from kinebench_drake.suites.closedloop.tolerance_table import grades_of, rate, tasks_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLUMNS = 5
_STYLES = {
    Error.BIAS: {"color": "#1f6fb2", "marker": "o", "label": "bias [mm]"},
    Error.JITTER: {"color": "#c4622d", "marker": "s", "label": "jitter [mm]"},
    Error.FINGERS: {"color": "#8a5fb0", "marker": "^", "label": "finger delay [frames, above]"},
}


def draw_tolerance(attempts: Sequence[Attempt]) -> "Figure":
    """All tasks together, then each; millimetres of bias and jitter below, frames of delay above."""
    panels: list[str | None] = [None, *tasks_of(attempts)]
    rows = ceil(len(panels) / _COLUMNS)
    figure, axes = new_figure(2.7 * _COLUMNS, 2.2 * rows, rows, _COLUMNS, sharey=True)
    lines: dict[Error, Any] = {}
    for ax, task in zip(axes.flat, panels, strict=False):
        ax.set_title(task or "all tasks", fontsize=9, fontweight="bold" if task is None else "normal")
        ax.set_ylim(-0.04, 1.04)
        ax.tick_params(labelsize=7)
        for error in Error:
            grades = grades_of(attempts, error)
            if not grades:
                continue
            delay = error is Error.FINGERS
            where = ax.twiny() if delay else ax
            if delay:
                where.tick_params(labelsize=6, colors=_STYLES[error]["color"], pad=0)
            sizes = [grade.size * (1.0 if delay else 1000.0) for grade in grades]
            shares = [good / max(n, 1) for good, n in (rate(attempts, grade, task) for grade in grades)]
            [lines[error]] = where.plot(sizes, shares, markersize=3, linewidth=1.2, **_STYLES[error])
    for ax in axes.flat[len(panels) :]:
        ax.axis("off")
    for ax in axes[:, 0]:
        ax.set_ylabel("success", fontsize=8)
    figure.supxlabel("error of the position [mm], the rotation's with it", fontsize=9)
    figure.legend(handles=list(lines.values()), loc="outside upper center", ncols=3, fontsize=8, frameon=False)
    return figure
