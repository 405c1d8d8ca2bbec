"""Validation of video files from outside: format by the first bytes, a test decode, atomic placement."""

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import av
import numpy as np
from av.container import InputContainer
from numpy.typing import NDArray

from kinebench_drake.errors import cause
from kinebench_drake.io.atomic import disk_errors, unfinished
from kinebench_drake.io.container import write_video
from kinebench_drake.suites.worldmodels.worldmodel import WorldModelError

_HEAD = 64
_DEMUXERS = {".mp4": "mov", ".mov": "mov", ".avi": "avi", ".gif": "gif", ".webm": "matroska", ".mkv": "matroska"}


def suffix_of(head: bytes) -> str | None:
    """Return the suffix of the video format that begins with `head`; None if there is none."""
    if head[4:8] == b"ftyp":
        return ".mov" if head[8:12] == b"qt  " else ".mp4"
    if head[:4] == b"RIFF" and head[8:12] == b"AVI ":
        return ".avi"
    if head[:6] in (b"GIF87a", b"GIF89a"):
        return ".gif"
    if head[:4] == b"\x1a\x45\xdf\xa3":
        return ".webm" if b"webm" in head else ".mkv"
    return None


def check_video(path: Path) -> str:
    """Check that a file is a video whose first frame can be decoded, and return the suffix of its format.

    Raises:
        WorldModelError: it is not.
    """
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except OSError as error:
        raise WorldModelError(f"the video cannot be read ({cause(error)})") from None
    suffix = suffix_of(head)
    if suffix is None:
        raise WorldModelError(f"the file is not a video ({_describe(head)}); expected mp4, mov, avi, gif, webm or mkv")
    try:
        # The format is fixed: otherwise a playlist of other addresses would pass as a video.
        with av.open(path, format=_DEMUXERS[suffix], metadata_errors="replace") as container:
            if not isinstance(container, InputContainer) or not container.streams.video:
                raise WorldModelError("the file is a media file without a video stream")
            if next(container.decode(video=0), None) is None:
                raise WorldModelError("the file is a video without frames")
    except (av.FFmpegError, EOFError, ValueError, OverflowError, MemoryError) as error:
        raise WorldModelError(f"the video is damaged ({type(error).__name__})") from None
    return suffix


@contextmanager
def arriving(out: Path) -> Iterator[Path]:
    """Provide a hidden path beside `out` for an incomplete file, deleted when the context ends."""
    part = unfinished(out)
    try:
        yield part
    finally:
        with suppress(OSError):  # does not hide the error that ended the context
            part.unlink()


def adopt(part: Path, out: Path) -> Path:
    """Check a video and move it to its final path, which is returned.

    Args:
        part: the file, on the same disk as `out`.
        out: final path without a suffix; that of the file's format is appended.

    Raises:
        WorldModelError: it is not a video.
        SetupError: the disk failed.
    """
    suffix = check_video(part)
    path = out.with_name(out.name + suffix)
    with disk_errors(path.name):
        with part.open("rb") as file:
            os.fsync(file.fileno())
        os.replace(part, path)
    return path


def encode_answer(frames: Iterable[NDArray[np.uint8]], fps: float, out: Path) -> Path:
    """Write frames (H, W, 3) RGB as an mp4 beside `out` and return its path.

    Raises:
        SetupError: the disk failed.
    """
    path = out.with_name(f"{out.name}.mp4")
    write_video(path, frames, fps)
    return path


def _describe(head: bytes) -> str:
    if not head:
        return "it is empty"
    text = head.lstrip()
    if text[:1] in (b"{", b"["):
        return "it looks like JSON"
    return "it looks like a web page" if text[:1] == b"<" else "its first bytes are those of no known video format"
