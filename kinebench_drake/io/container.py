"""Video containers through PyAV: decoding of every FFmpeg codec, and mp4 files with reproducible bytes."""

import os
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from itertools import islice
from pathlib import Path
from typing import cast

import av
import numpy as np
from av.container import InputContainer, OutputContainer
from av.sidedata.sidedata import SideData
from av.video.frame import VideoFrame
from av.video.stream import VideoStream
from numpy.typing import NDArray
from PIL import Image, ImageSequence

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array
from kinebench_drake.io.atomic import atomic_path
from kinebench_drake.io.frames import MAX_PIXELS, collect_frames, require_size
from kinebench_drake.io.video import MIN_FRAMES, Video, VideoPart

_OPTIONS = {"format_whitelist": "mov,matroska,avi,gif", "protocol_whitelist": "file"}
"""FFmpeg must read no playlist: playlists name other files and addresses."""
_DECODER = {"max_pixels": str(MAX_PIXELS)}
_PARAMETERS = "no-mbtree=1"
"""Of x264: its tree of macroblocks reads memory that nobody has written, so that small films differ each time."""
LEAD_S = 1.0
"""Time by which decoding starts earlier: seeking uses the decoding order, not the display order [s]."""
_SQUARE = 0.01
_STRETCHED = 4.0
"""Deviation from 1 below which pixels count as square, and greatest ratio of their sides, either way."""


def read_container(path: Path, part: VideoPart) -> Video:
    """Decode a video file, or its frames between two time stamps.

    Raises:
        InputError: it is damaged, cut off, or holds no such frames.
    """
    stamps: list[float | None] = []
    try:
        with _open(path) as container:
            stream = _choose_stream(path, container)
            require_size(path.name, (1, stream.height, stream.width))
            stream.thread_count = 1
            stream.codec_context.options = _DECODER
            rate = stream.average_rate or stream.guessed_rate
            frames = collect_frames(path.name, _decode(path.name, container, stream, part, rate, stamps))
            missing = _missing_s(container, stream, stamps, rate) if part.to_s is None else None
            is_gif = container.format.name == "gif"
        if is_gif and not _gif_ends(path):
            raise InputError(f"{path.name}: cut off after {len(frames)} frames (the gif lacks its trailer)")
        is_timeless = is_gif and _is_timeless(path, len(frames) - 1)
    except (av.FFmpegError, OSError, ValueError, OverflowError, MemoryError) as error:
        progress = f" after {len(stamps)} frames" if stamps else ""
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{path.name}: not a readable video{progress} ({reason})") from None
    if missing is not None:
        raise InputError(f"{path.name}: cut off, the last {missing:.2f} s are missing after {len(frames)} frames")
    kept = len(frames) if part.frames is None else part.frames
    if kept > len(frames):
        raise InputError(f"{path.name}: has {len(frames)} frames{_span(part)}, its metadata says {kept}")
    fps = float(rate) if rate and not is_timeless else None
    stamps_s = _irregular_stamps(stamps[:kept], fps)
    return Video(frames=frames[:kept], fps=fps, stamps_s=stamps_s, surplus=len(frames) - kept)


def _open(path: Path) -> InputContainer:
    return av.open(path, options=_DECODER, container_options=_OPTIONS, metadata_errors="replace")


def _choose_stream(path: Path, container: InputContainer) -> VideoStream:
    """Return the first video stream of a known codec, of several the first one that is no picture, such as a cover."""
    streams = [stream for stream in container.streams.video if stream.codec_context is not None]
    if not streams:
        raise InputError(f"{path.name}: holds no video stream of a known codec")
    if len(streams) == 1:
        return streams[0]
    with _open(path) as other:
        packets = Counter(packet.stream_index for packet in other.demux(*other.streams.video) if packet.size)
    return next((stream for stream in streams if packets[stream.index] >= MIN_FRAMES), streams[0])


def _decode(
    name: str,
    container: InputContainer,
    stream: VideoStream,
    part: VideoPart,
    rate: Fraction | None,
    stamps: list[float | None],
) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    """Yield the name and the image of each frame of a part, and append its time stamp to `stamps`."""
    half_s = 0.5 / float(rate) if rate else 0.0
    aspect = _pixel_aspect(name, stream)
    if part.from_s and stream.time_base:
        container.seek(int(max(0.0, part.from_s - LEAD_S) / stream.time_base), stream=stream)
    for frame in container.decode(stream):
        if part.to_s is not None and frame.time is not None and frame.time >= part.to_s - half_s:
            break
        if part.from_s is not None and (frame.time is None or frame.time < part.from_s - half_s):
            continue
        label = f"{name}: frame {len(stamps)}"
        if frame.is_corrupt:
            raise InputError(f"{label} is damaged")
        image = _displayed(frame, aspect)
        stamps.append(frame.time)
        yield label, image
    if not stamps:
        raise InputError(f"{name}: holds no decodable frame{_span(part)}")


def _span(part: VideoPart) -> str:
    return f" from {part.from_s or 0.0:g} s to {part.to_s:g} s" if part.to_s is not None else ""


