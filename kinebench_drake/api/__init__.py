"""The Python interface (docs/api.md): functions and a class that return typed objects.

`score_videos`, `audit_trajectories` and `run_suite` fill an output folder as their commands do; `read_rows` and
`read_track` read it. `ground_video` and `audit_trajectory` process one sample and write nothing, nor does `Scorer`,
which keeps its models between clips. Arguments have the names of the commands' options.
"""

from kinebench_drake.api.runs import audit_trajectories, run_suite, score_videos
from kinebench_drake.api.scorer import Score, Scorer
from kinebench_drake.api.single import audit_trajectory, ground_video
from kinebench_drake.camera import Camera
from kinebench_drake.errors import KinebenchError
from kinebench_drake.io.container import write_video
from kinebench_drake.io.reader import read_video
from kinebench_drake.results.store import read_rows
from kinebench_drake.results.trackfile import read_track
from kinebench_drake.runs.runner import NullRunObserver
from kinebench_drake.track import InitialState

__all__ = [
    "Camera",
    "InitialState",
    "KinebenchError",
    "NullRunObserver",
    "Score",
    "Scorer",
    "audit_trajectories",
    "audit_trajectory",
    "ground_video",
    "read_rows",
    "read_track",
    "read_video",
    "run_suite",
    "score_videos",
    "write_video",
]
