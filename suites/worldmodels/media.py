"""Images and videos exchanged with world models: encoded frames, checks of video files, placement beside others."""

import base64
import binascii
import io
import os
import re
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import av
import numpy as np
from av.container import InputContainer
from numpy.typing import NDArray
from PIL import Image

from kinebench_drake.errors import cause
from kinebench_drake.io.atomic import disk_errors, remove, unfinished
from kinebench_drake.io.container import write_video
from kinebench_drake.io.files import VIDEO_SUFFIXES
from kinebench_drake.suites.worldmodels.worldmodel import WorldModelError

_HEAD = 64
_MATROSKA = rb"\x1a\x45\xdf\xa3"
DEMUXERS = {
    ".mov": ("mov", rb".{4}ftypqt  "),
    ".mp4": ("mov", rb".{4}ftyp"),
    ".avi": ("avi", rb"RIFF.{4}AVI "),
    ".gif": ("gif", rb"GIF8[79]a"),
    ".webm": ("matroska", _MATROSKA + rb".*webm"),
    ".mkv": ("matroska", _MATROSKA),
}
"""Demuxer and first bytes of each video format, by its suffix; the first match counts."""


def png(frame: NDArray[np.uint8]) -> bytes:
    """Encode a frame (H, W, 3) RGB as PNG."""
    buffer = io.BytesIO()
    Image.fromarray(frame).save(buffer, format="png")
    return buffer.getvalue()


def base64_png(frame: NDArray[np.uint8]) -> str:
    """Encode a frame (H, W, 3) RGB as PNG in base64."""
    return base64.b64encode(png(frame)).decode()


def data_uri(frame: NDArray[np.uint8]) -> str:
    """Encode a frame (H, W, 3) RGB as a data URI of type image/png."""
    return f"data:image/png;base64,{base64_png(frame)}"


def from_base64(text: str | memoryview) -> bytes:
    """Decode a file in base64, with or without the head of a data URI, line breaks and escaped slashes."""
    data = text.encode() if isinstance(text, str) else bytes(text)
    payload = data[data.find(b",", 0, _HEAD) + 1 :] if data.startswith(b"data:") else data
    if b"\\" in payload:
        payload = re.sub(rb"\\[nrt]", b"", payload).replace(b"\\/", b"/")
    return binascii.a2b_base64(payload.translate(None, b" \n\r\t"), strict_mode=True)


def suffix_of(head: bytes) -> str | None:
    """Return the suffix of the video format that begins with `head`; None if there is none."""
    return next((suffix for suffix, (_, start) in DEMUXERS.items() if re.match(start, head, re.DOTALL)), None)


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
        raise WorldModelError("the file is not a video; expected mp4, mov, avi, gif, webm or mkv")
    try:
        # The format is fixed: otherwise a playlist of other addresses would pass as a video.
        with av.open(path, format=DEMUXERS[suffix][0], metadata_errors="replace") as container:
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
    """Check a video and move it to `out` with the suffix of its format, on the same disk; return this path."""
    path = out.with_name(out.name + check_video(part))
    with disk_errors(path.name):
        with part.open("rb") as file:
            os.fsync(file.fileno())
        os.replace(part, path)
    return path


def encode_answer(frames: Iterable[NDArray[np.uint8]], fps: float, out: Path) -> Path:
    """Write frames (H, W, 3) RGB as an mp4 beside `out` and return its path."""
    path = out.with_name(f"{out.name}.mp4")
    write_video(path, frames, fps)
    return path


def place_beside(video: Path, out: Path) -> Path:
    """Return the path of a video, or folder of frames, beside `out`; copy it from another folder, replacing others."""
    here = out.parent.resolve()
    source = video.resolve()
    if video.parent.resolve() == here:
        return video
    copy = out.with_name(f"{out.name}{video.suffix}" if video.is_file() else out.name)
    with disk_errors(copy.name):
        for earlier in (here / f"{out.name}{suffix}" for suffix in ("", *VIDEO_SUFFIXES)):
            if not source.is_relative_to(earlier):  # a model may work in a folder of the clip's name
                remove(earlier)
        if video.is_file():
            shutil.copyfile(video, copy)
        else:
            shutil.copytree(video, copy, dirs_exist_ok=True)
    return copy
