"""WorldArena's folders of generated videos.

    MODEL_test/TASK_episode_7.mp4 ...     also MODEL_sort, MODEL_val, MODEL_arena; _1 and _2 for changed prompts
    summary.json                          in the folder or beside it: [{"gt_path", "image", "prompt": [...]}, ...]
    first_frame/TASK/episode7.png         beside it, as in the dataset that models are asked with
    instructions/TASK/episode7.json       likewise: {"instruction": ...}

as the READMEs of WorldArena (https://github.com/tsinghua-fib-lab/WorldArena, video_quality/README.md and
assets/README_submission.md) ask for. An entry of summary.json is a video's if its gt_path has the same stem, or is
episode 7 in a folder named TASK. The prompts are those of the unchanged run; _1 and _2 have others, which nobody tells.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from kinebench_drake.datasets.videos.sample import VideoSample
from kinebench_drake.datasets.videos.search import Search, plain
from kinebench_drake.errors import InputError
from kinebench_drake.io.files import VIDEO_SUFFIXES
from kinebench_drake.io.jsonl import as_object, read_json, read_object

_FOLDER = re.compile(r"(?P<model>.+?)(?P<variant>_[12])?_(?:sort|test|val|arena)(?P<changed>_[12])?")
_FILM = re.compile(r"(?P<task>.+?)_?episode_?(?P<number>\d+)")
_SUMMARY = "summary.json"


def is_worldarena(folder: Path) -> bool:
    """Whether a folder is called so and holds nothing but films that are."""
    films = _films(folder) if _FOLDER.fullmatch(folder.resolve().name) else []
    return bool(films) and all(_FILM.fullmatch(film.stem) for film in films)


def list_worldarena(folder: Path, search: Search) -> list[VideoSample]:
    """The videos of one model.

    Raises:
        UsageError: a camera.json is unusable.
    """
    named = _FOLDER.fullmatch(folder.resolve().name)
    model = named["model"] if named else None
    changed = named is None or bool(named["variant"] or named["changed"])
    prompts = _prompts((folder / _SUMMARY, folder.resolve().parent / _SUMMARY), search)
    samples = []
    for film in _films(folder):
        match = _FILM.fullmatch(film.stem)
        task, number = (match["task"], int(match["number"])) if match else (None, None)
        sample = plain(film, search)
        beside = folder.resolve().parent
        picture = beside / "first_frame" / str(task) / f"episode{number}.png"
        prompt = prompts.get((task, number)) or prompts.get(film.stem) or _instruction(beside, str(task), number)
        samples.append(
            replace(
                sample,
                task=task,
                model=model,
                prompt=None if changed else prompt,
                first_frame=sample.first_frame or (picture if picture.is_file() else None),
            )
        )
    return samples


def _films(folder: Path) -> list[Path]:
    files = sorted(folder.iterdir())
    return [f for f in files if f.suffix.lower() in VIDEO_SUFFIXES and f.is_file() and not f.name.startswith(".")]


def _prompts(places: tuple[Path, ...], search: Search) -> dict[object, str]:
    """Prompts of summary.json by the stem of the true video, and by its folder and episode."""
    path = next((place for place in places if place.is_file()), None)
    if path is None:
        return {}
    try:
        entries = read_json(path)
    except (OSError, ValueError):
        search.warnings.append(f"{_SUMMARY} cannot be read as JSON: prompts are unknown")
        return {}
    found: dict[object, str] = {}
    for entry in entries if isinstance(entries, list) else []:
        about: Mapping[str, object] = as_object(entry)
        prompt, true = about.get("prompt"), about.get("gt_path")
        prompt = prompt[0] if isinstance(prompt, list) and prompt else prompt
        if isinstance(prompt, str) and isinstance(true, str):
            film = Path(true)
            found[film.stem] = prompt
            if number := re.fullmatch(r"episode_?(\d+)", film.stem):
                found[film.parent.name, int(number[1])] = prompt
    return found


def _instruction(folder: Path, task: str, number: int | None) -> str | None:
    try:
        told = read_object(folder / "instructions" / task / f"episode{number}.json").get("instruction")
    except (FileNotFoundError, InputError):
        return None
    return told if isinstance(told, str) else None
