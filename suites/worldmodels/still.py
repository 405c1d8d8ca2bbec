"""A world in which nothing happens: what every other world model should beat."""

from itertools import repeat
from pathlib import Path

from kinebench_drake.io.atomic import disk_errors
from kinebench_drake.io.container import write_video
from kinebench_drake.suites.worldmodels.spec import Options, Spec
from kinebench_drake.suites.worldmodels.worldmodel import Request


class StillModel:
    """The first frame, repeated."""

    def __init__(self, spec: Spec) -> None:
        spec.bare()
        self.name = spec.read(Options).name or "still"

    def generate(self, request: Request, out: Path) -> Path:
        """See `WorldModel`."""
        path = out.with_name(f"{out.name}.mp4")
        with disk_errors(path.name):
            write_video(path, repeat(request.first_frame, request.num_frames), request.fps)
        return path

    def close(self) -> None:
        """Nothing is held."""
