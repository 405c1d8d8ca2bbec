"""`tracks/ID.npz`: a gripper track, its joint angles and curves along it; equal values give equal bytes."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.io.npz import Archive, open_npz, pack_arrays
from kinebench_drake.track import GripperTrack, IkStatus, JointTrack

_TRACK = {"t_s": "t_s", "camera_from_hand": "X_CH", "base_from_tcp": "X_BG"}
_TRACK |= {name: name for name in ("tracked", "confidence", "finger_width_m")}
"""Arrays of the gripper track, and the fields of `GripperTrack` that hold them."""
_OWN = (*_TRACK, "q", "ik_ok", "status")
"""Arrays other than curves."""
_OF_JOINTS = ("q", "velocity", "acceleration", "jerk", "torque")
_SINGLE = (
    *("ik_ok", "manipulability", "joint_margin", "self_distance_m", "table_distance_m"),
    *("ik_position_error_m", "ik_rotation_error_rad"),
)
"""Arrays with one value per joint and frame, and those with one per frame; other curves may be either."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackFile:
    """Content of a track file."""

    track: GripperTrack
    q: Array
    """(T, J) joint angles [rad]; NaN where unknown."""
    ik_ok: NDArray[np.bool_]
    """(T,) True where the pose is reached within limits."""
    status: tuple[IkStatus, ...] | None
    """(T,) outcome of inverse kinematics; None in a file without joint angles."""
    curves: Mapping[str, Array]
    """Curves along the track by name, such as `manipulability` (T,) or `torque` (T, J); NaN where unknown."""


def write_track(path: Path, track: GripperTrack, joints: JointTrack | None, curves: Mapping[str, Array]) -> None:
    """Write a track file; without `joints` (grounding only) q is NaN and ik_ok false.

    The residuals and the status of inverse kinematics are taken from `joints`. A curve with the name of another array
    of the file is ignored.

    Args:
        path: the file, `tracks/ID.npz`.
        track: poses in the camera frame and in the base frame.
        curves: further arrays (T,) or (T, J), NaN where unknown, by name.

    Raises:
        InputError: a curve is not (T,) or (T, J).
        SetupError: writing failed.
    """
    write_atomically(path, pack_arrays(track_arrays(track, joints, curves)))


def write_tracks(path: Path, arms: Mapping[str, Mapping[str, NDArray[np.generic]]]) -> None:
    """Write the file of arms with common times: of each its arrays (`track_arrays`), its name before theirs.

    The only arm has the name "", and its file is that of `write_track`.
    """
    arrays = {
        key if key == "t_s" or not name else f"{name}_{key}": array
        for name, own in arms.items()
        for key, array in own.items()
    }
    write_atomically(path, pack_arrays(arrays))


def track_arrays(
    track: GripperTrack, joints: JointTrack | None, curves: Mapping[str, Array]
) -> dict[str, NDArray[np.generic]]:
    """Return the arrays of a track file, see `write_track`."""
    n = len(track.t_s)
    arrays: dict[str, NDArray[np.generic]] = {
        **{name: getattr(track, field) for name, field in _TRACK.items()},
        "tracked": track.tracked.astype(bool),
        "q": joints.q if joints else np.full((n, 7), np.nan),
        "ik_ok": joints.ok if joints else np.zeros(n, dtype=bool),
    }
    if joints:
        arrays["status"] = np.array([status.value for status in joints.status], dtype=np.str_)
        curves = {
            "ik_position_error_m": joints.position_error_m,
            "ik_rotation_error_rad": joints.rotation_error_rad,
            **curves,
        }
    for name in sorted(curves.keys() - set(_OWN)):
        shape = np.shape(curves[name])
        of_joints = arrays["q"].shape
        if shape not in ((n,), of_joints):
            raise InputError(f"curve {name!r} has shape {shape}, expected {(n,)} or {of_joints}")
        arrays[name] = np.asarray(curves[name], dtype=np.float64)
    return arrays


def read_track(path: Path) -> TrackFile:
    """Read a track file of this or an earlier version.

    Raises:
        InputError: the file is absent, damaged, or lacks an array.
    """
    try:
        with open_npz(path) as a:
            if "left_q" in a.files:
                raise InputError("it holds two arms, which are not shown")
            lacking = [name for name in _OWN if name not in (*a.files, "status")]
            if lacking:
                raise InputError(f"lacks {', '.join(lacking)}")
            own: dict[str, Any] = {name: _numbers(a, name) for name in _OWN if name != "status"}
            own["tracked"] = own["tracked"].astype(bool)
            track = GripperTrack(**{field: own[name] for name, field in _TRACK.items()})
            n = len(track.t_s)
            curves = {name: _numbers(a, name) for name in sorted(set(a.files) - set(_OWN))}
            for name, array in {"q": own["q"], "ik_ok": own["ik_ok"], **curves}.items():
                of_joints = (n, *own["q"].shape[1:2])
                shapes: list[tuple[int, ...]] = [(n,)] * (name not in _OF_JOINTS)
                shapes += [of_joints] * (name not in _SINGLE)
                if array.shape not in shapes:
                    raise InputError(f"{name} has shape {array.shape}, expected {' or '.join(map(str, shapes))}")
            status = a["status"] if "status" in a.files else None
            if status is not None and status.shape != (n,):
                raise InputError(f"status has shape {status.shape}, expected {(n,)}")
            return TrackFile(
                track=track,
                q=own["q"],
                ik_ok=own["ik_ok"].astype(bool),
                status=None if status is None else tuple(IkStatus(str(s)) for s in status),
                curves=curves,
            )
    except (InputError, ValueError) as error:
        raise InputError(f"{path.name}: not a track file ({error})") from None


def _numbers(archive: Archive, name: str) -> Array:
    array = archive[name]
    if array.dtype.kind not in "biuf":
        raise InputError(f"{name} holds {array.dtype}, expected numbers")
    return array
