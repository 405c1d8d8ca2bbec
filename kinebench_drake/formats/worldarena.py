"""Folders of WorldArena with generated videos.

    MODEL_test/TASK_episode_7.mp4 ...     also MODEL_sort, MODEL_val, MODEL_arena; _1 and _2 for changed prompts
    summary.json                          in the folder or beside it: [{"gt_path", "image", "prompt": [...]}, ...]
    first_frame/TASK/episode7.png         beside it: conditioning images, as in the dataset
    instructions/TASK/episode7.json       beside it: {"instruction": ...}

    model_readme.md, videos/*.mp4         an unpacked submission to track 1 of WorldArena 2.0, with the model's name

See the READMEs of WorldArena (https://github.com/tsinghua-fib-lab/WorldArena, video_quality/README.md and
assets/README_submission.md). An entry of summary.json belongs to the video whose stem is that of its gt_path, or to
episode 7 of the task that its folder names. The prompts are those of the unchanged run; those of _1 and _2 are unknown.
"""

import re
from dataclasses import replace
from pathlib import Path

from kinebench_drake.errors import InputError, cause
from kinebench_drake.formats.videos.sample import Search, VideoSample
from kinebench_drake.io.files import VIDEO_SUFFIXES, read_text
from kinebench_drake.io.jsonl import as_object, as_type, read_json, read_object

_FOLDER = re.compile(r"(?P<model>.+?)(?P<variant>_[12])?_(?:sort|test|val|arena)(?P<changed>_[12])?")
_VIDEO = re.compile(r"(?P<task>.+?)_?episode_?(?P<number>\d+)")
_SUMMARY = "summary.json"
_README = "model_readme.md"
_FIELD = re.compile(r"^(model_name|version):[ \t]*(\S.*?)[ \t]*$", re.MULTILINE)


def is_submission(folder: Path) -> bool:
    """Return whether a folder is a submission to track 1 of WorldArena 2.0."""
    return (folder / _README).is_file() and (folder / "videos").is_dir()


def list_submission(folder: Path, search: Search) -> list[VideoSample]:
    """List the videos of a submission, with the name and version of the model.

    Raises:
        InputError: model_readme.md cannot be read.
        UsageError: a camera.json is unusable.
    """
    try:
        fields = dict(_FIELD.findall(read_text(folder / _README)))
    except (OSError, ValueError) as error:
        raise InputError(f"{_README} cannot be read ({cause(error)})") from None
    model = " ".join(fields[name] for name in ("model_name", "version") if name in fields)
    return [replace(search.sample(video), model=model or None) for video in _videos(folder / "videos")]


def is_worldarena(folder: Path) -> bool:
    """Return whether the name of a folder and the names of all its videos follow this layout."""
    videos = _videos(folder) if _FOLDER.fullmatch(folder.resolve().name) else []
    return bool(videos) and all(_VIDEO.fullmatch(video.stem) for video in videos)


def list_worldarena(folder: Path, search: Search) -> list[VideoSample]:
    """List the videos of one model."""
    name = _FOLDER.fullmatch(folder.resolve().name)
    changed = name is None or bool(name["variant"] or name["changed"])
    dataset = folder.resolve().parent
    prompts = _read_prompts((folder / _SUMMARY, dataset / _SUMMARY), search)
    samples = []
    for video in _videos(folder):
        match = _VIDEO.fullmatch(video.stem)
        task, number = (match["task"], int(match["number"])) if match else (None, None)
        sample = search.sample(video)
        image = dataset / "first_frame" / str(task) / f"episode{number}.png"
        prompt = prompts.get((task, number)) or prompts.get(video.stem) or _instruction(dataset, str(task), number)
        samples.append(
            replace(
                sample,
                task=task,
                model=name["model"] if name else None,
                prompt=None if changed else prompt,
                first_frame=sample.first_frame or (image if image.is_file() else None),
            )
        )
    return samples


def _videos(folder: Path) -> list[Path]:
    files = sorted(folder.iterdir())
    return [f for f in files if f.suffix.lower() in VIDEO_SUFFIXES and f.is_file() and not f.name.startswith(".")]


def _read_prompts(places: tuple[Path, ...], search: Search) -> dict[object, str]:
    """Return the prompts of summary.json by the stem of the true video, and by its folder and episode."""
    path = next((place for place in places if place.is_file()), None)
    if path is None:
        return {}
    try:
        entries = as_type(read_json(path), list) or []
    except (OSError, ValueError):
        search.warnings.append(f"{_SUMMARY} cannot be read as JSON: prompts are unknown")
        return {}
    prompts: dict[object, str] = {}
    for entry in map(as_object, entries):
        prompt = entry.get("prompt")
        true = entry.get("gt_path")
        prompt = prompt[0] if isinstance(prompt, list) and prompt else prompt
        if isinstance(prompt, str) and isinstance(true, str):
            video = Path(true)
            prompts[video.stem] = prompt
            if number := re.fullmatch(r"episode_?(\d+)", video.stem):
                prompts[video.parent.name, int(number[1])] = prompt
    return prompts


def _instruction(folder: Path, task: str, number: int | None) -> str | None:
    try:
        about = read_object(folder / "instructions" / task / f"episode{number}.json")
    except (FileNotFoundError, InputError):
        return None
    return as_type(about.get("instruction"), str)