def _displayed(frame: VideoFrame, pixel_aspect: Fraction) -> NDArray[np.uint8]:
    """Return the image as players show it: with square pixels, turned or mirrored as its display matrix says."""
    image = frame.to_ndarray(format="rgb24", width=round(frame.width * pixel_aspect), height=frame.height)
    matrix = frame.side_data.get("DISPLAYMATRIX")
    if matrix is not None:
        # Pixel (x, y) is shown at (a x + c y, b x + d y) from the corner of the image: libavutil/display.h.
        (a, b), (c, d) = np.sign(np.frombuffer(bytes(cast(SideData, matrix)), np.int32).reshape(3, 3)[:2, :2])
        if b and c:
            image = image.transpose(1, 0, 2)
            a = c
            d = b
        image = image[:: d or 1, :: a or 1]
    return np.ascontiguousarray(image).astype(np.uint8, copy=False)


def _pixel_aspect(name: str, stream: VideoStream) -> Fraction:
    """Return width over height of the stream's pixels; 1 where it is unknown or next to it."""
    aspect = stream.sample_aspect_ratio
    if not aspect or abs(aspect - 1) < _SQUARE:
        return Fraction(1)
    if not 1 / _STRETCHED <= aspect <= _STRETCHED:
        raise InputError(
            f"{name}: its pixels are {float(aspect):.3g} times as wide as high, expected {1 / _STRETCHED:g} to "
            f"{_STRETCHED:g}"
        )
    return aspect


def _missing_s(
    container: InputContainer, stream: VideoStream, stamps: list[float | None], rate: Fraction | None
) -> float | None:
    """Return the seconds that the header announces but the data lack; None if the video is complete."""
    if not rate or not stamps or stamps[-1] is None:
        return None
    # Trimmed videos (edit lists) have fewer frames than counted, but the announced duration. Without a count, the
    # duration of the file decides, unless there is sound, which may be longer.
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
    """Return whether a gif, whose header names no length, ends with its trailer byte (section 27 of the format)."""
    with path.open("rb") as file:
        file.seek(-min(64, path.stat().st_size), os.SEEK_END)
        return file.read().rstrip(b"\0").endswith(b";")


def _is_timeless(path: Path, steps: int) -> bool:
    """Return whether one of the first `steps` frames of a gif has no delay, which FFmpeg would replace by 0.1 s."""
    with Image.open(path, formats=["GIF"]) as gif:
        return any(frame.info.get("duration", 0) == 0 for frame in islice(ImageSequence.Iterator(gif), steps))


def _irregular_stamps(stamps: list[float | None], fps: float | None) -> Array | None:
    """Return time stamps from 0 if they increase and differ from k / fps by more than half a frame, else None."""
    if fps is None or any(s is None for s in stamps):
        return None
    times = np.array(stamps, dtype=np.float64)
    times -= times[0]
    regular = np.abs(times - np.arange(len(times)) / fps).max() <= 0.5 / fps
    return None if regular or not (np.diff(times) > 0).all() else times


@contextmanager
def _create_mp4(path: Path) -> Iterator[OutputContainer]:
    """Open an mp4 file that appears at `path` when the context ends without an error."""
    options = {"fflags": "+bitexact"}
    with atomic_path(path) as part, av.open(part, "w", format="mp4", container_options=options) as container:
        yield container


def join_videos(path: Path, parts: Iterable[Path]) -> None:
    """Concatenate videos of one size, rate and encoding without encoding them again."""
    with _create_mp4(path) as container:
        joined: VideoStream | None = None
        shift = 0
        for part in parts:
            with av.open(part) as source:
                stream = source.streams.video[0]
                if joined is None:
                    joined = container.add_stream_from_template(stream)
                end = 0
                for packet in source.demux(stream):
                    if packet.pts is None or packet.dts is None:  # end marker
                        continue
                    end = max(end, packet.pts + (packet.duration or 0))
                    packet.pts = packet.pts + shift
                    packet.dts = packet.dts + shift
                    packet.stream = joined
                    container.mux(packet)
                shift += end


def write_video(
    path: Path,
    frames: Iterable[NDArray[np.uint8]],
    fps: float,
    *,
    crf: int = 16,
    preset: str = "medium",
    keyframe_every: int | None = None,
) -> None:
    """Write frames (H, W, 3) RGB as H.264 in mp4: same frames, same bytes. The file appears only when complete.

    Of odd sizes the last row or column is repeated, as yuv420p needs even ones.

    Args:
        crf: quality of x264, 0 (lossless) to 51; 18 is visually close to lossless.
        preset: effort of x264; "veryfast" takes 0.4 times the time of "medium", for videos that are only looked at.
        keyframe_every: greatest distance between keyframes [frames]; None leaves it to x264.

    Raises:
        InputError: a frame has another shape or type.
    """
    with _create_mp4(path) as container:
        stream: VideoStream | None = None
        for image in frames:
            if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
                raise InputError(
                    f"{path.name}: a frame has shape {image.shape} and type {image.dtype}, expected (H, W, 3) and uint8"
                )
            if stream is None:
                rate = Fraction(fps).limit_denominator(10_000)
                options = {"crf": str(crf), "preset": preset, "x264-params": _PARAMETERS}
                if keyframe_every is not None:
                    options["g"] = str(keyframe_every)
                stream = container.add_stream("libx264", rate=rate, options=options)
                stream.height, stream.width = (side + side % 2 for side in image.shape[:2])
                stream.pix_fmt = "yuv420p"
                stream.thread_count = 1
            pad = ((0, stream.height - image.shape[0]), (0, stream.width - image.shape[1]), (0, 0))
            even = np.ascontiguousarray(np.pad(image, pad, mode="edge"))
            container.mux(stream.encode(VideoFrame.from_ndarray(even, format="rgb24")))
        if stream is not None:
            container.mux(stream.encode())
