"""Contact sheets: an overview image of tasks or looks."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from kinebench_drake.errors import InputError
from kinebench_drake.executors.base import Executor, WorkerCrash
from kinebench_drake.suites.composition import Episode, compose
from kinebench_drake.suites.families.registry import find_expert, find_task
from kinebench_drake.suites.rollout import run_expert
from kinebench_drake.suites.scene.look import look_ids
from kinebench_drake.suites.simulator import Simulator
from kinebench_drake.suites.simulator_cache import SimulatorCache, SimulatorWorker

LOOKS_TASK = "StackCube-v1"
"""Task whose scene shows the looks."""
IMAGE_PX, GAP_PX, MARGIN_PX = 236, 4, 20
"""Width of an image on the sheet, gap between images of a panel, margin around panels."""
TITLE_PX, TEXT_PX = 19, 14
"""Font sizes."""
_PAPER, _INK, _GREY, _RED = (255, 255, 255), (24, 26, 30), (92, 96, 104), (190, 30, 30)


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """Images of one scene with their text."""

    title: str
    text: str
    """Text below the heading."""
    images: tuple[NDArray[np.uint8], ...] = ()
    """(H, W, 3) each; side by side."""
    failed: bool = False
    """True if the text is the reason of a failure."""


def task_panels(executor: Executor, episodes: Sequence[Episode]) -> list[Panel]:
    """Run the expert in each episode and return its first and last frames, in the order of the episodes.

    Raises:
        SetupError: rendering is not possible.
    """
    return _render_panels(executor, episodes, with_expert=True)


def look_panels(executor: Executor, sort: str, seed: int) -> list[Panel]:
    """Return the first frame of one scene with each look of a sort ("table", "background" or "light").

    Raises:
        UsageError: there is no such sort.
        SetupError: rendering is not possible.
    """
    scene = compose(LOOKS_TASK, seed)
    looks = {"table": scene.table, "background": scene.background, "light": scene.light}
    episodes = []
    for look in look_ids(sort):
        now = looks | {sort: look}
        episodes.append(replace(scene, id=look, table=now["table"], background=now["background"], light=now["light"]))
    return _render_panels(executor, episodes, with_expert=False)


def task_table(tasks: Sequence[str]) -> str:
    """Return the cards of tasks and the prompts of their episodes of seed 0 as a Markdown table."""
    rows = [("task", "difficulty", "joints", "contacts", "clips", "variants", "prompt (seed 0)"), ("---",) * 7]
    for task in tasks:
        card = find_task(task).card
        joints = f"{card.articulated_dof} ({card.axes})" if card.articulated_dof else "0"
        variants = ", ".join(variant.value for variant in card.variants)
        figures = (card.difficulty.value, joints, str(card.contacts), str(card.clips), variants)
        rows.append((card.id, *figures, compose(task, 0).prompt))
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def contact_sheet(panels: Sequence[Panel], *, columns: int) -> Image.Image:
    """Draw panels on one page, `columns` per row, each with its images, title and text."""
    title_font, text_font = ImageFont.load_default(TITLE_PX), ImageFont.load_default(TEXT_PX)
    across = max((len(panel.images) for panel in panels), default=1)
    width = across * (IMAGE_PX + GAP_PX) - GAP_PX
    texts = [_wrap(panel.text, text_font, width) for panel in panels]
    line_px = round(1.35 * TEXT_PX)
    height = IMAGE_PX + round(1.7 * TITLE_PX) + line_px * max(map(len, texts), default=0)
    rows = -(-len(panels) // columns)
    pitch_x, pitch_y = width + MARGIN_PX, height + MARGIN_PX
    page = Image.new("RGB", (columns * pitch_x + MARGIN_PX, rows * pitch_y + MARGIN_PX), _PAPER)
    draw = ImageDraw.Draw(page)
    for i, (panel, text) in enumerate(zip(panels, texts, strict=True)):
        x, y = MARGIN_PX + i % columns * pitch_x, MARGIN_PX + i // columns * pitch_y
        for j, image in enumerate(panel.images):
            small = Image.fromarray(image).resize((IMAGE_PX, IMAGE_PX), Image.Resampling.LANCZOS)
            page.paste(small, (x + j * (IMAGE_PX + GAP_PX), y))
        y += IMAGE_PX + round(0.3 * TITLE_PX)
        draw.text((x, y), panel.title, font=title_font, fill=_INK)
        for j, line in enumerate(text):
            draw.text(
                (x, y + round(1.4 * TITLE_PX) + j * line_px), line, font=text_font, fill=_RED if panel.failed else _GREY
            )
    return page


def _wrap(text: str, font: ImageFont.ImageFont | ImageFont.FreeTypeFont, width: int) -> list[str]:
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if lines[-1] and font.getlength(longer) > width:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines


def _render_panels(executor: Executor, episodes: Sequence[Episode], *, with_expert: bool) -> list[Panel]:
    work = partial(_render_panel, with_expert=with_expert)
    panels = {}
    for done in executor.run(partial(SimulatorWorker, work, SimulatorCache(Simulator)), episodes):
        if isinstance(done, WorkerCrash):
            panels[done.item.id] = Panel(title=_title(done.item, with_expert), text=done.reason, failed=True)
        else:
            panels[done.item.id] = done.result
    return [panels[episode.id] for episode in episodes]


def _title(episode: Episode, with_expert: bool) -> str:
    return episode.task if with_expert else episode.id


def _render_panel(simulator: Simulator, episode: Episode, with_expert: bool) -> Panel:
    title, text, failed = _title(episode, with_expert), episode.prompt, False
    if not with_expert:
        simulator.reset(episode)
        return Panel(title=title, text="", images=(simulator.render().rgb,))
    try:
        rollout = run_expert(simulator, find_expert(episode.task), episode)
        snapshots = [rollout.snapshots[0], rollout.snapshots[-1]]
        if not rollout.outcome.success:
            text, failed = rollout.outcome.reason, True
    except InputError as error:
        simulator.reset(episode)
        snapshots, text, failed = [simulator.snapshot()], str(error), True
    images = []
    for snapshot in snapshots:
        simulator.set_snapshot(snapshot)
        images.append(simulator.render().rgb)
    return Panel(title=title, text=text, images=tuple(images), failed=failed)
