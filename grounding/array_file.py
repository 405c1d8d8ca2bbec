"""Videos in npy and npz files: (T, H, W, 3) uint8, RGB."""

from functools import partial
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.grounding.decoded import Video, VideoPart, check_size
from kinebench_drake.npz import open_npz, read_npy

ARRAY_SUFFIXES = frozenset({".npy", ".npz"})

_KEYS = ("frames", "video")


def read_array(path: Path, part: VideoPart) -> Video:
    """Read an npy file, or the array of an npz file that `part` names: else the one called frames, or the only one.

    Raises:
        InputError: the file is damaged, or the array is not (T, H, W, 3) uint8.
    """
    check = partial(check_size, "the array")
    try:
        if path.suffix.lower() == ".npy":
            frames = read_npy(path, check)
        else:
            with open_npz(path, check) as archive:
                frames = archive[_chosen(archive.files, part.key)]
        return Video(frames=cast(NDArray[np.uint8], np.ascontiguousarray(frames)), fps=None, stamps_s=None)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from None


def _chosen(names: list[str], key: str | None) -> str:
    if key is not None:
        if key not in names:
            raise InputError(f"has no array {key!r} (--camera-key), but {', '.join(names)}")
        return key
    if len(names) == 1:
        return names[0]
    found = [name for name in _KEYS if name in names]
    if not found:
        raise InputError(f"holds {names}, expected one array or one named 'frames'; --camera-key NAME chooses one")
    return found[0]
