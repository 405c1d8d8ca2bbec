"""Results of other programs in files: arrays of a whole video (npy, npz, folders of png), masks, gripper poses."""

import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError, cause
from kinebench_drake.geometry import Array, checked_pose
from kinebench_drake.grounding.priors import Priors
from kinebench_drake.io.files import read_text
from kinebench_drake.io.images import frame_files, open_image
from kinebench_drake.io.npz import Archive, open_npz, read_npy
from kinebench_drake.track import MAX_WIDTH_M

MESH_NAME = "mesh_from_hand.txt"
"""File with the pose (4, 4) of panda_hand in the frame of the tracked mesh."""
_FOUNDATION_POSE = "ob_in_cam"
_FAR_M = 10.0
_TOLERANCE_M = 0.01
"""Tolerance of the gripper width [m]."""
_HALF_MM = 0.5
"""Mean truncation of stored depth [mm]."""
_MAX_SHARE = 0.9
"""Greatest share of the pixels in a mask: a gripper that fills the image cannot be tracked anyway."""


@contextmanager
def errors_naming(source: Path | str) -> Iterator[None]:
    """Prefix the messages of input errors with a source: an argument, or the name of a file or folder."""
    if isinstance(source, Path):
        source = f"{source.name}/" if source.is_dir() else source.name
    try:
        yield
    except InputError as error:
        raise error if str(error).startswith(source) else InputError(f"{source}: {error}") from None


def pick(archive: Archive, names: Sequence[str]) -> tuple[str, NDArray[np.generic]]:
    """Return name and value of the first of the named arrays that exists.

    Raises:
        InputError: none of them exists.
    """
    for name in names:
        if name in archive.files:
            return name, archive[name]
    content = ", ".join(archive.files[:12]) or "nothing"
    raise InputError(
        f"holds {content}; expected {' or '.join(names)} (the truth of demonstrations has depth and masks if they were "
        "made with --with-depth)"
    )


def array_files(entry: Path) -> list[Path]:
    """Return the files of a video's masks or depth; those of a folder in natural order: 2.png before 10.png."""
    return [file for file in frame_files(entry) if file.suffix.lower() == ".png"] if entry.is_dir() else [entry]


def read_pngs(folder: Path) -> NDArray[np.generic]:
    """Read the images of a folder in natural order: (T, H, W) if grey, (T, H, W, channels) if in colour.

    Raises:
        InputError: there is none, one is damaged, or they differ in size or type.
    """
    files = array_files(folder)
    if not files:
        raise InputError("holds no png files, expected one for every frame")
    images: list[NDArray[np.generic]] = []
    for file in files:
        with open_image(file) as opened:
            image = np.asarray(opened)
        if images and (image.shape, image.dtype) != (images[0].shape, images[0].dtype):
            raise InputError(
                f"{folder.name}/{file.name}: {image.dtype} of shape {image.shape}, the first image is "
                f"{images[0].dtype} of shape {images[0].shape}"
            )
        images.append(image)
    return np.stack(images)


def is_demo_truth(archive: Archive) -> bool:
    """Return whether an archive is the ground truth of a demonstration with depth and mask."""
    return {"camera_from_hand", "depth_mm", "mask"} <= set(archive.files)


def true_depth(archive: Archive) -> Array:
    """Return the depth (T, H, W) of a demonstration along the camera's axis [m]; 0 where there is no surface."""
    depth_mm = archive["depth_mm"]
    if depth_mm.dtype.kind not in "iuf":
        raise InputError(f"the depth is {depth_mm.dtype}, expected numbers")
    return np.asarray(np.where(depth_mm > 0, depth_mm + _HALF_MM, 0.0) / 1000.0)


