"""Your own world model as a class, for `--world-model my_world_model:MyWorldModel` (docs/worldmodels.md).

This placeholder repeats the first frame, a little darker each time. Replace it by your model.
"""

from pathlib import Path

import numpy as np

from kinebench_drake import write_video
from kinebench_drake.suites.worldmodels.worldmodel import Request, WorldModelError


class MyWorldModel:
    def __init__(self, dim: str = "0.002") -> None:
        """Options of the spec, as in my_world_model:MyWorldModel?dim=0.01, come as strings."""
        self.name = "dimmer"  # how results call it
        self._dim = float(dim)

    def generate(self, request: Request, out: Path) -> Path:
        """Make the video of a request: its first frame and prompt are what the model gets to see."""
        if not request.prompt:
            raise WorldModelError("no prompt, no video")  # this episode fails, the run goes on
        light = 1.0 - self._dim * np.arange(request.num_frames)
        frames = request.first_frame * np.clip(light, 0.0, 1.0)[:, None, None, None]
        path = out.with_name(f"{out.name}.mp4")
        write_video(path, frames.round().astype(np.uint8), request.fps)
        return path

    def close(self) -> None:
        """Free what the model holds."""
