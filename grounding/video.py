"""Videos as arrays: films (PyAV), folders of frames (Pillow) and npy/npz files."""

import os
import re
import zipfile
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from av.video.frame import VideoFrame
from av.video.stream import VideoStream
from numpy.typing import NDArray
from PIL import Image

from kinebench_drake.errors import InputError, UnmeasurableError, cause
from kinebench_drake.geometry import Array

FILM_SUFFIXES = frozenset({".mp4", ".mov", ".avi", ".gif", ".webm", ".mkv"})
FRAME_SUFFIXES = frozenset({".png", ".jpg", ".jpeg"})
ARRAY_SUFFIXES = frozenset({".npy", ".npz"})

MIN_FRAMES = 2
"""A path needs two poses."""
MIN_SIDE_PX = 64
"""Below this the gripper covers a handful of pixels in any benchmark view."""
MAX_BYTES = 6 * 2**30
"""Decoded frames beyond this are refused rather than risking the machine's memory."""

_ARRAY_KEYS = ("frames", "video")


@dataclass(frozen=True, slots=True, kw_only=True)
class Video:
    """Decoded frames and what the file says about their time."""

    frames: NDArray[np.uint8]
    """(T, H, W, 3) RGB."""
    fps: float | None
    """Frames per second [1/s]; None where the source has no clock (frame folders, arrays)."""
    stamps_s: Array | None
    """(T,) time stamps of an irregular film, from 0, increasing [s]; None where `fps` says it all."""

    def __post_init__(self) -> None:
        """Check shape and type.

        Raises:
            InputError: the frames are not (T, H, W, 3) uint8, or there are none.
        """
        if self.frames.dtype != np.uint8 or self.frames.ndim != 4 or self.frames.shape[3] != 3:
            raise InputError(
                f"found {self.frames.dtype} of shape {self.frames.shape}, expected uint8 (T, H, W, 3) in RGB"
            )
        if not self.frames.size:
            raise InputError("holds no frame")

    @property
    def width(self) -> int:
        """Image width [px]."""
        return int(self.frames.shape[2])

    @property
    def height(self) -> int:
        """Image height [px]."""
        return int(self.frames.shape[1])

    def require_measurable(self) -> None:
        """Refuse what no track can be taken from.

        Raises:
            UnmeasurableError: there are too few frames or too few pixels.
        """
        if len(self.frames) < MIN_FRAMES:
            raise UnmeasurableError(f"has {len(self.frames)} frame, a track needs at least {MIN_FRAMES}")
        if min(self.width, self.height) < MIN_SIDE_PX:
            raise UnmeasurableError(f"is {self.width} x {self.height} px, each side needs at least {MIN_SIDE_PX} px")


def read_video(path: Path) -> Video:
    """Decode a film, a folder of frames (png or jpg in natural order) or a npy/npz file.

    Raises:
        InputError: the file is absent, empty, damaged, cut off, or not what its name says.
    """
    if path.is_dir():
        return _read_folder(path)
    if not path.is_file():
        raise InputError(f"{path.name}: there is no such file")
    if path.stat().st_size == 0:
        raise InputError(f"{path.name}: the file is empty (0 bytes)")
    if path.suffix.lower() in ARRAY_SUFFIXES:
        return _read_array(path)
    return _read_film(path)


def frame_files(folder: Path) -> list[Path]:
    """The frames of a folder in natural order: frame_2.png before frame_10.png."""
    files = [p for p in folder.iterdir() if p.suffix.lower() in FRAME_SUFFIXES and not p.name.startswith(".")]
    return sorted(files, key=lambda p: ([int(s) if s.isdigit() else s for s in re.split(r"(\d+)", p.name)], p.name))


def _read_film(path: Path) -> Video:
    images: list[NDArray[np.uint8]] = []
    stamps: list[float | None] = []
    size = 0
    try:
        with av.open(path) as container:
            if not container.streams.video:
                raise InputError(f"{path.name}: holds no video stream")
            stream = container.streams.video[0]
            stream.thread_count = 1
            rate = stream.average_rate or stream.guessed_rate
            for frame in container.decode(stream):
                if frame.is_corrupt:
                    raise InputError(f"{path.name}: frame {len(images)} is damaged")
                image = _upright(frame)
                if images and image.shape != images[0].shape:
                    raise InputError(
                        f"{path.name}: frame {len(images)} has size {image.shape[1]} x {image.shape[0]}, the first "
                        f"{images[0].shape[1]} x {images[0].shape[0]}"
                    )
                size += image.nbytes
                _check_size(path, size)
                images.append(image)
                stamps.append(frame.time)
            missing = _missing_s(container, stream, stamps, rate)
    except (av.FFmpegError, OSError, ValueError) as error:
        told = f" after {len(images)} frames" if images else ""
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{path.name}: not a readable video{told} ({reason})") from None
    if not images:
        raise InputError(f"{path.name}: holds no decodable frame")
    if missing is not None:
        raise InputError(f"{path.name}: cut off, the last {missing:.2f} s are missing after {len(images)} frames")
    if path.suffix.lower() == ".gif" and not _gif_ends(path):
        raise InputError(f"{path.name}: cut off after {len(images)} frames (the gif lacks its trailer)")
    fps = float(rate) if rate else None
    return Video(frames=np.stack(images), fps=fps, stamps_s=_irregular(stamps, fps))


