"""Pictures of samples: thumbnails, a few frames in a row, and frames of rollouts, generated beside executed ones."""

import io
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from kinebench_drake.camera import BENCHMARK_PX
from kinebench_drake.runs.resources import Resources
from kinebench_drake.track import GripperTrack

if TYPE_CHECKING:  # loads Drake and ManiSkill
    from kinebench_drake.metrics.kinematic_result import KinematicResult
    from kinebench_drake.suites.closed_loop.loop import EpisodeRun
    from kinebench_drake.suites.rollout import RolloutVideo


def worst_frame(track: GripperTrack, kinematics: "KinematicResult | None") -> int:
    """Return the frame of the first violation, else the tracked frame of lowest confidence."""
    if kinematics and kinematics.violations:
        return min(max(int(kinematics.violations[0].frame_start), 0), len(track.t_s) - 1)
    return int(np.argmin(np.where(track.tracked, np.nan_to_num(track.confidence), 2.0)))


def encode_strip(images: list[NDArray[np.uint8]]) -> bytes:
    """Encode images of equal height, side by side, as a small JPEG."""
    strip = Image.fromarray(np.concatenate(images, axis=1))
    strip.thumbnail((10_000, 240), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    strip.save(buffer, "JPEG", quality=82, optimize=True)
    return buffer.getvalue()


def rollout_frames(
    run: "EpisodeRun", executed: "Sequence[RolloutVideo | None]", tools: Resources
) -> Iterator[NDArray[np.uint8]]:
    """Yield generated frames, executed frames, and the generated gripper drawn on the executed frames, side by side."""
    for number, (done, execution) in enumerate(zip(run.rounds, executed, strict=True), 1):
        text = f"generated, round {number}"
        if execution is None:
            blank = _captioned(np.zeros((BENCHMARK_PX, BENCHMARK_PX, 3), dtype=np.uint8), "nothing executed")
            for frame in done.frames:
                yield np.concatenate([_captioned(frame, text), blank, blank], axis=1)
            continue
        track = done.grounding.track.at(np.arange(len(execution.rgb)))
        overlays = tools.overlay(execution.rgb, execution.camera, track)
        for frame, image, overlay in zip(done.frames, execution.rgb, overlays, strict=False):
            yield np.concatenate([_captioned(frame, text), _captioned(image, "executed"), overlay], axis=1)


def episode_strip(run: "EpisodeRun", executed: "Sequence[RolloutVideo | None]") -> bytes:
    """Encode the first frame, the last generated and the last executed one."""
    last = next((video.rgb[-1] for video in reversed(executed) if video is not None), run.rounds[0].frames[0])
    images = (run.rounds[0].frames[0], "start"), (run.rounds[-1].frames[-1], "generated"), (last, "executed")
    return encode_strip([_captioned(frame, text) for frame, text in images])


def _captioned(frame: NDArray[np.uint8], text: str) -> NDArray[np.uint8]:
    import cv2

    from kinebench_drake.grounding.overlay import draw_caption

    image = np.asarray(cv2.resize(frame, (BENCHMARK_PX, BENCHMARK_PX), interpolation=cv2.INTER_AREA), dtype=np.uint8)
    draw_caption(image, text)
    return image
