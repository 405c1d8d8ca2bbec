"""Arrays of a whole video in files: npy, npz, and folders of one png a frame."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array
from kinebench_drake.io import npz
from kinebench_drake.io.images import frame_files, open_image
from kinebench_drake.io.npz import Archive


@contextmanager
def open_archive(path: Path) -> Iterator[npz.Archive]:
    """The arrays of an npz file; pickled objects are never loaded.

    Raises:
        InputError: the file is damaged, or something else.
    """
    try:
        with npz.open_npz(path) as archive:
            yield archive
    except InputError as error:
        raise InputError(f"{path.name}: {str(error).removeprefix(f'{path.name}: ')}") from None


def pick(archive: npz.Archive, names: Sequence[str], path: Path) -> tuple[str, NDArray[np.generic]]:
    """The first of the named arrays that is there, and its name.

    Raises:
        InputError: none of them is there.
    """
    for name in names:
        if name in archive.files:
            return name, archive[name]
    held = ", ".join(archive.files[:12]) or "nothing"
    raise InputError(
        f"{path.name}: holds {held}; expected {' or '.join(names)} (truth of demonstrations has depth and masks where "
        "they were made with --with-depth)"
    )


def read_npy(path: Path) -> NDArray[np.generic]:
    """The array of an npy file.

    Raises:
        InputError: the file is damaged, or something else.
    """
    try:
        return npz.read_npy(path)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from None


def png_files(folder: Path) -> list[Path]:
    """The png files of a folder in natural order: 2.png before 10.png."""
    return [file for file in frame_files(folder) if file.suffix.lower() == ".png"]


def read_pngs(folder: Path) -> NDArray[np.generic]:
    """The pictures of a folder, one a frame in natural order: (T, H, W), or (T, H, W, channels) of those in colour.

    Raises:
        InputError: there is none, one is damaged, or they differ in size or in kind.
    """
    files = png_files(folder)
    if not files:
        raise InputError(f"{folder.name}/: holds no png files, expected one for every frame")
    images: list[NDArray[np.generic]] = []
    for file in files:
        with open_image(file) as picture:
            image = np.asarray(picture)
        if images and (image.shape, image.dtype) != (images[0].shape, images[0].dtype):
            raise InputError(
                f"{folder.name}/{file.name}: {image.dtype} of shape {image.shape}, the first picture is "
                f"{images[0].dtype} of shape {images[0].shape}"
            )
        images.append(image)
    return np.stack(images)


_HALF_MM = 0.5  # stored depth is cut towards zero


def holds_truth(archive: Archive) -> bool:
    """Whether an archive is the truth of a demonstration with depth and mask, not another program's arrays."""
    return {"camera_from_hand", "depth_mm", "mask"} <= set(archive.files)


def true_depth(archive: Archive) -> Array:
    """Depth (T, H, W) along the camera's axis [m]; 0 where nothing is."""
    depth_mm = archive["depth_mm"]
    if depth_mm.dtype.kind not in "iuf":
        raise InputError(f"the depth is {depth_mm.dtype}, expected numbers")
    return np.asarray(np.where(depth_mm > 0, depth_mm + _HALF_MM, 0.0) / 1000.0)


def true_mask(archive: Archive) -> NDArray[np.bool_]:
    """Pixels (T, H, W) that show the gripper; stored packed along the width, which the depth tells."""
    shape, packed = archive.shape("depth_mm"), archive["mask"]
    if packed.dtype != np.uint8 or len(shape) != 3 or packed.shape != (*shape[:2], -(-shape[2] // 8)):
        raise InputError(f"the mask is {packed.dtype} of shape {packed.shape}, which does not fit the depth's {shape}")
    return np.unpackbits(packed, axis=-1, count=shape[2]).astype(bool)


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
