"""Judge robot videos by geometry: gripper tracks from pixels, kinematics in Drake.

The Python interface (docs/api.md) is `score_videos`, `ground_video`, `audit_trajectory`, `run_suite`, `read_results`,
and `Scorer` for training loops. They are imported on first use.
"""

from typing import TYPE_CHECKING

__all__ = ["Scorer", "__version__", "audit_trajectory", "ground_video", "read_results", "run_suite", "score_videos"]

__version__ = "0.2.0"

if TYPE_CHECKING:
    from kinebench_drake.api import Scorer, audit_trajectory, ground_video, read_results, run_suite, score_videos
else:

    def __getattr__(name: str) -> object:
        """Import a function of the Python interface on first use (PEP 562)."""
        if name in __all__:
            from kinebench_drake import api

            return getattr(api, name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
