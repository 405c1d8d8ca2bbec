"""Pictures of episodes: a strip of single frames, and frames of rollouts, generated beside executed ones."""

from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import BENCHMARK_PX
from kinebench_drake.grounding.overlay import draw_caption
from kinebench_drake.models.panda.cad import franka_hand
from kinebench_drake.runs.pictures import encode_strip
from kinebench_drake.runs.resources import Resources
from kinebench_drake.suites.closed_loop.loop import EpisodeRun
from kinebench_drake.suites.rollout import RolloutVideo


def rollout_frames(
    run: EpisodeRun, executed: Sequence[RolloutVideo | None], tools: Resources
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
        overlays = tools.overlay(execution.rgb, execution.camera, track, gripper=franka_hand())
        for frame, image, overlay in zip(done.frames, execution.rgb, overlays, strict=False):
            yield np.concatenate([_captioned(frame, text), _captioned(image, "executed"), overlay], axis=1)


def episode_strip(run: EpisodeRun, executed: Sequence[RolloutVideo | None]) -> bytes:
    """Encode the first frame, the last generated and the last executed one."""
    last = next((video.rgb[-1] for video in reversed(executed) if video is not None), run.rounds[0].frames[0])
    images = (run.rounds[0].frames[0], "start"), (run.rounds[-1].frames[-1], "generated"), (last, "executed")
    return encode_strip([_captioned(frame, text) for frame, text in images])


def _captioned(frame: NDArray[np.uint8], text: str) -> NDArray[np.uint8]:
    image = np.asarray(cv2.resize(frame, (BENCHMARK_PX, BENCHMARK_PX), interpolation=cv2.INTER_AREA), dtype=np.uint8)
    draw_caption(image, text)
    return image
