"""Preparation of videos for the grounding."""

from pathlib import Path

import numpy as np
from PIL import Image

from kinebench_drake.formats.videos.sample import VideoSample
from kinebench_drake.io.video import Video
from kinebench_drake.runs.preparation import filmed_pictures


def test_the_frames_and_the_conditioning_image_of_a_mirrored_sample_are_turned_left_right(tmp_path: Path) -> None:
    frames = np.random.default_rng(0).integers(0, 256, (3, 40, 60, 3), dtype=np.uint8)
    image = tmp_path / "first.png"
    Image.fromarray(frames[0]).save(image)
    sample = VideoSample(id="a", path=tmp_path / "a.mp4", video="a.mp4", mirrored=True, first_frame=image)
    video, first = filmed_pictures(sample, Video(frames=frames, fps=None, stamps_s=None))
    assert np.array_equal(video.frames, frames[:, :, ::-1])
    assert first is not None
    assert np.array_equal(first, frames[0, :, ::-1])
