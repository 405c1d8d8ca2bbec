"""EWMBench's folders, which WorldArena's pre-processing writes too.

    gt_dataset/TASK/EPISODE/video/frame_00000.jpg ...       the true video
    gt_dataset/TASK/EPISODE/prompt/init_frame.png           its first frame, which models are given
    gt_dataset/TASK/EPISODE/prompt/introduction.txt         what shall happen (prompt.txt in WorldArena)
    MODEL_dataset/TASK/EPISODE/1/video/frame_00000.jpg ...  a model's videos, several an episode

as the README of EWMBench (https://github.com/AgibotTech/EWMBench) and that of WorldArena's video_quality
(https://github.com/tsinghua-fib-lab/WorldArena) ask for; the folder's name has to end with _dataset. What their own
steps leave behind (gripper_detection/, traj/) is passed over. Their `video_resize.py` scales frames to 640 x 480
whatever their shape: with the first frame at hand that is told and undone.
"""

from collections.abc import Iterator
from pathlib import Path

from kinebench_drake.datasets.videos.sample import VideoSample, camera_of
from kinebench_drake.datasets.videos.search import Search
from kinebench_drake.errors import InputError
from kinebench_drake.io.files import IMAGE_SUFFIXES, read_text

_SUFFIX, _TRUE = "_dataset", "gt"
_PROMPTS = ("introduction.txt", "prompt.txt")
_LONGEST = 10_000  # characters of a prompt


def is_ewmbench(folder: Path) -> bool:
    """Whether a folder is laid out so."""
    return folder.resolve().name.endswith(_SUFFIX) and next(_videos(folder), None) is not None


def list_ewmbench(folder: Path, search: Search) -> list[VideoSample]:
    """The videos of one model, or the true ones.

    Raises:
        InputError: there is none.
        UsageError: a camera.json is unusable.
    """
    model = folder.resolve().name.removesuffix(_SUFFIX)
    truth = folder if model == _TRUE else folder.resolve().parent / f"{_TRUE}{_SUFFIX}"
    samples = []
    for video in _videos(folder):
        task, episode, *take = video.relative_to(folder).parts[:-1]
        camera, source = camera_of(search.cameras.of(video))
        told = truth / task / episode / "prompt"
        picture = told / "init_frame.png"
        samples.append(
            VideoSample(
                id="-".join((model, task, episode, *take)),
                path=video,
                video=search.name(video),
                camera=camera,
                camera_source=source,
                task=task,
                model=model,
                prompt=_prompt(told),
                first_frame=picture if picture.is_file() else None,
            )
        )
    if not samples:
        raise InputError("holds no TASK/EPISODE/video/ and no TASK/EPISODE/1/video/ with frames")
    return samples


def _videos(folder: Path) -> Iterator[Path]:
    """The folders of frames."""
    for episode in sorted(folder.glob("*/*")):
        for video in (episode / "video", *sorted(episode.glob("*/video"))):
            if video.is_dir() and any(file.suffix.lower() in IMAGE_SUFFIXES for file in video.iterdir()):
                yield video


def _prompt(folder: Path) -> str | None:
    for name in _PROMPTS:
        try:
            return read_text(folder / name)[:_LONGEST].strip() or None
        except (OSError, ValueError):
            continue
    return None
