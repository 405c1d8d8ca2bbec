"""Video containers through PyAV: decoding of every FFmpeg codec, and mp4 files with reproducible bytes."""

import os
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from av.container import InputContainer
from av.video.frame import VideoFrame
from av.video.stream import VideoStream
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array
from kinebench_drake.io.atomic import unfinished
from kinebench_drake.io.video import Video, VideoPart, check_size

_OPTIONS = {"format_whitelist": "mov,matroska,avi,gif", "protocol_whitelist": "file"}
"""FFmpeg reads no playlist for a film: lists name other files, and addresses."""
_BEFORE_S = 1.0  # how much earlier decoding begins: files are searched by the order of decoding, not of showing


def read_film(path: Path, part: VideoPart) -> Video:
    """Decode a film, or the frames of it from one time stamp to before another.

    Raises:
        InputError: it is damaged, cut off, or holds no such frames.
    """
    images: list[NDArray[np.uint8]] = []
    stamps: list[float | None] = []
    size = 0
    try:
        with av.open(path, container_options=_OPTIONS, metadata_errors="replace") as container:
            if not container.streams.video:
                raise InputError(f"{path.name}: holds no video stream")
            stream = container.streams.video[0]
            stream.thread_count = 1
            rate = stream.average_rate or stream.guessed_rate
            half_s = 0.5 / float(rate) if rate else 0.0
            if part.from_s and stream.time_base:
                begin_s = max(0.0, part.from_s - _BEFORE_S)
                container.seek(int(begin_s / stream.time_base), stream=stream)
            for frame in container.decode(stream):
                if part.to_s is not None and frame.time is not None and frame.time >= part.to_s - half_s:
                    break
                if part.from_s is not None and (frame.time is None or frame.time < part.from_s - half_s):
                    continue
                if frame.is_corrupt:
                    raise InputError(f"{path.name}: frame {len(images)} is damaged")
                image = _upright(frame)
                if images and image.shape != images[0].shape:
                    raise InputError(
                        f"{path.name}: frame {len(images)} has size {image.shape[1]} x {image.shape[0]}, the first "
                        f"{images[0].shape[1]} x {images[0].shape[0]}"
                    )
                size += image.nbytes
                check_size(path.name, size)
                images.append(image)
                stamps.append(frame.time)
            missing = _missing_s(container, stream, stamps, rate) if part.to_s is None else None
    except (av.FFmpegError, OSError, ValueError, OverflowError, MemoryError) as error:
        told = f" after {len(images)} frames" if images else ""
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{path.name}: not a readable video{told} ({reason})") from None
    span = f" from {part.from_s or 0.0:g} s to {part.to_s:g} s" if part.to_s is not None else ""
    if not images:
        raise InputError(f"{path.name}: holds no decodable frame{span}")
    if missing is not None:
        raise InputError(f"{path.name}: cut off, the last {missing:.2f} s are missing after {len(images)} frames")
    if part.frames is not None and len(images) != part.frames:
        raise InputError(f"{path.name}: has {len(images)} frames{span}, its description tells {part.frames}")
    if path.suffix.lower() == ".gif" and not _gif_ends(path):
        raise InputError(f"{path.name}: cut off after {len(images)} frames (the gif lacks its trailer)")
    fps = float(rate) if rate else None
    return Video(frames=np.stack(images), fps=fps, stamps_s=_irregular(stamps, fps))


def _upright(frame: VideoFrame) -> NDArray[np.uint8]:
    """The image turned the way players show it (phones store a rotation beside the pixels)."""
    image = frame.to_ndarray(format="rgb24")
    return np.ascontiguousarray(np.rot90(image, k=round(frame.rotation / 90) % 4)).astype(np.uint8, copy=False)


def _missing_s(
    container: InputContainer, stream: VideoStream, stamps: list[float | None], rate: Fraction | None
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


def join_videos(path: Path, parts: Iterable[Path]) -> None:
    """Put films of one size, rate and encoding one after the other, without encoding anything anew."""
    part_path = unfinished(path)
    try:
        with av.open(part_path, "w", format="mp4", container_options={"fflags": "+bitexact"}) as container:
            joined: VideoStream | None = None
            shift = 0
            for part in parts:
                with av.open(part) as source:
                    stream = source.streams.video[0]
                    if joined is None:
                        joined = container.add_stream_from_template(stream)
                    end = 0
                    for packet in source.demux(stream):
                        if packet.pts is None or packet.dts is None:  # the mark of the end
                            continue
                        end = max(end, packet.pts + (packet.duration or 0))
                        packet.pts, packet.dts, packet.stream = packet.pts + shift, packet.dts + shift, joined
                        container.mux(packet)
                    shift += end
        os.replace(part_path, path)
    finally:
        part_path.unlink(missing_ok=True)


def write_video(
    path: Path, frames: Iterable[NDArray[np.uint8]], fps: float, *, crf: int = 16, keyframe_every: int | None = None
) -> None:
    """Write frames (H, W, 3) RGB as H.264 in mp4: same frames, same bytes. The file appears only when it is whole.

    Films with sides of less than 96 pixels may come out with other bytes each time: x264's choices vary.

    Odd sizes lose nothing: the last row or column is repeated, as yuv420p needs even ones.

    Args:
        path: file to write.
        frames: images, all of one size.
        fps: frames per second.
        crf: x264's quality, 0 (lossless) to 51; 18 is hard to tell from the original.
        keyframe_every: most frames from one that can be decoded by itself to the next; x264's choice if not given.
    """
    part = unfinished(path)
    try:
        with av.open(part, "w", format="mp4", container_options={"fflags": "+bitexact"}) as container:
            stream: VideoStream | None = None
            for image in frames:
                if stream is None:
                    rate = Fraction(fps).limit_denominator(10_000)
                    options = {"crf": str(crf), "preset": "medium"}
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
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
