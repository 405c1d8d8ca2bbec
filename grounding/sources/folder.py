"""Where a folder keeps what belongs to one video."""

from collections.abc import Sequence
from pathlib import Path

from kinebench_drake.errors import InputError

_PLACES = ("", "truth", "tracks")
"""Below the folder named: its own, a demonstration folder's truth, tracks that another run found."""


def find_entry(folder: Path, names: Sequence[str]) -> Path:
    """The file `NAME.npz` or `NAME.npy` or the folder `NAME/` that belongs to a video.

    Args:
        folder: where to look; its subfolders truth/ and tracks/ are looked into as well.
        names: what the video is called, the best name first.

    Raises:
        InputError: there is none.
    """
    for name in names:
        for place in _PLACES:
            for file in (folder / place / f"{name}.npz", folder / place / f"{name}.npy"):
                if file.is_file():
                    return file
            if (folder / place / name).is_dir():
                return folder / place / name
    told = " or ".join(f"{name}.npz, {name}.npy, {name}/" for name in names)
    where = folder.resolve().name
    raise InputError(f"{where} has nothing for this video: looked for {told} in it, in its truth/ and in its tracks/")
