"""Figure of `suite tolerance`: success of the expert's track under graded errors, task by task."""

from collections.abc import Mapping, Sequence
from math import ceil
from pathlib import Path

from kinebench_drake.io.figure import new_figure, save
from kinebench_drake.io.jsonl import read_object
from kinebench_drake.suites.closed_loop.tolerance import PoseError

_COLUMNS = 5
_STYLES = {
    PoseError.BIAS: {"color": "#1f6fb2", "marker": "o", "label": "bias [mm]"},
    PoseError.JITTER: {"color": "#c4622d", "marker": "s", "label": "jitter [mm]"},
    PoseError.FINGERS: {"color": "#8a5fb0", "marker": "^", "label": "finger delay [frames, above]"},
}
Attempt = Mapping[str, object]


def draw_tolerance(source: Path, out: Path) -> None:
    """Draw success against error for all tasks and each task: bias and jitter [mm] below, delay [frames] above.

    Args:
        source: output of `suite tolerance`.
        out: image to write.
    """
    attempts: Sequence[Attempt] = read_object(source)["attempts"]  # type: ignore[assignment]
    tasks = list(dict.fromkeys(str(attempt["task"]) for attempt in attempts))
    rows = ceil((len(tasks) + 1) / _COLUMNS)
    figure, axes = new_figure(2.7 * _COLUMNS, 2.2 * rows, rows, _COLUMNS, sharey=True)
    lines = {}
    for ax, task in zip(axes.flat, ["", *tasks], strict=False):
        own = [attempt for attempt in attempts if task in ("", attempt["task"])]
        ax.set_title(task or "all tasks", fontsize=9, fontweight="normal" if task else "bold")
        ax.set_ylim(-0.04, 1.04)
        ax.tick_params(labelsize=7)
        for error, style in _STYLES.items():
            delay = error is PoseError.FINGERS
            where = ax.twiny() if delay else ax
            if delay:
                where.tick_params(labelsize=6, colors=style["color"], pad=0)
            of_error = [attempt for attempt in own if attempt["error"] in (None, error.value)]
            sizes = sorted({float(str(attempt["size"])) for attempt in of_error})
            hits = [[bool(a["success"]) for a in of_error if float(str(a["size"])) == size] for size in sizes]
            x = [size * (1.0 if delay else 1000.0) for size in sizes]
            shares = [sum(own) / len(own) for own in hits]
            [lines[error]] = where.plot(x, shares, markersize=3, linewidth=1.2, **style)
    for ax in axes.flat[len(tasks) + 1 :]:
        ax.axis("off")
    for ax in axes[:, 0]:
        ax.set_ylabel("success", fontsize=8)
    figure.supxlabel("error of the position [mm], the rotation's with it", fontsize=9)
    figure.legend(handles=list(lines.values()), loc="outside upper center", ncols=3, fontsize=8, frameon=False)
    save(figure, out)
