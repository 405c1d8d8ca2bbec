"""Masks of the gripper from another segmenter."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.grounding.sources.arrays import open_archive, pick, png_files, read_npy, read_pngs
from kinebench_drake.grounding.sources.truth import holds_truth, true_mask

_MOST = 0.9  # of all pixels; a gripper that fills the picture cannot be tracked anyway


def mask_files(entry: Path) -> list[Path]:
    """The files that `read_masks` reads."""
    return png_files(entry) if entry.is_dir() else [entry]


def read_masks(entry: Path) -> NDArray[np.bool_]:
    """Pixels (T, H, W) that show the gripper, hand and fingers: those that are not 0.

    Args:
        entry: npz with `mask` or `masks`, npy, folder of one png a frame (of colour pictures any channel counts, alpha
            does not), or the truth of a demonstration.

    Raises:
        InputError: it cannot be read, or leaves open what is gripper.
    """
    masks = _read(entry)
    if masks.size and masks.mean() > _MOST:
        raise InputError(
            f"{entry.name}: the masks cover {masks.mean():.0%} of the pictures; expected 0 where the gripper is not "
            "(pictures of the video itself, or masks the other way round?)"
        )
    return masks


def _read(entry: Path) -> NDArray[np.bool_]:
    if entry.is_dir():
        return _of_pictures(read_pngs(entry))
    if entry.suffix == ".npy":
        return _of_array(read_npy(entry), entry)
    with open_archive(entry) as archive:
        if holds_truth(archive):
            return true_mask(archive)
        return _of_array(pick(archive, ("mask", "masks"), entry)[1], entry)


def _of_pictures(pictures: NDArray[np.generic]) -> NDArray[np.bool_]:
    if pictures.ndim == 3:
        return pictures.astype(bool)
    colours = pictures.shape[3] - (pictures.shape[3] in (2, 4))
    return np.asarray(pictures[..., :colours].astype(bool).any(axis=3))


def _of_array(array: NDArray[np.generic], entry: Path) -> NDArray[np.bool_]:
    if array.dtype.kind not in "biuf" or (array.dtype.kind == "f" and not np.isin(array, (0, 1)).all()):
        raise InputError(
            f"{entry.name}: the masks are {array.dtype} with values besides 0 and 1; expected truth values or whole "
            "numbers, 0 where the gripper is not"
        )
    return array.astype(bool)
