"""Commanded motion of a clip: the file of its actions, found by the video, read at the times of its frames."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.formats.trajectories.reading import TrajectoryOptions
from kinebench_drake.formats.trajectories.source import find_trajectories, read_trajectory
from kinebench_drake.formats.trajectories.trajectory import TrajectoryFormat, TrajectorySample
from kinebench_drake.formats.videos.sample import VideoSample
from kinebench_drake.geometry import Array
from kinebench_drake.io.archive import hash_file
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
    q: Array | None
    """(T, 7) commanded joint angles [rad]; None of poses."""
    source: str
    """Name of the file, and the columns that were read."""

    def q_at(self, t_s: Array) -> Array:
        """Return the joint angles (N, 7) at times (N,) [s]; NaN where unknown."""
        if self.q is None:
            return np.full((len(t_s), 7), np.nan)
        return np.column_stack([np.interp(t_s, self.series.t_s, column) for column in self.q.T])


def find_actions(
    source: Path | None, samples: Sequence[VideoSample], choice: TrajectoryOptions
) -> dict[str, TrajectorySample]:
    """Find the actions of videos; those without any are left out.

    Args:
        source: folder of files with the names of the videos, or a file or data set with an episode for each; None: the
            files that the manifest names.
        samples: the videos.
        choice: how trajectories are read.

    Raises:
        UsageError: there are none.
    """
    if source is None:
        named = {sample.id: sample.actions for sample in samples}
    else:
        named = {sample.id: _beside(source, sample) for sample in samples} if source.is_dir() else {}
    found = {id: _single(path, choice) for id, path in named.items() if path is not None}
    if source is not None and not found:
        listed = {trajectory.id: trajectory for trajectory in find_trajectories(source, choice)}
        found = {sample.id: listed[sample.id] for sample in samples if sample.id in listed}
        if len(listed) == len(samples) == 1:
            found = {samples[0].id: next(iter(listed.values()))}
    if not found:
        place = (
            f"{source} holds" if source else "without $actions DIR the manifest names them by the key actions, it has"
        )
        raise UsageError(
            f"{place} no actions of the videos: expected for each a file such as {samples[0].id}.npz, or an episode of "
            "that name"
        )
    return found


def _beside(folder: Path, sample: VideoSample) -> Path | None:
    files = (folder / f"{name}{suffix}" for name in override_names(sample) for suffix in _SUFFIXES)
    return next((file for file in files if file.is_file()), None)


def _single(path: Path, choice: TrajectoryOptions) -> TrajectorySample:
    """Return the only trajectory of a file; a problem in place of none or several."""
    try:
        listed = find_trajectories(path, choice)
    except UsageError as error:
        problem = str(error)
    else:
        if len(listed) == 1:
            return listed[0]
        problem = f"{path.name} holds {len(listed)} episodes, expected that of the video alone"
    return TrajectorySample(id=path.stem, path=path, video=path.name, format=TrajectoryFormat.NPZ, problem=problem)


def read_commands(
    sample: TrajectorySample, choice: TrajectoryOptions, timed: TimedFrames, clip_frames: int, plant: "ArmPlant"
) -> Commands:
    """Read actions: the rows of a file with as many rows as frames are those of the frames, others have their times.

    Rows without times are one frame period apart. Both clocks begin at 0.

    Args:
        sample: the actions.
        choice: how they are read.
        timed: times of the frames.
        clip_frames: number of frames of the video.
        plant: kinematics of the robot.

    Raises:
        InputError: the file is invalid.
    """
    trajectory = read_trajectory(sample, replace(choice, rate_hz=1.0 / timed.period_s))
    rows: NDArray[np.intp] = np.arange(len(trajectory.t_s))
    if len(rows) == clip_frames:
        rows = timed.rows
        t_s = timed.t_s
    else:
        with suppress(InputError):  # without times: read above
            trajectory = read_trajectory(sample, choice)
        t_s = trajectory.t_s - trajectory.t_s[0] + timed.t_s[0]
    tracked = trajectory.tracked[rows]
    q = None if trajectory.q is None else trajectory.q[rows]
    if q is not None:
        X_BG = plant.forward_path(np.where(tracked[:, None], q, 0.0))
    elif trajectory.X_BG is not None:
        X_BG = trajectory.X_BG[rows]
    X_BG = np.where(tracked[:, None, None], X_BG, np.nan)
    series = PoseSeries(t_s=t_s, X=X_BG, finger_width_m=trajectory.finger_width_m[rows])
    return Commands(series=series, q=q, source=f"{sample.video}, {trajectory.columns}")


def other_actions(actions: Mapping[str, TrajectorySample]) -> dict[str, TrajectorySample]:
    """Return for each video the actions of the next one, by id, that has others; left out where all are equal."""
    hashes: dict[Path, str] = {}
    contents = {}
    for id, sample in actions.items():
        if sample.problem is None and sample.path not in hashes:
            hashes[sample.path] = hash_file(sample.path)
        contents[id] = (hashes.get(sample.path), sample.part, sample.rows)
    ids = sorted(id for id in actions if contents[id][0] is not None)
    others = {}
    for k, id in enumerate(ids):
        following = [*ids[k + 1 :], *ids[:k]]
        other = next((name for name in following if contents[name] != contents[id]), None)
        if other is not None:
            others[id] = actions[other]
    return others
