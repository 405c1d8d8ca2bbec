"""`tracks/ID.npz`: a gripper track and its joint angles, the same bytes for the same numbers."""

import io
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array
from kinebench_drake.products import GripperTrack, JointTrack
from kinebench_drake.results import write_atomically

_EPOCH = (1980, 1, 1, 0, 0, 0)
"""The earliest date a zip entry can bear: a fixed one, as clock times would change the bytes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackFile:
    """What one file holds."""

    track: GripperTrack
    q: Array
    """(T, 7) joint angles [rad]; NaN where there are none."""
    ik_ok: NDArray[np.bool_]
    """(T,) whether the pose is reached within limits."""
    manipulability: Array
    """(T,) sqrt(det(J J^T)) of the 6x7 Jacobian of panda_hand_tcp; NaN where there is none."""
    joint_margin: Array
    """(T,) distance to the nearest joint limit over half its range; NaN where there is none."""


def write_track(path: Path, track: GripperTrack, joints: JointTrack | None, per_frame: Mapping[str, Array]) -> None:
    """Write a track; without `joints` (video only) q is NaN and ik_ok false.

    Args:
        path: the file, `tracks/ID.npz`.
        track: poses in the camera and in the base frame.
        joints: joint angles that follow them.
        per_frame: `manipulability` and `joint_margin`, each (T,); NaN where left out.

    Raises:
        SetupError: writing failed.
    """
    n = len(track.t_s)
    nothing = np.full(n, np.nan)
    arrays: dict[str, NDArray[np.generic]] = {
        "t_s": track.t_s,
        "camera_from_hand": track.X_CH,
        "base_from_tcp": track.X_BG,
        "tracked": track.tracked.astype(bool),
        "confidence": track.confidence,
        "finger_width_m": track.finger_width_m,
        "q": joints.q if joints else np.full((n, 7), np.nan),
        "ik_ok": joints.ok if joints else np.zeros(n, dtype=bool),
        "manipulability": per_frame.get("manipulability", nothing),
        "joint_margin": per_frame.get("joint_margin", nothing),
    }
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, array in arrays.items():
            data = io.BytesIO()
            np.lib.format.write_array(data, np.ascontiguousarray(array), allow_pickle=False)
            entry = zipfile.ZipInfo(f"{name}.npy", date_time=_EPOCH)
            archive.writestr(entry, data.getvalue(), compress_type=zipfile.ZIP_DEFLATED)
    write_atomically(path, buffer.getvalue())


def read_track(path: Path) -> TrackFile:
    """Read what `write_track` wrote.

    Raises:
        InputError: the file is absent, damaged, or lacks an array.
    """
    try:
        with np.load(path, allow_pickle=False) as a:
            track = GripperTrack(
                t_s=a["t_s"],
                X_CH=a["camera_from_hand"],
                X_BG=a["base_from_tcp"],
                tracked=a["tracked"],
                confidence=a["confidence"],
                finger_width_m=a["finger_width_m"],
            )
            nothing = np.full(len(track.t_s), np.nan)
            extra = {name: a[name] if name in a.files else nothing for name in ("manipulability", "joint_margin")}
            return TrackFile(track=track, q=a["q"], ik_ok=a["ik_ok"], **extra)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"{path.name}: not a track file ({error})") from None