def true_mask(archive: Archive) -> NDArray[np.bool_]:
    """Return the gripper mask (T, H, W) of a demonstration; it is packed along the width, whose size is the depth's."""
    shape = archive.shape("depth_mm")
    packed = archive["mask"]
    if packed.dtype != np.uint8 or len(shape) != 3 or packed.shape != (*shape[:2], -(-shape[2] // 8)):
        raise InputError(f"the mask is {packed.dtype} of shape {packed.shape}, which does not fit the depth's {shape}")
    return np.unpackbits(packed, axis=-1, count=shape[2]).astype(bool)


def read_masks(entry: Path) -> NDArray[np.bool_]:
    """Read the gripper mask (T, H, W) of hand and fingers: pixels that are not 0.

    Args:
        entry: npz with `mask` or `masks`, npy, folder of one png per frame (in colour images any channel but alpha
            counts), or the ground truth of a demonstration.

    Raises:
        InputError: it cannot be read, or its values are no masks of a gripper.
    """
    with errors_naming(entry):
        if entry.is_dir():
            masks = read_pngs(entry).astype(bool)
            if masks.ndim == 4:
                colours = masks.shape[3] - (masks.shape[3] in (2, 4))
                masks = np.asarray(masks[..., :colours].any(axis=3))
        elif entry.suffix == ".npy":
            masks = _as_mask(read_npy(entry))
        else:
            with open_npz(entry) as archive:
                truth = is_demo_truth(archive)
                masks = true_mask(archive) if truth else _as_mask(pick(archive, ("mask", "masks"))[1])
        if masks.size and masks.mean() > _MAX_SHARE:
            raise InputError(
                f"the masks cover {masks.mean():.0%} of the images; expected 0 where the gripper is not (images of the "
                "video itself, or inverted masks?)"
            )
        return masks


def _as_mask(array: NDArray[np.generic]) -> NDArray[np.bool_]:
    if array.dtype.kind not in "biuf" or (array.dtype.kind == "f" and not np.isin(array, (0, 1)).all()):
        raise InputError(
            f"the masks are {array.dtype} with values besides 0 and 1; expected truth values or whole numbers, 0 where "
            "the gripper is not"
        )
    return array.astype(bool)


def pose_files(folder: Path, entry: Path) -> list[Path]:
    """Return the files that `read_poses` reads."""
    mesh = folder / MESH_NAME
    own = [file for _, file in _numbered(entry)] if entry.is_dir() else [entry]
    return [*own, *([mesh] if mesh.is_file() else [])]


def read_poses(folder: Path, entry: Path, frames: int) -> Priors:
    """Read poses of panda_hand in the camera frame (OpenCV axes, metres) and gripper widths, as priors.

    Args:
        folder: folder of all videos' poses; if it has a `mesh_from_hand.txt`, the poses are those of that mesh.
        entry: npz with `camera_from_hand` (T, 4, 4) and optional `finger_width_m` (T,) and `tracked` (T,), such as a
            track file; npy (T, 4, 4); or a folder with one 4x4 text matrix per frame, in itself or its `ob_in_cam/`.
        frames: number T of frames of the video.

    Raises:
        InputError: it cannot be read, or its values are no poses.
    """
    width: Array | None = None
    with errors_naming(entry):
        if entry.is_dir():
            X_CM = _read_texts(entry, frames)
        elif entry.suffix == ".npy":
            X_CM = _numbers(read_npy(entry))
        else:
            with open_npz(entry) as archive:
                X_CM = _numbers(pick(archive, ("camera_from_hand",))[1])
                if "finger_width_m" in archive.files:
                    width = _checked_width(_numbers(archive["finger_width_m"]))
                if "tracked" in archive.files:
                    X_CM[~_checked_tracked(archive["tracked"], len(X_CM))] = np.nan
        if X_CM.ndim != 3 or X_CM.shape[1:] != (4, 4):
            raise InputError(f"the poses have shape {X_CM.shape}, expected (T, 4, 4)")
        X_CH = _checked(X_CM)
    mesh = folder / MESH_NAME
    if mesh.is_file():
        X_CH = X_CH @ _rigid(_read_text(mesh), mesh.name)
    return Priors(X_CH=X_CH, finger_width_m=width)


def _checked_tracked(tracked: NDArray[Any], frames: int) -> NDArray[np.bool_]:
    if tracked.dtype.kind not in "biu" or tracked.shape != (frames,):
        raise InputError(f"tracked has shape {tracked.shape} of {tracked.dtype}, expected ({frames},) of bool")
    return tracked.astype(bool)


def _checked(X: Array) -> Array:
    """Return the finite poses, made exactly rigid, and NaN elsewhere."""
    rigid = np.full_like(X, np.nan)
    for number in np.flatnonzero(np.isfinite(X).all(axis=(1, 2))):
        rigid[number] = _rigid(X[number], f"the pose of frame {number}")
    p = rigid[np.isfinite(rigid).all(axis=(1, 2)), :3, 3]
    if len(p) and np.median(np.linalg.norm(p, axis=1)) > _FAR_M:
        raise InputError(f"positions lie more than {_FAR_M:g} m away; expected metres (millimetres?)")
    if len(p) and (p[:, 2] < 0).all():
        raise InputError("all poses lie behind the camera; expected OpenCV axes, z forward")
    return rigid


def _checked_width(width_m: Array) -> Array:
    finite = width_m[np.isfinite(width_m)]
    if len(finite) and not -_TOLERANCE_M <= finite.min() <= finite.max() <= MAX_WIDTH_M + _TOLERANCE_M:
        raise InputError(
            f"finger_width_m goes from {finite.min():.4g} to {finite.max():.4g}, expected metres from 0 to "
            f"{MAX_WIDTH_M:g} between the pads"
        )
    return np.clip(np.where(np.isfinite(width_m), width_m, np.nan), 0.0, MAX_WIDTH_M)


def _rigid(X: Array, name: str) -> Array:
    try:
        return checked_pose(X)
    except InputError as error:
        raise InputError(f"{name} {error}") from None


def _numbers(array: NDArray[np.generic]) -> Array:
    if array.dtype.kind not in "iuf":
        raise InputError(f"holds {array.dtype}, expected numbers")
    return array.astype(np.float64)


def _numbered(folder: Path) -> list[tuple[int, Path]]:
    """Return the text files with the last number in their names, sorted by it."""
    inner = folder / _FOUNDATION_POSE
    files = (inner if inner.is_dir() else folder).glob("*.txt")
    return sorted((int(digits[-1]), file) for file in files if (digits := re.findall(r"\d+", file.stem)))


def _read_texts(folder: Path, frames: int) -> Array:
    """Read one matrix per frame; NaN where there is no file.

    Numbers start at 0, or at 1 if the last one is the number of frames; a complete run of consecutive numbers may
    start anywhere.
    """
    files = _numbered(folder)
    if not files:
        raise InputError("holds no text files with numbered names, expected one for every frame")
    numbers = [number for number, _ in files]
    first = numbers[0]
    last = numbers[-1]
    if len(set(numbers)) < len(numbers):
        raise InputError("two text files bear the same number, expected one for every frame")
    start = first if len(files) == frames == last - first + 1 else int(first > 0 and last == frames)
    if last - start >= frames:
        raise InputError(
            f"text files are numbered {first} to {last}, expected 0 to {frames - 1} or 1 to {frames} "
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
