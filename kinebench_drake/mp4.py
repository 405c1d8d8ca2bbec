"""Writing mp4 files: H.264 through PyAV, the same bytes for the same frames."""

import os
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from av.video.frame import VideoFrame
from av.video.stream import VideoStream
from numpy.typing import NDArray

from kinebench_drake.storage import unfinished


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
