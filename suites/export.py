"""What a world model is asked with: first frames, prompts and the camera of a suite's episodes."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from PIL import Image

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import SetupError
from kinebench_drake.executors.base import Executor, WorkerCrash
from kinebench_drake.executors.progress import Observer
from kinebench_drake.io.atomic import atomic_path, make_folder
from kinebench_drake.io.camerafile import save_camera
from kinebench_drake.io.jsonl import write_json, write_lines
from kinebench_drake.models.panda.robot import TCP_LINK
from kinebench_drake.suites.clock import CLIP_FRAMES, FRAME_PERIOD_S
from kinebench_drake.suites.episode import Episode
from kinebench_drake.suites.simulator import Simulator
from kinebench_drake.suites.simulator_cache import SimulatorCache
from kinebench_drake.suites.start import first_facts
from kinebench_drake.suites.suite import VERSION, EpisodeSpec, Suite
from kinebench_drake.suites.tasks.registry import TASKS
from kinebench_drake.suites.tasks.task import TaskCard, TaskVariant

MANIFEST, EPISODES, CAMERA, SUMMARY = "manifest.jsonl", "episodes.jsonl", "camera.json", "suite.json"
FPS = 17
"""What benchmark videos play at; the task time between two frames is `FRAME_PERIOD_S`."""
FRAMES = CLIP_FRAMES + 1
"""Frames of a benchmark video."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Export:
    """What to write."""

    suite: Suite
    split: str
    """Name of one of the suite's splits."""
    tasks: tuple[str, ...]
    """Plain task ids of the split."""
    episodes: int
    """Episodes of each task."""
    seed: int
    """Number of the first of the split's seeds."""
    variant: TaskVariant
    """Version of the scenes."""
    size: int
    """Width and height of the first frames [px]."""
    out: Path
    """Folder to write to."""

    def draws(self) -> list[EpisodeSpec]:
        """The episodes, task by task."""
        return [
            draw
            for task in self.tasks
            for draw in self.suite.draws(self.split, task, self.episodes, offset=self.seed, variant=self.variant)
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Photo:
    """What a first frame shows."""

    episode: Episode
    first: dict[str, Any]
    """The robot in it, for the manifest."""


@dataclass(frozen=True, slots=True)
class _Photographer:
    """Makes, in each process, what takes first frames."""

    size: int
    out: Path

    def __call__(self) -> Callable[[EpisodeSpec], _Photo]:
        hand = SimulatorCache(Simulator, self.size)

        def photograph(draw: EpisodeSpec) -> _Photo:
            episode = draw.episode()
            stage = hand.stage(draw.task, draw.variant)
            stage.reset(episode)
            rgb = stage.picture().rgb
            with atomic_path(self.out / f"{episode.id}.png") as part:
                Image.fromarray(rgb).save(part, format="png")
            width_m = float(stage.snapshot().fingers_m.sum())
            return _Photo(episode=episode, first=first_facts(stage.link_pose(TCP_LINK), width_m))

        return photograph


def export_suite(export: Export, engine: Executor, observer: Observer) -> int:
    """Write first frames, manifest, camera and all that is known of the episodes; returns their number.

    The same arguments give the same bytes, whatever the engine.

    Raises:
        UsageError: the split has not as many seeds, or the folder cannot be made.
        SetupError: writing or rendering failed, or a worker died.
    """
    draws = export.draws()
    make_folder(export.out)
    observer.start(len(draws), 0)
    made: dict[EpisodeSpec, _Photo] = {}
    for done in engine.run(_Photographer(export.size, export.out), draws):
        if isinstance(done, WorkerCrash):
            raise SetupError(f"{done.item.task} seed {done.item.seed}: {done.reason}; run the same command again")
        made[done.item] = done.result
        observer.advance(done.result.episode.id)
    photos = [made[draw] for draw in draws]
    save_camera(benchmark_camera().resized(export.size, export.size), export.out / CAMERA)
    write_lines(export.out / MANIFEST, [_manifest_row(photo, export) for photo in photos])
    write_lines(export.out / EPISODES, [_episode_row(photo.episode, export) for photo in photos])
    write_json(export.out / SUMMARY, _summary(export, len(photos)))
    return len(photos)


def _manifest_row(photo: _Photo, export: Export) -> dict[str, Any]:
    episode = photo.episode
    return {
        "video": f"{episode.id}.mp4",
        "id": episode.id,
        "task": episode.task,
        "seed": episode.seed,
        "prompt": episode.prompt,
        "first_frame": f"{episode.id}.png",
        "frames": FRAMES,
        "fps": FPS,
        "frame_period_s": FRAME_PERIOD_S,
        "suite": export.suite.number,
        "split": export.split,
        **photo.first,
    }


def _episode_row(episode: Episode, export: Export) -> dict[str, Any]:
    return {
        "id": episode.id,
        "suite": export.suite.number,
        "split": export.split,
        **episode_facts(episode),
        **card_facts(TASKS[episode.task].card),
    }


def episode_facts(episode: Episode) -> dict[str, Any]:
    """What is known of an episode, as JSON."""
    return {
        "task": episode.task,
        "seed": episode.seed,
        "prompt": episode.prompt,
        "variant": episode.variant.value,
        "assets": dict(episode.assets),
        "table": episode.table,
        "background": episode.background,
        "light": episode.light,
        "camera": episode.camera,
    }


def card_facts(card: TaskCard) -> dict[str, Any]:
    """What is known of a task, as JSON, without its id."""
    facts = {name: getattr(card, name) for name in TaskCard.__dataclass_fields__ if name not in ("id", "variants")}
    facts["horizon"] = card.horizon
    return {name: value.value if isinstance(value, Enum) else value for name, value in facts.items()}


def _summary(export: Export, count: int) -> dict[str, Any]:
    suite, split = export.suite, export.suite.splits[export.split]
    return {
        "suite": suite.number,
        "suite_version": VERSION,
        "title": suite.title,
        "about": suite.about,
        "split": export.split,
        "split_about": split.about,
        "pool": split.pool.value,
        "variant": export.variant.value,
        "tasks": list(export.tasks),
        "episodes_per_task": export.episodes,
        "first_seed": split.seeds[0] + export.seed,
        "episodes": count,
        "width": export.size,
        "height": export.size,
        "frames": FRAMES,
        "fps": FPS,
        "frame_period_s": FRAME_PERIOD_S,
    }
