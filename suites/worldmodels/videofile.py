"""A video that came from elsewhere: told by its first bytes, opened, and put in its place whole."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import av
from av.container import InputContainer

from kinebench_drake.errors import cause
from kinebench_drake.io.atomic import disk_errors, unfinished
from kinebench_drake.suites.worldmodels.worldmodel import WorldModelError

_HEAD = 64
_DEMUXERS = {
    ".mp4": "mov",
    ".mov": "mov",
    ".avi": "avi",
    ".gif": "gif",
    ".webm": "matroska",
    ".mkv": "matroska",
}


def suffix_of(head: bytes) -> str | None:
    """The suffix of a video file that begins with `head`; None if it begins like none."""
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
    """Make sure that a file is a video whose first frame can be decoded.

    Returns:
        The suffix that befits it.

    Raises:
        WorldModelError: it is none.
    """
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except OSError as error:
        raise WorldModelError(f"the video cannot be read ({cause(error)})") from None
    suffix = suffix_of(head)
    if suffix is None:
        raise WorldModelError(
            f"what came is not a video ({_looks_like(head)}); expected mp4, mov, avi, gif, webm or mkv"
        )
    try:
        # The format is given: otherwise a list of other addresses to read would pass for a video, too.
        with av.open(path, format=_DEMUXERS[suffix], metadata_errors="replace") as container:
            if not isinstance(container, InputContainer) or not container.streams.video:
                raise WorldModelError("what came is a media file without pictures")
            if next(container.decode(video=0), None) is None:
                raise WorldModelError("what came is a video without frames")
    except (av.FFmpegError, EOFError, ValueError, OverflowError, MemoryError) as error:
        raise WorldModelError(f"the video is damaged ({type(error).__name__})") from None
    return suffix


@contextmanager
def arriving(out: Path) -> Iterator[Path]:
    """A hidden path beside `out` for what is not yet known to be whole; gone when the context ends."""
    part = unfinished(out)
    try:
        yield part
    finally:
        with suppress(OSError):  # the error on its way tells
            part.unlink()


def adopt(part: Path, out: Path) -> Path:
    """Put a video in its place.

    Args:
        part: the file, on the same disk as `out`.
        out: its place, without a suffix.

    Returns:
        The path with the suffix that befits the file.

    Raises:
        WorldModelError: it is no video.
        SetupError: the disk failed.
    """
    suffix = check_video(part)
    path = out.with_name(out.name + suffix)
    with disk_errors(path.name):
        with part.open("rb") as file:
            os.fsync(file.fileno())
        os.replace(part, path)
    return path


def _looks_like(head: bytes) -> str:
    if not head:
        return "it is empty"
    text = head.lstrip()
    if text[:1] in (b"{", b"["):
        return "it looks like JSON"
    return "it looks like a web page" if text[:1] == b"<" else "its first bytes are those of no known video format"
