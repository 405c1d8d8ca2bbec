"""Arrays of a whole video in files: npy, npz, and folders of one png a frame."""

import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.lib.npyio import NpzFile
from numpy.typing import NDArray
from PIL import Image

from kinebench_drake.errors import InputError, cause
from kinebench_drake.grounding.frame_folder import frame_files

_UNREADABLE = (OSError, ValueError, EOFError, MemoryError, zipfile.BadZipFile, zlib.error)


@contextmanager
def open_archive(path: Path) -> Iterator[NpzFile]:
    """The arrays of an npz file; pickled objects are never loaded.

    Raises:
        InputError: the file is damaged, or something else.
    """
    try:
        if not zipfile.is_zipfile(path):
            raise InputError(f"{path.name}: is not a whole zip archive, expected an npz file as np.savez writes it")
        with np.load(path, allow_pickle=False) as archive:
            yield archive
    except _UNREADABLE as error:
        raise InputError(f"{path.name}: not a readable npz file ({cause(error)})") from None


def pick(archive: NpzFile, names: Sequence[str], path: Path) -> tuple[str, NDArray[np.generic]]:
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
        array = np.load(path, allow_pickle=False)
    except _UNREADABLE as error:
        raise InputError(f"{path.name}: not a readable npy file ({cause(error)})") from None
    if not isinstance(array, np.ndarray):
        raise InputError(f"{path.name}: holds several arrays; name it {path.stem}.npz")
    return array


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
        try:
            with Image.open(file) as picture:
                image = np.asarray(picture)
        except (*_UNREADABLE, SyntaxError, Image.DecompressionBombError) as error:
            raise InputError(f"{folder.name}/{file.name}: not a readable image ({cause(error)})") from None
        if images and (image.shape, image.dtype) != (images[0].shape, images[0].dtype):
            raise InputError(
                f"{folder.name}/{file.name}: {image.dtype} of shape {image.shape}, the first picture is "
                f"{images[0].dtype} of shape {images[0].shape}"
            )
        images.append(image)
    return np.stack(images)
