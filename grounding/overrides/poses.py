"""Poses of the gripper from another tracker."""

import io
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError, cause
from kinebench_drake.geometry import Array, checked_pose
from kinebench_drake.grounding.overrides.arrays import open_archive, pick, read_npy
from kinebench_drake.io.files import read_text

MESH_NAME = "mesh_from_hand.txt"
"""File with the pose (4, 4) of panda_hand in the frame of the mesh that was tracked."""

_FOUNDATION_POSE = "ob_in_cam"
_FAR_M = 10.0
_WIDEST_M, _PLAY_M = 0.08, 0.01  # gap between the pads, and what others overshoot


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseOverrides:
    """What another tracker says of a video."""

    X_CH: Array
    """(T, 4, 4) panda_hand in the camera frame [m]; NaN where there is none."""
    finger_width_m: Array | None = None
    """(T,) gap between the finger pads [m]; NaN where unknown."""


def pose_files(folder: Path, entry: Path) -> list[Path]:
    """The files that `read_poses` reads."""
    mesh = folder / MESH_NAME
    own = [file for _, file in _numbered(entry)] if entry.is_dir() else [entry]
    return [*own, *([mesh] if mesh.is_file() else [])]


def read_poses(folder: Path, entry: Path, frames: int) -> PoseOverrides:
    """Poses of panda_hand in the camera frame (OpenCV axes, metres).

    Args:
        folder: what the user named; where it holds `mesh_from_hand.txt`, the poses are those of that mesh.
        entry: npz with `camera_from_hand` (T, 4, 4) and optional `finger_width_m` (T,) and `tracked` (T,), such as a
            track file; npy (T, 4, 4); or a folder of 4x4 text matrices, its own or its `ob_in_cam/`, one a frame.
        frames: frames T of the video.

    Raises:
        InputError: it cannot be read, or the poses are none.
    """
    width: Array | None = None
    if entry.is_dir():
        X_CM = _read_texts(entry, frames)
    elif entry.suffix == ".npy":
        X_CM = _numbers(read_npy(entry), entry)
    else:
        with open_archive(entry) as archive:
            X_CM = _numbers(pick(archive, ("camera_from_hand",), entry)[1], entry)
            if "finger_width_m" in archive.files:
                width = _checked_width(_numbers(archive["finger_width_m"], entry), entry)
            if "tracked" in archive.files and archive["tracked"].shape == X_CM.shape[:1]:
                X_CM[~archive["tracked"].astype(bool)] = np.nan
    if X_CM.ndim != 3 or X_CM.shape[1:] != (4, 4):
        raise InputError(f"{entry.name}: the poses have shape {X_CM.shape}, expected (T, 4, 4)")
    X_CH = _checked(X_CM, entry)
    mesh = folder / MESH_NAME
    if mesh.is_file():
        X_CH = X_CH @ _rigid(_read_text(mesh), mesh.name)
    return PoseOverrides(X_CH=X_CH, finger_width_m=width)


def _checked(X: Array, entry: Path) -> Array:
    """The poses that are finite, made exactly rigid, NaN elsewhere."""
    rigid = np.full_like(X, np.nan)
    for number in np.flatnonzero(np.isfinite(X).all(axis=(1, 2))):
        rigid[number] = _rigid(X[number], f"{entry.name}: the pose of frame {number}")
    p = rigid[np.isfinite(rigid).all(axis=(1, 2)), :3, 3]
    if len(p) and np.median(np.linalg.norm(p, axis=1)) > _FAR_M:
        raise InputError(f"{entry.name}: positions lie more than {_FAR_M:g} m away; expected metres (millimetres?)")
    if len(p) and (p[:, 2] < 0).all():
        raise InputError(f"{entry.name}: all poses lie behind the camera; expected OpenCV axes, z forward")
    return rigid


def _checked_width(width_m: Array, entry: Path) -> Array:
    known = width_m[np.isfinite(width_m)]
    if len(known) and not -_PLAY_M <= known.min() <= known.max() <= _WIDEST_M + _PLAY_M:
        raise InputError(
            f"{entry.name}: finger_width_m goes from {known.min():.4g} to {known.max():.4g}, expected metres from 0 to "
            f"{_WIDEST_M:g} between the pads"
        )
    return np.clip(np.where(np.isfinite(width_m), width_m, np.nan), 0.0, _WIDEST_M)


def _rigid(X: Array, name: str) -> Array:
    try:
        return checked_pose(X)
    except InputError as error:
        raise InputError(f"{name} {error}") from None


def _numbers(array: NDArray[np.generic], entry: Path) -> Array:
    if array.dtype.kind not in "iuf":
        raise InputError(f"{entry.name}: holds {array.dtype}, expected numbers")
    return array.astype(np.float64)


def _numbered(folder: Path) -> list[tuple[int, Path]]:
    """Text files and the last number in their names, in the order of the numbers."""
    inner = folder / _FOUNDATION_POSE
    found = []
    for file in (inner if inner.is_dir() else folder).glob("*.txt"):
        digits = re.findall(r"\d+", file.stem)
        if digits:
            found.append((int(digits[-1]), file))
    return sorted(found)


def _read_texts(folder: Path, frames: int) -> Array:
    """One matrix a frame; NaN where there is no file.

    Frames count from 0; from 1 where that is the only way to fit them in. As many consecutive numbers as frames are
    taken in order, wherever they begin.
    """
    files = _numbered(folder)
    if not files:
        raise InputError(f"{folder.name}/: holds no text files with numbered names, expected one for every frame")
    numbers = [number for number, _ in files]
    first, last = numbers[0], numbers[-1]
    if len(set(numbers)) < len(numbers):
        raise InputError(f"{folder.name}/: two text files bear the same number, expected one for every frame")
    start = first if len(files) == frames == last - first + 1 else int(first > 0 and last == frames)
    if last - start >= frames:
        raise InputError(
            f"{folder.name}/: text files are numbered {first} to {last}, expected 0 to {frames - 1} or 1 to {frames} "
            f"for the {frames} frames of the video"
        )
    X = np.full((frames, 4, 4), np.nan)
    for number, file in files:
        X[number - start] = _read_text(file)
    return X


def _read_text(file: Path) -> Array:
    try:
        text = read_text(file)
        X = np.loadtxt(io.StringIO(text), dtype=np.float64, delimiter="," if "," in text else None)
    except (OSError, ValueError) as error:
        raise InputError(f"{file.parent.name}/{file.name}: not a readable matrix ({cause(error)})") from None
    if X.shape != (4, 4):
        raise InputError(f"{file.parent.name}/{file.name}: a matrix of shape {X.shape}, expected 4x4")
    return X
