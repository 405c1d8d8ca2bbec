"""Trajectories in npz files: given by hand, or the tracks of an output folder."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.npz import Archive, at_most, open_npz
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
    with open_npz(path, at_most(_MAX_BYTES)) as archive:
        return _recording(archive, choice)


def _recording(archive: Archive, choice: Choice) -> Recording:
    names = archive.files

    def optional(name: str) -> NDArray[np.generic] | None:
        return archive[name] if name in names else None

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
    values = archive[taken]
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
