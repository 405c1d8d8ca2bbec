"""Training data of the baseline: demonstrations, their decoded frames and random windows of these."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import Dataset

from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError, UsageError, cause
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.baseline.network import CONTEXT, resize_frames
from kinebench_drake.grounding.evaluation.clip import TruthClipFile, find_clips
from kinebench_drake.grounding.training.augment import degrade, occlude
from kinebench_drake.io.atomic import atomic_path
from kinebench_drake.io.reader import read_video

_REPORT_EVERY = 100  # videos
_HOW = "make one with `kinebench-drake suite demos --suite 1 --split train --out FOLDER`"


@dataclass(frozen=True, slots=True, kw_only=True)
class Demonstration:
    """Video of a demonstration with its ground truth."""

    id: str
    task: str
    path: Path
    """Video file."""
    t_s: Array
    """(T,) task time [s]."""
    X_BG: Array
    """(T, 4, 4) true pose of panda_hand_tcp in the base frame [m]."""
    finger_width_m: Array
    """(T,) true gap between the finger pads [m]."""

    def __post_init__(self) -> None:
        """Check the shapes.

        Raises:
            InputError: a shape does not fit the number of frames, or a number is not finite.
        """
        n = len(self.t_s)
        for name, shape in (("X_BG", (n, 4, 4)), ("finger_width_m", (n,))):
            value = getattr(self, name)
            if value.shape != shape or not np.isfinite(value).all():
                raise InputError(f"{self.id}: {name} has shape {value.shape}, expected finite numbers {shape}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Demonstrations:
    """Demonstrations of a folder, all recorded by one camera."""

    folder: Path
    camera: Camera
    clips: tuple[Demonstration, ...]

    @property
    def tasks(self) -> tuple[str, ...]:
        """Plain task ids, sorted."""
        return tuple(sorted({clip.task for clip in self.clips}))


def load_demonstrations(folder: Path) -> Demonstrations:
    """Return the clips listed in the manifest of a folder.

    Raises:
        UsageError: manifest, camera or ground truth is missing or unusable, or no video is listed.
    """
    files = find_clips(folder)
    return Demonstrations(folder=folder, camera=files[0].camera, clips=tuple(map(_load, files)))


def _load(file: TruthClipFile) -> Demonstration:
    if not file.task:
        raise UsageError(f"{file.video.name}: the manifest names no task; {_HOW}")
    try:
        with np.load(file.truth, allow_pickle=False) as truth:
            return Demonstration(
                id=file.id,
                task=file.task,
                path=file.video,
                t_s=truth["t_s"],
                X_BG=truth["base_from_tcp"],
                finger_width_m=truth["finger_width_m"],
            )
    except (OSError, ValueError, KeyError, InputError) as error:
        raise UsageError(f"truth/{file.truth.name}: cannot be used ({cause(error)}); {_HOW}") from None


def decode(
    clips: Sequence[Demonstration], folder: Path, size: int, report: Callable[[str], None]
) -> list[NDArray[np.uint8]]:
    """Return the frames (T, size, size, 3) of each clip, memory-mapped from `folder`, decoding missing ones first.

    A video newer than its decoded frames is decoded again.

    Raises:
        UsageError: a video and its ground truth differ in the number of frames.
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
                np.save(part, resize_frames(frames, size))
            if number % _REPORT_EVERY == 0:
                report(f"decoded {number} of {len(clips)} videos")
        arrays.append(np.load(path, mmap_mode="r"))
    return arrays


LABELLED = 3
"""Frames of a window with labels; CONTEXT more frames lie on each side."""
_DEGRADED = 0.75  # share of windows
_OCCLUDED = 0.15  # share of windows


class Windows(Dataset[dict[str, Tensor]]):
    """Random windows by index: the same seed and index give the same window, in any order of access.

    All tasks are equally frequent, and so are all clips of a task. Beyond the ends of a video its first or last frame
    is repeated. All frames of a window are degraded alike.
    """

    def __init__(
        self, clips: Sequence[Demonstration], frames: Sequence[NDArray[np.uint8]], seed: int, length: int
    ) -> None:
        """Prepare `length` windows from `clips` with `frames` (T, S, S, 3) each."""
        self._clips, self._frames, self._seed, self._length = clips, frames, seed, length
        tasks = sorted({clip.task for clip in clips})
        self._of_task = [[i for i, clip in enumerate(clips) if clip.task == task] for task in tasks]

    def __len__(self) -> int:
        """Return the number of windows of an epoch."""
        return self._length

    def __getitem__(self, index: int) -> dict[str, Tensor]:
        """Return a window: image (LABELLED + 2 CONTEXT, 3, S, S) uint8; position [m], rotation, finger_width [m]."""
        rng = np.random.default_rng([self._seed, index])
        members = self._of_task[rng.integers(len(self._of_task))]
        number = members[rng.integers(len(members))]
        clip, frames = self._clips[number], self._frames[number]
        start = int(rng.integers(max(1, len(frames) - LABELLED + 1)))
        numbers = np.clip(np.arange(start - CONTEXT, start + LABELLED + CONTEXT), 0, len(frames) - 1)
        images = np.array(frames[numbers])
        degrading, occluding = rng.random() < _DEGRADED, rng.random() < _OCCLUDED
        draw, scenery = int(rng.integers(2**32)), np.array(frames[0])
        for k, image in enumerate(images):
            if occluding:
                occlude(image, np.zeros((1, 1), np.uint8), scenery, np.random.default_rng([draw, 0]))
            if degrading:
                images[k] = degrade(image, np.random.default_rng([draw, 1]))
        labelled = numbers[CONTEXT : CONTEXT + LABELLED]
        X_BG = torch.from_numpy(clip.X_BG[labelled]).float()
        return {
            "image": torch.from_numpy(images).permute(0, 3, 1, 2),
            "position": X_BG[:, :3, 3],
            "rotation": X_BG[:, :3, :3],
            "finger_width": torch.from_numpy(clip.finger_width_m[labelled]).float(),
        }
