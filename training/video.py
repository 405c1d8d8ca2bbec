"""Videos of moving arms with ground truth from Drake's VTK renderer, seen by static cameras from anywhere."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.perception.store import drop_torn_line
from kinebench_drake.geometry import invert
from kinebench_drake.io.container import write_video
from kinebench_drake.io.jsonl import append_line, as_object, read_lines
from kinebench_drake.io.npz import write_arrays
from kinebench_drake.models.panda.description import hand_from_tcp
from training.vtk import RenderedVideo, VtkScene

_STREAM = 0x5654
"""Number that separates these random streams from others with the same seed."""
_CRF = (14, 30)
"""Quality of x264, best and worst."""


def render_videos(folder: Path, seeds: Iterable[int], report: Callable[[str], None]) -> None:
    """Render a video per seed that the manifest of `folder` lacks: NAME.mp4, NAME.gt.npz and a line of manifest.jsonl.

    Truth of T frames: `t_s` (T,) [s]; `base_from_hand`, `base_from_tcp` and `camera_from_hand` (T, 4, 4) [m];
    `finger_width_m` (T,), the gap between the pads; `q` (T, 7) [rad]; `visible` (T,), pixels that show the gripper.
    """
    folder.mkdir(parents=True, exist_ok=True)
    manifest = folder / "manifest.jsonl"
    drop_torn_line(manifest)
    listed = {row.get("video") for row in read_lines(manifest, as_object)}
    for seed in seeds:
        name = f"v{seed:06d}"
        if f"{name}.mp4" not in listed:
            rng = np.random.default_rng([seed, _STREAM])
            video = VtkScene(rng).video()
            write_video(folder / f"{name}.mp4", video.frames, 1.0 / video.frame_period_s, crf=int(rng.integers(*_CRF)))
            write_arrays(folder / f"{name}.gt.npz", _truth(video))
            camera = video.camera.to_json()
            row = {"video": f"{name}.mp4", "frame_period_s": video.frame_period_s, "camera": camera}
            append_line(manifest, row)
            report(f"rendered {name}.mp4: {len(video.frames)} frames of {camera['width']}x{camera['height']}")


def _truth(video: RenderedVideo) -> dict[str, NDArray[Any]]:
    return {
        "t_s": np.arange(len(video.frames)) * video.frame_period_s,
        "base_from_hand": video.X_BH,
        "base_from_tcp": video.X_BH @ hand_from_tcp(),
        "camera_from_hand": invert(video.camera.X_BC) @ video.X_BH,
        "finger_width_m": 2 * video.motion.finger_m,
        "q": video.motion.q,
        "visible": video.visible,
    }
