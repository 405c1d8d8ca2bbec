"""The Python interface: what the commands do, as four functions that return typed objects. See docs/api.md.

`score_videos` and `run_suite` fill an output folder as their commands do; `ground_video` and `audit_trajectory` take
one sample and write nothing. Arguments are called after the commands' options, and messages name the options.
"""

from kinebench_drake.api.run import run_suite, score_videos
from kinebench_drake.api.single import audit_trajectory, ground_video

__all__ = ["audit_trajectory", "ground_video", "run_suite", "score_videos"]
