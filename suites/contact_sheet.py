"""Contact sheets: an overview image of tasks."""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.executors.base import Executor, WorkerCrash
from kinebench_drake.io.figure import new_figure, plain
from kinebench_drake.suites.composition import Episode
from kinebench_drake.suites.families.registry import find_expert
from kinebench_drake.suites.rollout import run_expert
from kinebench_drake.suites.simulator import Simulator
from kinebench_drake.suites.simulator_cache import SimulatorCache, SimulatorWorker

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """Images of one scene with their text."""

    title: str
    text: str
    """Text below the images."""
    images: tuple[NDArray[np.uint8], ...] = ()
    """(H, W, 3) of the first and the last frame."""
    failed: bool = False
    """True if the text is the reason of a failure."""


def task_panels(executor: Executor, episodes: Sequence[Episode]) -> list[Panel]:
    """Run the expert in each episode and return its first and last frames, in the order of the episodes."""
    panels = {}
    for done in executor.run(partial(SimulatorWorker, _render_panel, SimulatorCache(Simulator)), episodes):
        if isinstance(done, WorkerCrash):
            panels[done.item.id] = Panel(title=done.item.task, text=done.reason, failed=True)
        else:
            panels[done.item.id] = done.result
    return [panels[episode.id] for episode in episodes]


def _render_panel(simulator: Simulator, episode: Episode) -> Panel:
    text = episode.prompt
    failed = False
    try:
        rollout = run_expert(simulator, find_expert(episode.task), episode)
        snapshots = [rollout.snapshots[0], rollout.snapshots[-1]]
        if not rollout.outcome.success:
            text = rollout.outcome.reason
            failed = True
    except InputError as error:
        simulator.reset(episode)
        snapshots = [simulator.snapshot()]
        text = str(error)
        failed = True
    images = []
    for snapshot in snapshots:
        simulator.set_snapshot(snapshot)
        images.append(simulator.render().rgb)
    return Panel(title=episode.task, text=text, images=tuple(images), failed=failed)


def draw_sheet(panels: Sequence[Panel]) -> "Figure":
    """Draw panels beside and below each other, each with its two images, title and text."""
    columns = min(4, len(panels))
    rows = -(-len(panels) // columns)
    figure, axes = new_figure(3.7 * columns, 2.5 * rows, rows, 2 * columns)
    for ax in axes.flat:
        ax.set_axis_off()
        ax.set(anchor="N", box_aspect=1.0)
    for panel, pair in zip(panels, axes.reshape(-1, 2), strict=False):
        for ax, image in zip(pair, panel.images, strict=False):
            ax.imshow(image)
        pair[0].set_title(panel.title, fontsize=10, loc="left")
        text = "\n".join(textwrap.wrap(plain(panel.text), 64))  # letters in a line below two images
        colour = "#be1e1e" if panel.failed else "#5c6068"
        below = pair[0].text(0.0, -0.04, text, fontsize=7, color=colour, va="top", transform=pair[0].transAxes)
        below.set_in_layout(False)  # it may be wider than its image
    return figure
