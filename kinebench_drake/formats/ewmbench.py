"""Folders of EWMBench, also written by the pre-processing of WorldArena.

    gt_dataset/TASK/EPISODE/video/frame_00000.jpg ...       the true video
    gt_dataset/TASK/EPISODE/prompt/init_frame.png           its first frame, the conditioning image
    gt_dataset/TASK/EPISODE/prompt/introduction.txt         the instruction (prompt.txt in WorldArena)
    MODEL_dataset/TASK/EPISODE/1/video/frame_00000.jpg ...  a model's videos, several per episode

See the README of EWMBench (https://github.com/AgibotTech/EWMBench) and that of WorldArena's video_quality
(https://github.com/tsinghua-fib-lab/WorldArena). The folder's name must end with _dataset. Files of their own
evaluation steps (gripper_detection/, traj/) are ignored. Their `video_resize.py` scales frames of any shape to
640 x 480: if the first frame is there, this is reported and undone.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from kinebench_drake.errors import InputError
from kinebench_drake.formats.videos.sample import Search, VideoSample
from kinebench_drake.io.files import IMAGE_SUFFIXES, read_text

_SUFFIX = "_dataset"
_TRUE = "gt"
_PROMPTS = ("introduction.txt", "prompt.txt")


def is_ewmbench(folder: Path) -> bool:
    """Return whether a folder has this layout."""
    return folder.resolve().name.endswith(_SUFFIX) and next(_frame_folders(folder), None) is not None


def list_ewmbench(folder: Path, search: Search) -> list[VideoSample]:
    """List the videos of one model, or the true ones.

    Raises:
        InputError: there is none.
        UsageError: a camera.json is unusable.
    """
    model = folder.resolve().name.removesuffix(_SUFFIX)
    truth = folder if model == _TRUE else folder.resolve().parent / f"{_TRUE}{_SUFFIX}"
    samples = []
    for video in _frame_folders(folder):
        task, episode, *variant = video.relative_to(folder).parts[:-1]
        conditions = truth / task / episode / "prompt"
        image = conditions / "init_frame.png"
        samples.append(
            replace(
                search.part_sample(video),
                id="-".join((model, task, episode, *variant)),
                task=task,
                model=model,
                prompt=_read_prompt(conditions),
                first_frame=image if image.is_file() else None,
            )
        )
    if not samples:
        raise InputError("holds no TASK/EPISODE/video/ and no TASK/EPISODE/1/video/ with frames")
    return samples


def _frame_folders(folder: Path) -> Iterator[Path]:
    for episode in sorted(folder.glob("*/*")):
        for video in (episode / "video", *sorted(episode.glob("*/video"))):
            if video.is_dir() and any(file.suffix.lower() in IMAGE_SUFFIXES for file in video.iterdir()):
                yield video


def _read_prompt(folder: Path) -> str | None:
    for name in _PROMPTS:
        try:
            return read_text(folder / name)[:10_000].strip() or None  # characters of a prompt
        except (OSError, ValueError):
            continue
    return None
