"""Export of a suite's episodes for world models: first frames, prompts and camera."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Any

from PIL import Image

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import InputError, SetupError, UsageError
from kinebench_drake.executors.base import Executor, Observer, WorkerCrash
from kinebench_drake.formats.camerafile import CAMERA_NAME, save_camera
from kinebench_drake.io.atomic import atomic_path, make_folder
from kinebench_drake.io.files import read_text
from kinebench_drake.io.jsonl import as_object, parse_json, read_object, write_json, write_lines
from kinebench_drake.models.panda.description import TCP_LINK
from kinebench_drake.results.store import SAMPLES
from kinebench_drake.suites.catalog import VERSION, EpisodeSpec, Suite
from kinebench_drake.suites.clock import CLIP_FRAMES, FRAME_PERIOD_S
from kinebench_drake.suites.composition import Episode
from kinebench_drake.suites.families.registry import TASKS
from kinebench_drake.suites.families.task import TaskCard, TaskVariant
from kinebench_drake.suites.prompts import PromptTemplate
from kinebench_drake.suites.simulator import Simulator
from kinebench_drake.suites.simulator_cache import SimulatorCache, SimulatorWorker
from kinebench_drake.suites.start import first_facts

MANIFEST = "manifest.jsonl"
EPISODES = "episodes.jsonl"
SUMMARY = "suite.json"
FPS = 17
"""Playback rate of benchmark videos; the task time between two frames is `FRAME_PERIOD_S`."""
_CHOICE = ("tasks", "episodes_per_task", "first_seed", "episodes")
"""Keys of the summary that may differ where an export is extended."""
FRAMES = CLIP_FRAMES + 1
"""Frames of a benchmark video."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DatasetConfig:
    """Episodes of a suite to write to a folder."""

    suite: Suite
    split: str
    tasks: tuple[str, ...]
    """Plain task ids of the split."""
    episodes: int
    """Episodes of each task; of demonstrations, the successful ones."""
    seed: int
    """Number of the first of the split's seeds."""
    variant: TaskVariant
    out: Path
    """Output folder."""

    def specs(self) -> list[EpisodeSpec]:
        """Return the episodes, task by task."""
        return self.suite.specs(self.split, self.episodes, tasks=self.tasks, offset=self.seed, variant=self.variant)


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportConfig(DatasetConfig):
    """Episodes whose first frames to export."""

    size: int
    """Width and height of the first frames [px]."""
    prompts: PromptTemplate = field(default_factory=PromptTemplate)


_FirstFrame = tuple[Episode, dict[str, Any]]
"""Episode and robot state of a first frame, as manifest keys."""


def _write_first_frame(simulator: Simulator, spec: EpisodeSpec, out: Path) -> _FirstFrame:
    episode = spec.episode()
    simulator.reset(episode)
    rgb = simulator.render().rgb
    with atomic_path(out / f"{episode.id}.png") as part:
        Image.fromarray(rgb).save(part, format="png")
    return episode, first_facts(simulator.link_pose(TCP_LINK), simulator.snapshot().finger_width_m)


def export_suite(config: ExportConfig, executor: Executor, observer: Observer) -> int:
    """Write first frames, manifest, camera and descriptions of the episodes; return their number.

    A folder that holds an export of the same settings is extended, if the new one has all of its episodes. The same
    arguments give the same bytes with any executor.

    Raises:
        UsageError: the split has fewer seeds, or the folder cannot be created or holds something else.
        SetupError: writing or rendering failed, or a worker died.
    """
    specs = config.specs()
    _check_folder(config, specs)
    make_folder(config.out)
    write_json(config.out / SUMMARY, _summary(config, len(specs)))
    observer.start(len(specs), 0)
    frames: dict[EpisodeSpec, _FirstFrame] = {}
    work = partial(_write_first_frame, out=config.out)
    for done in executor.run(partial(SimulatorWorker, work, SimulatorCache(Simulator, config.size)), specs):
        if isinstance(done, WorkerCrash):
            raise SetupError(f"{done.item.task} seed {done.item.seed}: {done.reason}; run the same command again")
        frames[done.item] = done.result
        observer.advance(done.result[0].id)
    ordered = [frames[spec] for spec in specs]
    save_camera(benchmark_camera().resized(config.size, config.size), config.out / CAMERA_NAME)
    subject = {"suite": config.suite.number, "split": config.split}
    rows = [manifest_row(episode.id, episode, config.prompts, {**subject, **state}) for episode, state in ordered]
    write_lines(config.out / MANIFEST, rows)
    descriptions = [
        {"id": episode.id, **subject, **episode_facts(episode), **_task_facts(TASKS[episode.task].card)}
        for episode, _ in ordered
    ]
    write_lines(config.out / EPISODES, descriptions)
    return len(ordered)


