"""Videos in npy and npz files: (T, H, W, 3) uint8, RGB."""

import zipfile
from pathlib import Path

import numpy as np

from kinebench_drake.errors import InputError, cause
from kinebench_drake.grounding.decoded import Video, VideoPart, check_size

ARRAY_SUFFIXES = frozenset({".npy", ".npz"})

_KEYS = ("frames", "video")


def read_array(path: Path, part: VideoPart) -> Video:
    """Read an npy file, or the array of an npz file that `part` names: else the one called frames, or the only one.

    Raises:
        InputError: the file is damaged, or the array is not (T, H, W, 3) uint8.
    """
    try:
        if path.suffix.lower() == ".npy":
            loaded = np.load(path, mmap_mode="r", allow_pickle=False)
            check_size(path, loaded.nbytes)
            frames = np.array(loaded)
        else:
            check_size(path, _unpacked_size(path))
            with np.load(path, allow_pickle=False) as archive:
                frames = archive[_chosen(path, archive.files, part.key)]
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, MemoryError) as error:
        raise InputError(f"{path.name}: not a readable array ({cause(error)})") from None
    try:
        return Video(frames=np.ascontiguousarray(frames), fps=None, stamps_s=None)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from None


def _chosen(path: Path, names: list[str], key: str | None) -> str:
    if key is not None:
        if key not in names:
            raise InputError(f"{path.name}: has no array {key!r} (--camera-key), but {', '.join(names)}")
        return key
    if len(names) == 1:
        return names[0]
    found = [name for name in _KEYS if name in names]
    if not found:
        raise InputError(
            f"{path.name}: holds {names}, expected one array or one named 'frames'; --camera-key NAME chooses one"
        )
    return found[0]


def _unpacked_size(path: Path) -> int:
    with zipfile.ZipFile(path) as archive:
        return sum(entry.file_size for entry in archive.infolist())
