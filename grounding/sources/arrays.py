"""Arrays of a whole video in files: npy, npz, and folders of one png a frame."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake import npz
from kinebench_drake.errors import InputError
from kinebench_drake.grounding.frame_folder import frame_files, open_picture


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
        with open_picture(file) as picture:
            image = np.asarray(picture)
        if images and (image.shape, image.dtype) != (images[0].shape, images[0].dtype):
            raise InputError(
                f"{folder.name}/{file.name}: {image.dtype} of shape {image.shape}, the first picture is "
                f"{images[0].dtype} of shape {images[0].shape}"
            )
        images.append(image)
    return np.stack(images)
