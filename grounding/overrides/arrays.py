"""Arrays of a whole video in files (npy, npz, folders of one png per frame), and masks read from them."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array
from kinebench_drake.io.images import frame_files, open_image
from kinebench_drake.io.npz import Archive, open_npz, read_npy

_HALF_MM = 0.5  # stored depth is truncated
_MAX_SHARE = 0.9  # of all pixels; a gripper that fills the image cannot be tracked anyway


@contextmanager
def errors_naming(source: Path | str) -> Iterator[None]:
    """Prefix the messages of input errors with a source: an argument, or the name of a file or folder."""
    if isinstance(source, Path):
        source = f"{source.name}/" if source.is_dir() else source.name
    try:
        yield
    except InputError as error:
        raise error if str(error).startswith(source) else InputError(f"{source}: {error}") from None


def pick(archive: Archive, names: Sequence[str]) -> tuple[str, NDArray[np.generic]]:
    """Return name and value of the first of the named arrays that exists.

    Raises:
        InputError: none of them exists.
    """
    for name in names:
        if name in archive.files:
            return name, archive[name]
    content = ", ".join(archive.files[:12]) or "nothing"
    raise InputError(
        f"holds {content}; expected {' or '.join(names)} (the truth of demonstrations has depth and masks if they were "
        "made with --with-depth)"
    )


def array_files(entry: Path) -> list[Path]:
    """Return the files of a video's masks or depth; those of a folder in natural order: 2.png before 10.png."""
    if entry.is_dir():
        return [file for file in frame_files(entry) if file.suffix.lower() == ".png"]
    return [entry]


def read_pngs(folder: Path) -> NDArray[np.generic]:
    """Read the images of a folder in natural order: (T, H, W) if grey, (T, H, W, channels) if in colour.

    Raises:
        InputError: there is none, one is damaged, or they differ in size or type.
    """
    files = array_files(folder)
    if not files:
        raise InputError("holds no png files, expected one for every frame")
    images: list[NDArray[np.generic]] = []
    for file in files:
        with open_image(file) as opened:
            image = np.asarray(opened)
        if images and (image.shape, image.dtype) != (images[0].shape, images[0].dtype):
            raise InputError(
                f"{folder.name}/{file.name}: {image.dtype} of shape {image.shape}, the first image is "
                f"{images[0].dtype} of shape {images[0].shape}"
            )
        images.append(image)
    return np.stack(images)


def is_demo_truth(archive: Archive) -> bool:
    """Return whether an archive is the ground truth of a demonstration with depth and mask."""
    return {"camera_from_hand", "depth_mm", "mask"} <= set(archive.files)


def true_depth(archive: Archive) -> Array:
    """Return the depth (T, H, W) of a demonstration along the camera's axis [m]; 0 where there is no surface."""
    depth_mm = archive["depth_mm"]
    if depth_mm.dtype.kind not in "iuf":
        raise InputError(f"the depth is {depth_mm.dtype}, expected numbers")
    return np.asarray(np.where(depth_mm > 0, depth_mm + _HALF_MM, 0.0) / 1000.0)


def true_mask(archive: Archive) -> NDArray[np.bool_]:
    """Return the gripper mask (T, H, W) of a demonstration; it is packed along the width, whose size is the depth's."""
    shape, packed = archive.shape("depth_mm"), archive["mask"]
    if packed.dtype != np.uint8 or len(shape) != 3 or packed.shape != (*shape[:2], -(-shape[2] // 8)):
        raise InputError(f"the mask is {packed.dtype} of shape {packed.shape}, which does not fit the depth's {shape}")
    return np.unpackbits(packed, axis=-1, count=shape[2]).astype(bool)


def read_masks(entry: Path) -> NDArray[np.bool_]:
    """Read the gripper mask (T, H, W) of hand and fingers: pixels that are not 0.

    Args:
        entry: npz with `mask` or `masks`, npy, folder of one png per frame (in colour images any channel but alpha
            counts), or the ground truth of a demonstration.

    Raises:
        InputError: it cannot be read, or its values are no masks of a gripper.
    """
    with errors_naming(entry):
        if entry.is_dir():
            masks = read_pngs(entry).astype(bool)
            if masks.ndim == 4:
                colours = masks.shape[3] - (masks.shape[3] in (2, 4))
                masks = np.asarray(masks[..., :colours].any(axis=3))
        elif entry.suffix == ".npy":
            masks = _as_mask(read_npy(entry))
        else:
            with open_npz(entry) as archive:
                truth = is_demo_truth(archive)
                masks = true_mask(archive) if truth else _as_mask(pick(archive, ("mask", "masks"))[1])
        if masks.size and masks.mean() > _MAX_SHARE:
            raise InputError(
                f"the masks cover {masks.mean():.0%} of the images; expected 0 where the gripper is not (images of the "
                "video itself, or inverted masks?)"
            )
        return masks


def _as_mask(array: NDArray[np.generic]) -> NDArray[np.bool_]:
    if array.dtype.kind not in "biuf" or (array.dtype.kind == "f" and not np.isin(array, (0, 1)).all()):
        raise InputError(
            f"the masks are {array.dtype} with values besides 0 and 1; expected truth values or whole numbers, 0 where "
            "the gripper is not"
        )
    return array.astype(bool)
