"""What the baseline learns from: short windows of demonstrations, degraded, with the poses of their frames."""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import Dataset

from kinebench_drake.grounding.baseline.demonstration import Demonstration
from kinebench_drake.grounding.baseline.network import CONTEXT
from kinebench_drake.grounding.training.augment import degrade, occlude

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
