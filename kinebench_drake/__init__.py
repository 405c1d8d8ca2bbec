"""Judge robot videos by geometry: gripper tracks from pixels, kinematics in Drake.

Four functions do from Python what the commands do: `score_videos`, `ground_video`, `audit_trajectory`, `run_suite`
(docs/api.md). They are loaded when they are first asked for.
"""

from typing import TYPE_CHECKING

__all__ = ["__version__", "audit_trajectory", "ground_video", "run_suite", "score_videos"]

__version__ = "0.1.0"

if TYPE_CHECKING:
    from kinebench_drake.api import audit_trajectory, ground_video, run_suite, score_videos
else:

    def __getattr__(name: str) -> object:
        """Load a function of the Python interface (PEP 562): importing the package stays cheap."""
        if name in __all__:
            from kinebench_drake import api

            return getattr(api, name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