def _check_folder(config: ExportConfig, specs: Sequence[EpisodeSpec]) -> None:
    """Check that the folder is new, or holds an export of the same settings whose episodes are among `specs`."""
    out = config.out
    summary = _summary(config, len(specs))
    used = [name for name in (SAMPLES, MANIFEST, EPISODES, SUMMARY) if (out / name).exists()]
    if not used:
        return
    try:
        before = read_object(out / SUMMARY)
        lines = read_text(out / MANIFEST).splitlines() if (out / MANIFEST).exists() else []
        ids = [str(as_object(parse_json(line)).get("id")) for line in lines]
    except (OSError, ValueError, InputError):
        before = {}
        ids = []
    if SAMPLES in used or "suite_version" not in before:
        raise UsageError(f"$out {out}: holds {used[0]}, which no export wrote; name another folder")
    for key, value in summary.items():
        if key not in _CHOICE and before.get(key) != value:
            raise UsageError(
                f"$out {out}: holds an export of {key} {before.get(key)}, this one is of {value}; name another folder"
            )
    if lost := sorted(set(ids) - {spec.id for spec in specs}):
        raise UsageError(
            f"$out {out}: {len(lost)} of its {len(ids)} episodes (such as {lost[0]}) are not in this export; name "
            "another folder, or export their tasks and seeds as well"
        )


def manifest_row(id: str, episode: Episode, prompts: PromptTemplate, facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the manifest's row of a video to generate, named like its first frame, with `facts` as further keys."""
    return {
        "video": f"{id}.mp4",
        "id": id,
        "task": episode.task,
        "seed": episode.seed,
        "prompt": prompts.prompt(episode),
        **({"negative_prompt": prompts.negative} if prompts.negative else {}),
        "first_frame": f"{id}.png",
        "frames": FRAMES,
        "fps": FPS,
        "frame_period_s": FRAME_PERIOD_S,
        **facts,
    }


def episode_facts(episode: Episode) -> dict[str, Any]:
    """Return the description of an episode as JSON."""
    names = ("task", "seed", "prompt", "variant", "assets", "table", "background", "light", "camera")
    return {name: getattr(episode, name) for name in names} | {"variant": episode.variant.value}


def _task_facts(card: TaskCard) -> dict[str, Any]:
    """Return the description of a task as JSON, without its id."""
    facts = {name: getattr(card, name) for name in TaskCard.__dataclass_fields__ if name not in ("id", "variants")}
    facts["horizon"] = card.horizon
    return {name: value.value if isinstance(value, Enum) else value for name, value in facts.items()}


def _summary(config: ExportConfig, count: int) -> dict[str, Any]:
    suite = config.suite
    split = config.suite.splits[config.split]
    return {
        "suite": suite.number,
        "suite_version": VERSION,
        "title": suite.title,
        "about": suite.about,
        "split": config.split,
        "split_about": split.about,
        "pool": split.pool.value,
        "variant": config.variant.value,
        "tasks": list(config.tasks),
        "episodes_per_task": config.episodes,
        "first_seed": split.seeds[0] + config.seed,
        "episodes": count,
        "width": config.size,
        "height": config.size,
        "frames": FRAMES,
        "fps": FPS,
        "frame_period_s": FRAME_PERIOD_S,
        **config.prompts.to_json(),
    }
