"""One frame under every perturbation, to be looked at."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.grounding.evaluation.clip import TruthClipFile
from kinebench_drake.grounding.evaluation.perturbation.catalogue import PerturbationKind, ladder, perturb
from kinebench_drake.grounding.evaluation.visibility import true_masks
from kinebench_drake.io.reader import read_video
from kinebench_drake.models.panda.cad import GripperCad


def sheet_of(file: TruthClipFile, kinds: Sequence[PerturbationKind], seed: int) -> dict[str, NDArray[np.uint8]]:
    """A frame of a clip as it is, where the gripper shows most, and under each perturbation, by name.

    Raises:
        UsageError: the clip's truth cannot be read.
        InputError: its video cannot be read.
    """
    clip = file.load()
    frames = read_video(clip.path).frames
    masks = true_masks(clip, GripperCad())
    chosen = int(masks.sum(axis=(1, 2)).argmax())
    pictures = {"as it is": frames[chosen]}
    for step in (p for kind in kinds for p in ladder(kind)):
        pictures[step.label] = perturb(step, frames, masks, seed, clip.id)[0][chosen]
    return pictures
