"""The Python interface: five functions and a class that return typed objects (docs/api.md).

`score_videos` and `run_suite` fill an output folder as their commands do, `read_results` reads its rows; `ground_video`
and `audit_trajectory` process one sample and write nothing; nor does `Scorer`, which keeps its models between clips.
Arguments have the names of the commands' options.
"""

from kinebench_drake.api.runs import read_results, run_suite, score_videos
from kinebench_drake.api.scorer import Score, Scorer
from kinebench_drake.api.single import audit_trajectory, ground_video

__all__ = ["Score", "Scorer", "audit_trajectory", "ground_video", "read_results", "run_suite", "score_videos"]
