"""Contact sheets: what the tasks and the looks are like, at a glance, in one picture."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import InputError
from kinebench_drake.executors.base import Executor, WorkerCrash
from kinebench_drake.suites.assets.look import look_ids
from kinebench_drake.suites.episode import Episode, compose
from kinebench_drake.suites.experts.registry import find_expert
from kinebench_drake.suites.rollout import rollout
from kinebench_drake.suites.simulator import Simulator
from kinebench_drake.suites.simulator_cache import SimulatorCache
from kinebench_drake.suites.tasks.registry import find_task

LOOKS_TASK = "StackCube-v1"
"""Task in whose scene looks are shown."""
PICTURE_PX, GAP_PX, MARGIN_PX = 236, 4, 20
"""Edge of a picture on the sheet, gap between two of the same shot, margin around each shot."""
TITLE_PX, TEXT_PX = 19, 14
"""Size of the letters."""
_PAPER, _INK, _GREY, _RED = (255, 255, 255), (24, 26, 30), (92, 96, 104), (190, 30, 30)


@dataclass(frozen=True, slots=True, kw_only=True)
class Shot:
    """Pictures of one scene."""

    title: str
    """Set in large letters."""
    text: str
    """Set in small letters below."""
    pictures: tuple[NDArray[np.uint8], ...] = ()
    """(H, W, 3) each; shown side by side."""
    failed: bool = False
    """Whether the text tells what went wrong."""


def task_shots(engine: Executor, tasks: Sequence[str], seed: int) -> list[Shot]:
    """First and last frame of each task, done by its expert, in the order of the tasks.

    Args:
        engine: does the tasks side by side.
        tasks: plain task ids.
        seed: seed of every task's scene.

    Raises:
        UsageError: there is no such task.
        SetupError: nothing can be rendered.
    """
    return _shots(engine, [compose(task, seed) for task in tasks], performs=True)


def look_shots(engine: Executor, sort: str, seed: int) -> list[Shot]:
    """The first frame of one scene with each look of a sort ("table", "background" or "light") in turn.

    Raises:
        UsageError: there is no such sort.
        SetupError: nothing can be rendered.
    """
    scene = compose(LOOKS_TASK, seed)
    looks = {"table": scene.table, "background": scene.background, "light": scene.light}
    episodes = []
    for look in look_ids(sort):
        now = looks | {sort: look}
        episodes.append(replace(scene, id=look, table=now["table"], background=now["background"], light=now["light"]))
    return _shots(engine, episodes, performs=False)


def task_table(tasks: Sequence[str]) -> str:
    """What the cards of the tasks say and the prompts of their episodes of seed 0, as a Markdown table."""
    rows = [
        ("task", "difficulty", "joints", "contacts", "clips", "variants", "prompt (seed 0)"),
        ("---",) * 7,
    ]
    for task in tasks:
        card = find_task(task).card
        joints = f"{card.articulated_dof} ({card.axes})" if card.articulated_dof else "0"
        variants = ", ".join(variant.value for variant in card.variants)
        figures = (card.difficulty.value, joints, str(card.contacts), str(card.clips), variants)
        rows.append((card.id, *figures, compose(task, 0).prompt))
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def contact_sheet(shots: Sequence[Shot], *, columns: int) -> Image.Image:
    """All shots on one page, `columns` a row, each with its pictures, title and text."""
    title_font, text_font = ImageFont.load_default(TITLE_PX), ImageFont.load_default(TEXT_PX)
    across = max((len(shot.pictures) for shot in shots), default=1)
    width = across * (PICTURE_PX + GAP_PX) - GAP_PX
    texts = [_wrapped(shot.text, text_font, width) for shot in shots]
    line_px = round(1.35 * TEXT_PX)
    height = PICTURE_PX + round(1.7 * TITLE_PX) + line_px * max(map(len, texts), default=0)
    rows = -(-len(shots) // columns)
    pitch_x, pitch_y = width + MARGIN_PX, height + MARGIN_PX
    page = Image.new("RGB", (columns * pitch_x + MARGIN_PX, rows * pitch_y + MARGIN_PX), _PAPER)
    draw = ImageDraw.Draw(page)
    for i, (shot, text) in enumerate(zip(shots, texts, strict=True)):
        x, y = MARGIN_PX + i % columns * pitch_x, MARGIN_PX + i // columns * pitch_y
        for j, picture in enumerate(shot.pictures):
            small = Image.fromarray(picture).resize((PICTURE_PX, PICTURE_PX), Image.Resampling.LANCZOS)
            page.paste(small, (x + j * (PICTURE_PX + GAP_PX), y))
        y += PICTURE_PX + round(0.3 * TITLE_PX)
        draw.text((x, y), shot.title, font=title_font, fill=_INK)
        for j, line in enumerate(text):
            draw.text(
                (x, y + round(1.4 * TITLE_PX) + j * line_px), line, font=text_font, fill=_RED if shot.failed else _GREY
            )
    return page


def _wrapped(text: str, font: ImageFont.ImageFont | ImageFont.FreeTypeFont, width: int) -> list[str]:
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if lines[-1] and font.getlength(longer) > width:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines


def _shots(engine: Executor, episodes: Sequence[Episode], *, performs: bool) -> list[Shot]:
    shots = {}
    for done in engine.run(_MakeShots(performs), episodes):
        if isinstance(done, WorkerCrash):
            shots[done.item.id] = Shot(title=_title(done.item, performs=performs), text=done.reason, failed=True)
        else:
            shots[done.item.id] = done.result
    return [shots[episode.id] for episode in episodes]


def _title(episode: Episode, *, performs: bool) -> str:
    return episode.task if performs else episode.id


@dataclass(frozen=True, slots=True)
class _MakeShots:
    """Makes a photographer in each process."""

    performs: bool

    def __call__(self) -> Callable[[Episode], Shot]:
        return _Photographer(self.performs)


class _Photographer:
    """Takes shots."""

    def __init__(self, performs: bool) -> None:
        self._performs = performs
        self._hand = SimulatorCache(Simulator, benchmark_camera().width)

    def __call__(self, episode: Episode) -> Shot:
        stage = self._hand.stage(episode.task, episode.variant)
        title, text, failed = _title(episode, performs=self._performs), episode.prompt, False
        if not self._performs:
            stage.reset(episode)
            return Shot(title=title, text="", pictures=(stage.picture().rgb,))
        try:
            performance = rollout(stage, find_expert(episode.task), episode)
            snapshots = [performance.snapshots[0], performance.snapshots[-1]]
            if not performance.outcome.success:
                text, failed = performance.outcome.reason, True
        except InputError as error:
            stage.reset(episode)
            snapshots, text, failed = [stage.snapshot()], str(error), True
        pictures = []
        for snapshot in snapshots:
            stage.show(snapshot)
            pictures.append(stage.picture().rgb)
        return Shot(title=title, text=text, pictures=tuple(pictures), failed=failed)