def _upright(frame: VideoFrame) -> NDArray[np.uint8]:
    """The image turned the way players show it (phones store a rotation beside the pixels)."""
    image = frame.to_ndarray(format="rgb24")
    return np.ascontiguousarray(np.rot90(image, k=round(frame.rotation / 90) % 4)).astype(np.uint8, copy=False)


def _missing_s(
    container: "av.container.InputContainer", stream: VideoStream, stamps: list[float | None], rate: Fraction | None
) -> float | None:
    """Seconds that the header announces but the data do not hold; None when the film is whole."""
    if not rate or not stamps or stamps[-1] is None:
        return None
    # Trimmed films (edit lists) hold fewer frames than counted, yet last as announced. Where nothing is counted, the
    # length of the whole file tells, unless there is sound, which may be longer.
    if len(stamps) >= stream.frames if stream.frames else len(container.streams) > 1:
        return None
    if stream.duration is not None and stream.time_base is not None:
        announced = float((stream.start_time or 0) + stream.duration) * float(stream.time_base)
    elif container.duration is not None:
        announced = ((container.start_time or 0) + container.duration) / av.time_base
    else:
        return None
    missing = announced - stamps[-1] - 1.0 / float(rate)
    return missing if missing > 1.5 / float(rate) else None


def _gif_ends(path: Path) -> bool:
    """Whether a gif ends with its trailer byte (the format's section 27), its header naming no length."""
    with path.open("rb") as file:
        file.seek(-min(64, path.stat().st_size), os.SEEK_END)
        return file.read().rstrip(b"\0").endswith(b";")


def _irregular(stamps: list[float | None], fps: float | None) -> Array | None:
    """Time stamps from 0 when they differ from k / fps by more than half a frame and increase; None otherwise."""
    if fps is None or any(s is None for s in stamps):
        return None
    times = np.array(stamps, dtype=np.float64)
    times -= times[0]
    regular = np.abs(times - np.arange(len(times)) / fps).max() <= 0.5 / fps
    return None if regular or not (np.diff(times) > 0).all() else times


def _read_folder(folder: Path) -> Video:
    files = frame_files(folder)
    if not files:
        raise InputError(f"{folder.name}: the folder holds no png or jpg frames")
    images: list[NDArray[np.uint8]] = []
    for file in files:
        try:
            with Image.open(file) as picture:
                image = np.asarray(picture.convert("RGB"), dtype=np.uint8)
        except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
            raise InputError(f"{folder.name}/{file.name}: not a readable image ({cause(error)})") from None
        if images and image.shape != images[0].shape:
            raise InputError(
                f"{folder.name}/{file.name}: size {image.shape[1]} x {image.shape[0]}, the first frame has "
                f"{images[0].shape[1]} x {images[0].shape[0]}"
            )
        _check_size(folder, image.nbytes * (len(images) + 1))
        images.append(image)
    return Video(frames=np.stack(images), fps=None, stamps_s=None)


def _read_array(path: Path) -> Video:
    try:
        if path.suffix.lower() == ".npy":
            loaded = np.load(path, mmap_mode="r", allow_pickle=False)
            _check_size(path, loaded.nbytes)
            frames = np.array(loaded)
        else:
            _check_size(path, _unpacked_size(path))
            with np.load(path, allow_pickle=False) as archive:
                names = [n for n in _ARRAY_KEYS if n in archive.files] or archive.files
                if len(archive.files) != 1 and names[0] not in _ARRAY_KEYS:
                    raise InputError(f"{path.name}: holds {archive.files}, expected one array or one named 'frames'")
                frames = archive[names[0]]
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, MemoryError) as error:
        raise InputError(f"{path.name}: not a readable array ({cause(error)})") from None
    try:
        return Video(frames=np.ascontiguousarray(frames), fps=None, stamps_s=None)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from None


def _unpacked_size(path: Path) -> int:
    with zipfile.ZipFile(path) as archive:
        return sum(entry.file_size for entry in archive.infolist())


def _check_size(path: Path, size: int) -> None:
    if size > MAX_BYTES:
        raise InputError(f"{path.name}: decoded it exceeds {MAX_BYTES / 2**30:.0f} GiB; cut it into shorter clips")
