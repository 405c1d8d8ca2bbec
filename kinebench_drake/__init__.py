"""Judge robot videos by geometry: gripper tracks from pixels, kinematics in Drake.

The Python interface (docs/api.md) is imported on first use: functions that do what the commands do, those that read
what the commands write, and the types of their arguments.
"""

from typing import TYPE_CHECKING

__all__ = [
    "Camera",
    "InitialState",
    "KinebenchError",
    "NullRunObserver",
    "Scorer",
    "__version__",
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

__version__ = "0.2.0"

if TYPE_CHECKING:
    from kinebench_drake.api import (
        Camera,
        InitialState,
        KinebenchError,
        NullRunObserver,
        Scorer,
        audit_trajectories,
        audit_trajectory,
        ground_video,
        read_rows,
        read_track,
        read_video,
        run_suite,
        score_videos,
        write_video,
    )
else:

    def __getattr__(name: str) -> object:
        """Import a name of the Python interface on first use (PEP 562)."""
        if name in __all__:
            from kinebench_drake import api

            return getattr(api, name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
