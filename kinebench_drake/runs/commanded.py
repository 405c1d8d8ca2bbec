"""Commanded motion of a clip: the file of its actions, read at the times of its frames."""

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.formats.lerobot.reader import is_lerobot
from kinebench_drake.formats.trajectories.reading import TrajectoryOptions
from kinebench_drake.formats.trajectories.source import find_trajectories, read_trajectory
from kinebench_drake.formats.trajectories.trajectory import TrajectorySample
from kinebench_drake.formats.videos.sample import VideoSample
from kinebench_drake.geometry import Array
from kinebench_drake.metrics.following import PoseSeries
from kinebench_drake.runs.frame_period import TimedFrames
from kinebench_drake.runs.preparation import override_names

if TYPE_CHECKING:  # loads Drake
    from kinebench_drake.kinematics.plant import ArmPlant

_SUFFIXES = (".npz", ".csv", ".json", ".h5", ".hdf5", ".parquet", ".npy", ".txt", ".tsv")
"""Suffixes of files of actions, in order of precedence."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Commands:
    """Commanded motion."""

    series: PoseSeries
    """Commanded poses of the TCP in the robot base frame."""
    q: Array
    """(T, 7) commanded joint angles [rad]; NaN where unknown."""
    source: str
    """Name of the file, and the columns that were read."""

    def q_at(self, t_s: Array) -> Array:
        """Return the joint angles (N, 7) [rad] at times (N,) [s]: the first and the last ones outside."""
        return np.column_stack([np.interp(t_s, self.series.t_s, column) for column in self.q.T])


def find_actions(source: Path | None, sample: VideoSample) -> Path | None:
    """Return the file or data set with the actions of a video; None if there is none.

    Args:
        source: folder of files with the names of the videos, or a file or data set with an episode for each; None: the
            manifest names a file.
        sample: the video.
    """
    if source is None or not source.is_dir():
        return source or sample.actions
    files = (source / f"{name}{suffix}" for name in override_names(sample) for suffix in _SUFFIXES)
    file = next((file for file in files if file.is_file()), None)
    return file or (source if is_lerobot(source) else None)


@lru_cache(maxsize=16)
def _list_actions(path: Path, choice: TrajectoryOptions) -> tuple[TrajectorySample, ...]:
    return find_trajectories(path, choice)


def choose_actions(path: Path, id: str, choice: TrajectoryOptions) -> TrajectorySample:
    """Return the episode of a video among the trajectories of a file or data set: the one of its id, or the only one.

    Raises:
        UsageError: there is no such file or episode.
    """
    listed = _list_actions(path, choice)
    chosen = [sample for sample in listed if sample.id == id] or listed
    if len(chosen) != 1:
        raise UsageError(f"$actions {path.name}: holds {len(listed)} episodes, none of which is called {id}")
    return chosen[0]


def read_commands(
    actions: TrajectorySample, choice: TrajectoryOptions, timed: TimedFrames, clip_frames: int, plant: "ArmPlant"
) -> Commands:
    """Read actions: the rows of a file with as many rows as frames are those of the frames, others have their times.

    Rows without times are one frame period apart. Both clocks begin at 0.

    Args:
        actions: the trajectory.
        choice: how it is read.
        timed: times of the frames.
        clip_frames: number of frames of the video.
        plant: kinematics of the robot.

    Raises:
        InputError: the file is invalid.
    """
    trajectory = read_trajectory(actions, replace(choice, rate_hz=1.0 / timed.period_s))
    rows = timed.rows
    t_s = timed.t_s
    if len(trajectory.t_s) != clip_frames:
        with suppress(InputError):  # it has no times: those at the frame period stay
            trajectory = read_trajectory(actions, choice)
        rows = np.arange(len(trajectory.t_s))
        t_s = trajectory.t_s - trajectory.t_s[0] + timed.t_s[0]
    tracked = trajectory.tracked[rows]
    q = np.full((len(rows), 7), np.nan) if trajectory.q is None else trajectory.q[rows]
    X_BG = trajectory.X_BG
    X_BG = plant.forward_path(np.where(tracked[:, None], q, 0.0)) if X_BG is None else X_BG[rows]
    return Commands(
        series=PoseSeries(
            t_s=t_s,
            X=np.where(tracked[:, None, None], X_BG, np.nan),
            finger_width_m=trajectory.finger_width_m[rows],
        ),
        q=q,
        source=f"{actions.video}, {trajectory.columns}",
    )
