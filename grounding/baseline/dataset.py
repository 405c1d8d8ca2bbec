"""Training data of the baseline: demonstrations, decoded frames and windows of them."""

import json
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import Dataset

from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError, UsageError, cause
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.baseline.network import CONTEXT
from kinebench_drake.grounding.training.augment import degrade, occlude
from kinebench_drake.grounding.view import Frames
from kinebench_drake.io.atomic import atomic_path
from kinebench_drake.io.camerafile import load_camera
from kinebench_drake.io.reader import read_video

_HOW = "make one with `kinebench-drake suite demos --suite 1 --split train --out FOLDER`"


@dataclass(frozen=True, slots=True, kw_only=True)
class Demonstration:
    """One clip of a demonstration."""

    id: str
    task: str
    path: Path
    """The video."""
    t_s: Array
    """(T,) task time [s]."""
    X_BG: Array
    """(T, 4, 4) true pose of panda_hand_tcp in the base frame [m]."""
    finger_width_m: Array
    """(T,) true gap between the finger pads [m]."""

    def __post_init__(self) -> None:
        """Check shapes against the number of frames.

        Raises:
            InputError: they differ, or a number is not finite.
        """
        n = len(self.t_s)
        for name, shape in (("X_BG", (n, 4, 4)), ("finger_width_m", (n,))):
            value = getattr(self, name)
            if value.shape != shape or not np.isfinite(value).all():
                raise InputError(f"{self.id}: {name} has shape {value.shape}, expected finite numbers {shape}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Demonstrations:
    """The clips of a folder, all taken by one camera."""

    folder: Path
    camera: Camera
    clips: tuple[Demonstration, ...]

    @property
    def tasks(self) -> tuple[str, ...]:
        """Their tasks, sorted."""
        return tuple(sorted({clip.task for clip in self.clips}))


def load_demonstrations(folder: Path, tasks: Collection[str] | None = None) -> Demonstrations:
    """The clips that a folder's manifest lists, of `tasks` only if given.

    Raises:
        UsageError: manifest, camera or truth is missing, or no clip is left.
    """
    manifest = folder / "manifest.jsonl"
    if not manifest.is_file():
        raise UsageError(f"{folder.name}: has no manifest.jsonl; {_HOW}")
    clips = []
    for number, line in enumerate(manifest.read_text().splitlines(), 1):
        try:
            entry = json.loads(line)
            video, task = str(entry["video"]), str(entry["task"])
        except (ValueError, KeyError, TypeError):
            raise UsageError(f"{manifest.name} line {number}: expected an object with the keys video, task") from None
        if tasks is None or task in tasks:
            clips.append(_load(folder, video, task))
    if not clips:
        raise UsageError(f"{folder.name}: its manifest lists no video of {', '.join(tasks or ['any task'])}")
    return Demonstrations(folder=folder, camera=load_camera(folder / "camera.json"), clips=tuple(clips))


def _load(folder: Path, video: str, task: str) -> Demonstration:
    path = folder / "truth" / f"{Path(video).stem}.npz"
    if not path.is_file():
        raise UsageError(f"{folder.name}: truth/{path.name} is missing, so nothing can be learned or measured; {_HOW}")
    try:
        with np.load(path, allow_pickle=False) as truth:
            return Demonstration(
                id=path.stem,
                task=task,
                path=folder / video,
                t_s=truth["t_s"],
                X_BG=truth["base_from_tcp"],
                finger_width_m=truth["finger_width_m"],
            )
    except (OSError, ValueError, KeyError, InputError) as error:
        raise UsageError(f"{folder.name}: truth/{path.name} cannot be used ({cause(error)}); {_HOW}") from None


_REPORT_EVERY = 100


def resized(frames: Frames, size: int) -> NDArray[np.uint8]:
    """Frames (T, size, size, 3) of any (T, H, W, 3), each pixel the mean of what it covers."""
    if frames.shape[1:3] == (size, size):
        return frames
    smaller = frames.shape[1] >= size and frames.shape[2] >= size
    how = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
    return np.stack([np.asarray(cv2.resize(f, (size, size), interpolation=how), dtype=np.uint8) for f in frames])


def decode(
    clips: Sequence[Demonstration], folder: Path, size: int, report: Callable[[str], None]
) -> list[NDArray[np.uint8]]:
    """Frames (T, size, size, 3) of each clip, mapped from `folder`; what is missing there is decoded first.

    A video newer than its frames is decoded again.

    Raises:
        UsageError: a video has another number of frames than its truth.
        InputError: a video cannot be read.
        SetupError: writing failed.
    """
    arrays = []
    for number, clip in enumerate(clips, 1):
        path = folder / f"{clip.id}_{size}.npy"
        if not path.is_file() or path.stat().st_mtime < clip.path.stat().st_mtime:
            frames = read_video(clip.path).frames
            if len(frames) != len(clip.t_s):
                raise UsageError(f"{clip.path.name}: has {len(frames)} frames, its truth has {len(clip.t_s)}")
            with atomic_path(path) as part:
                np.save(part, resized(frames, size))
            if number % _REPORT_EVERY == 0:
                report(f"decoded {number} of {len(clips)} videos")
        arrays.append(np.load(path, mmap_mode="r"))
    return arrays


LABELLED = 3
"""Frames of a window whose poses are asked for; CONTEXT more lie to each side."""
_DEGRADED = 0.75  # share of windows
_OCCLUDED = 0.15


class Windows(Dataset[dict[str, Tensor]]):
    """Item i is a random window, the same for the same seed and i whatever the order of reading.

    Every task is as frequent as any other, and so is every clip of a task. At the ends of a video the outermost frame
    stands for those beyond. One draw of the degradation holds for all frames of a window, as it does in a video.
    """

    def __init__(
        self, clips: Sequence[Demonstration], frames: Sequence[NDArray[np.uint8]], seed: int, length: int
    ) -> None:
        """Draw `length` windows from `clips`, whose `frames` are (T, S, S, 3) each."""
        self._clips, self._frames, self._seed, self._length = clips, frames, seed, length
        tasks = sorted({clip.task for clip in clips})
        self._of_task = [[i for i, clip in enumerate(clips) if clip.task == task] for task in tasks]

    def __len__(self) -> int:
        """Number of windows an epoch is said to have."""
        return self._length

    def __getitem__(self, index: int) -> dict[str, Tensor]:
        """Window `index`: image (LABELLED + 2 CONTEXT, 3, S, S) uint8; position [m], rotation, finger_width [m]."""
        rng = np.random.default_rng([self._seed, index])
        members = self._of_task[rng.integers(len(self._of_task))]
        number = members[rng.integers(len(members))]
        clip, frames = self._clips[number], self._frames[number]
        start = int(rng.integers(max(1, len(frames) - LABELLED + 1)))
        seen = np.clip(np.arange(start - CONTEXT, start + LABELLED + CONTEXT), 0, len(frames) - 1)
        images = np.array(frames[seen])
        degrading, occluding = rng.random() < _DEGRADED, rng.random() < _OCCLUDED
        draw, scenery = int(rng.integers(2**32)), np.array(frames[0])
        for k, image in enumerate(images):
            if occluding:
                occlude(image, np.zeros((1, 1), np.uint8), scenery, np.random.default_rng([draw, 0]))
            if degrading:
                images[k] = degrade(image, np.random.default_rng([draw, 1]))
        labelled = seen[CONTEXT : CONTEXT + LABELLED]
        X_BG = torch.from_numpy(clip.X_BG[labelled]).float()
        return {
            "image": torch.from_numpy(images).permute(0, 3, 1, 2),
            "position": X_BG[:, :3, 3],
            "rotation": X_BG[:, :3, :3],
            "finger_width": torch.from_numpy(clip.finger_width_m[labelled]).float(),
        }
