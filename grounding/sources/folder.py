"""Where a folder keeps what belongs to one video."""

from collections.abc import Sequence
from pathlib import Path

from kinebench_drake.errors import InputError

TRUTH, TRACKS = "truth", "tracks"
"""Subfolders: of a demonstration folder, and of the output folder of another run."""


def find_entry(folder: Path, names: Sequence[str], places: Sequence[str] = (TRUTH,)) -> Path:
    """The file `NAME.npz` or `NAME.npy` or the folder `NAME/` that belongs to a video.

    Args:
        folder: where to look.
        names: what the video is called, the best name first.
        places: subfolders that go before the folder itself: there the videos themselves may lie, under the same names.

    Raises:
        InputError: there is none.
    """
    for name in names:
        for place in (*places, ""):
            for file in (folder / place / f"{name}.npz", folder / place / f"{name}.npy"):
                if file.is_file():
                    return file
            if (folder / place / name).is_dir():
                return folder / place / name
    told = " or ".join(f"{name}.npz, {name}.npy, {name}/" for name in names)
    where = " and ".join(f"{place}/" for place in places)
    raise InputError(f"{folder.resolve().name} has nothing for this video: looked for {told} in it and in its {where}")
