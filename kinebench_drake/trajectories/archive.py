"""Trajectories in npz files: given by hand, or the tracks of an output folder."""

import zipfile
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError, cause
from kinebench_drake.trajectories.trajectory import Choice, Recording

SUFFIXES = frozenset({".npz"})

_MAX_BYTES = 2**28
_POSES, _JOINTS = "base_from_tcp", "q"


def read_archive(path: Path, choice: Choice) -> Recording:
    """Read `t_s` and `base_from_tcp` or `q`, and where they are there `tracked` and `finger_width_m`.

    Joint angles go before poses, as they leave no choice of posture; not so in the tracks of an output folder (told by
    their array `ik_ok`), whose angles were found from the poses.

    Raises:
        InputError: the file is damaged, lacks an array, or holds pickled objects.
    """
    if not path.stat().st_size:
        raise InputError("the file is empty (0 bytes)")
    if not zipfile.is_zipfile(path):
        raise InputError("is not a whole zip archive, expected an npz file as np.savez writes it")
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            return _recording(path, archive, choice)
    except (OSError, ValueError, EOFError, MemoryError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        if "pickle" in str(error):
            raise InputError("holds pickled Python objects, which are never loaded: save plain arrays") from None
        raise InputError(f"is not a readable npz archive ({cause(error)})") from None


def _recording(path: Path, archive: np.lib.npyio.NpzFile, choice: Choice) -> Recording:
    names = archive.files
    with zipfile.ZipFile(path) as raw:
        sizes = {entry.filename.removesuffix(".npy"): entry.file_size for entry in raw.infolist()}

    def load(name: str) -> NDArray[np.generic]:
        if sizes[name] > _MAX_BYTES:
            raise InputError(f"{name} takes {sizes[name] / 2**20:.0f} MiB, at most {_MAX_BYTES / 2**20:.0f} are taken")
        return np.asarray(archive[name])

    def optional(name: str) -> NDArray[np.generic] | None:
        return load(name) if name in names else None

    warnings = []
    if choice.joints is not None or choice.poses is not None:
        taken = str(choice.joints or choice.poses)
        if taken not in names:
            raise InputError(f"holds no array {taken!r}, but {_listed(names)}")
        is_joints = choice.joints is not None
    else:
        order = (_POSES, _JOINTS) if "ik_ok" in names else (_JOINTS, _POSES)
        found = [name for name in order if name in names]
        if not found:
            raise InputError(f"holds {_listed(names)}, expected t_s and {_POSES} (T,4,4) or {_JOINTS} (T,7)")
        taken, is_joints = found[0], found[0] == _JOINTS
        if len(found) > 1 and "ik_ok" not in names:
            warnings.append(f"holds {_JOINTS} and {_POSES}: {_JOINTS} was taken (--poses {_POSES} takes the poses)")
    values = load(taken)
    return Recording(
        t_s=optional("t_s"),
        X_BG=None if is_joints else values,
        q=values if is_joints else None,
        tracked=optional("tracked"),
        finger_width_m=optional("finger_width_m"),
        columns=taken,
        warnings=tuple(warnings),
    )


def _listed(names: list[str]) -> str:
    return f"the arrays {', '.join(names[:12])}" if names else "no array"
