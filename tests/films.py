"""Films as their frames, and short ones."""

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from kinebench_drake.suites.closed_loop import loop
from kinebench_drake.suites.runs import episodes


def shorten_clips(patch: pytest.MonkeyPatch) -> None:
    """Let clips of the closed loop have 13 frames: pictures take long without a GPU."""
    for module in (loop, episodes):
        patch.setattr(module, "FRAMES", 13)


def decoded(path: Path) -> tuple[list[float], np.ndarray]:
    """Times [s] and pictures (T, H, W, 3) of a film."""
    with av.open(path) as file:
        frames = list(file.decode(video=0))
    return [float(frame.time) for frame in frames], np.stack([frame.to_ndarray(format="rgb24") for frame in frames])


def encode(path, frames, codec, pixel_format, *, options=None, stamps=None):
    """Write a film at 17 frames/s, or with time stamps [ms]."""
    with av.open(path, "w", options=options or {}) as container:
        stream = container.add_stream(codec, rate=17)
        stream.height, stream.width = frames.shape[1:3]
        stream.pix_fmt = pixel_format
        if stamps:
            stream.codec_context.time_base = Fraction(1, 1000)
        for k, image in enumerate(frames):
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            if stamps:
                frame.pts = stamps[k]
                frame.time_base = Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
