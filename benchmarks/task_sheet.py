"""Overview image of the tasks: first and last frame of each task's expert."""

import textwrap
from pathlib import Path

from kinebench_drake.io.figure import new_figure, save
from kinebench_drake.suites.composition import compose
from kinebench_drake.suites.families.registry import TASKS, find_expert
from kinebench_drake.suites.rollout import run_expert
from kinebench_drake.suites.simulator import Simulator

_COLUMNS = 4
_LETTERS = 64
"""Letters in a line below two images."""


def draw_task_sheet(seed: int, out: Path) -> None:
    """Run the expert of each task in the episode of a seed and draw its first and last frame."""
    rows = -(-len(TASKS) // _COLUMNS)
    figure, axes = new_figure(3.7 * _COLUMNS, 2.5 * rows, rows, 2 * _COLUMNS)
    for ax in axes.flat:
        ax.set_axis_off()
        ax.set(anchor="N", box_aspect=1.0)
    for task, pair in zip(TASKS, axes.reshape(-1, 2), strict=False):
        episode = compose(task, seed)
        with Simulator(task) as simulator:
            snapshots = run_expert(simulator, find_expert(task), episode).snapshots
            for ax, snapshot in zip(pair, (snapshots[0], snapshots[-1]), strict=True):
                simulator.set_snapshot(snapshot)
                ax.imshow(simulator.render().rgb)
        pair[0].set_title(task, fontsize=10, loc="left")
        text = pair[0].text(
            0.0,
            -0.04,
            "\n".join(textwrap.wrap(episode.prompt, _LETTERS)),
            fontsize=7,
            va="top",
            transform=pair[0].transAxes,
        )
        text.set_in_layout(False)  # it may be wider than its image
    save(figure, out)
