"""LeRobot datasets v2.x and v3: their episodes as videos and as trajectories."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow
from numpy.typing import NDArray
from pyarrow import compute

from kinebench_drake.errors import InputError
from kinebench_drake.formats.camerafile import CAMERA_NAME
from kinebench_drake.formats.lerobot.dataset import FRAME, INFO, TIME, LeRobotDataset, read_table
from kinebench_drake.formats.samples import MAX_PERIOD_S, MIN_PERIOD_S
from kinebench_drake.formats.trajectories.check import MAX_FRAMES
from kinebench_drake.formats.trajectories.lerobot_columns import find_columns
from kinebench_drake.formats.trajectories.trajectory import (
    RawTrajectory,
    TrajectoryFormat,
    TrajectoryOptions,
    TrajectorySample,
    require_numbers,
)
from kinebench_drake.formats.videos.sample import Search, VideoSample
from kinebench_drake.geometry import Array
from kinebench_drake.io.files import absence
from kinebench_drake.io.jsonl import as_object
from kinebench_drake.io.video import VideoPart

_TIMES_AGREE_S = 1e-4
"""Greatest difference between a time stamp and frame / fps to which it is rounded (LeRobot's own tolerance)."""


def is_lerobot(folder: Path) -> bool:
    """Return whether a folder is a LeRobot dataset."""
    return (folder / INFO).is_file()


def list_lerobot_videos(folder: Path, search: Search) -> list[VideoSample]:
    """List the episodes of a dataset, one camera of each.

    Raises:
        InputError: the dataset cannot be used, or the choice of the camera is ambiguous.
        UsageError: a camera.json is unusable.
    """
    dataset = LeRobotDataset.open(folder)
    cameras = list(dataset.cameras())
    if not cameras:
        expected = "expected a feature of dtype video or image (`audit` reads its trajectories)"
        raise InputError(f"the LeRobot dataset has no video, {expected}")
    key = search.choose_camera(cameras, "the dataset")
    in_parquet = as_object(dataset.features[key]).get("dtype") == "image"
    search.cameras.assign(folder, folder / "meta" / CAMERA_NAME)
    fps = dataset.fps
    period_s = None if fps is None or not 1.0 / MAX_PERIOD_S <= fps <= 1.0 / MIN_PERIOD_S else 1.0 / fps
    samples = []
    for episode in dataset.episodes(key):
        problem, path, part = None, episode.data, VideoPart(key=key, episode=episode.number, frames=episode.length)
        if not in_parquet:
            try:
                path, part = dataset.video_part(episode, key)
            except InputError as error:
                problem = str(error)
        sample = search.part_sample(path)
        samples.append(
            replace(
                sample,
                id=f"{folder.resolve().name}-{episode.name}",
                part=part,
                video=f"{sample.video}#{episode.name}",
                camera_key=key,
                prompt=episode.tasks,
                dataset_period_s=period_s,
                problem=problem or _absence(path, folder),
            )
        )
    if not samples:
        raise InputError("the dataset holds no episode")
    return samples


def list_lerobot_trajectories(folder: Path, name: str, choice: TrajectoryOptions) -> list[TrajectorySample]:
    """List the episodes of a dataset, called `name` in results, without reading them.

    Raises:
        InputError: the dataset has no description, no suitable column, or no episode.
    """
    dataset = LeRobotDataset.open(folder)
    find_columns(dataset.features, choice)  # reported once, not per episode
    samples = [
        TrajectorySample(
            id=f"{folder.resolve().name}-{episode.name}",
            path=episode.data,
            video=f"{name}/{episode.data.relative_to(folder).as_posix()}#{episode.name}",
            format=TrajectoryFormat.LEROBOT,
            part=str(episode.number),
            about=(folder / INFO,),
            prompt=episode.tasks,
            problem=_absence(episode.data, folder),
        )
        for episode in dataset.episodes()
    ]
    if not samples:
        raise InputError("the dataset holds no episode below data/")
    return samples


def read_lerobot(sample: TrajectorySample, choice: TrajectoryOptions) -> RawTrajectory:
    """Read the joint angles or poses of one episode.

    Raises:
        InputError: the file is damaged, or lacks a column or the episode.
    """
    dataset = LeRobotDataset.open(sample.about[0].parent.parent)
    reading = find_columns(dataset.features, choice)
    table = read_table(sample.path, optional=(reading.column, TIME, FRAME), episode=int(str(sample.part)))
    if reading.column not in table.column_names:
        raise InputError(f"lacks the column {reading.column} that the dataset's description names")
    if not table.num_rows:
        raise InputError(f"holds no frame of episode {sample.part}")
    if table.num_rows > MAX_FRAMES:
        raise InputError(f"has {table.num_rows} frames, at most {MAX_FRAMES} are accepted: cut it into parts")
    rows = _matrix(table, reading.column)
    if max(reading.indices) >= rows.shape[1]:
        raise InputError(f"{reading.column} holds {rows.shape[1]} numbers, less than {INFO.as_posix()} says")
    return reading.apply(rows, _times(table, dataset.fps))


def _absence(path: Path, folder: Path) -> str | None:
    return None if path.is_file() else f"{path.relative_to(folder).as_posix()}: {absence(path)}"


def _matrix(table: pyarrow.Table, name: str) -> Array:
    """Return a column of number lists as (T, n)."""
    column = table.column(name).combine_chunks()
    lists = pyarrow.types.is_list(column.type) or pyarrow.types.is_fixed_size_list(column.type)
    if column.null_count or not (lists or pyarrow.types.is_large_list(column.type)):
        raise InputError(
            f"{name} holds {column.type} with {column.null_count} gaps, expected a list of numbers per frame"
        )
    flat, lengths = column.flatten(), compute.list_value_length(column).unique()
    if flat.null_count or len(lengths) != 1:
        raise InputError(f"{name} holds rows of different lengths or with gaps")
    return require_numbers(name, flat.to_numpy(zero_copy_only=False)).reshape(len(column), lengths[0].as_py())


def _vector(table: pyarrow.Table, name: str) -> NDArray[np.generic] | None:
    """Return a column of numbers as (T,); None if the file lacks it."""
    if name not in table.column_names:
        return None
    column = table.column(name).combine_chunks()
    if pyarrow.types.is_list(column.type) or pyarrow.types.is_fixed_size_list(column.type):
        column = column.flatten()
    return np.asarray(column.to_numpy(zero_copy_only=False))


def _times(table: pyarrow.Table, fps: float | None) -> NDArray[np.generic] | None:
    """Return frame / fps if the time stamps, rounded to single precision, agree with it, else the stamps."""
    frames, stamps = _vector(table, FRAME), _vector(table, TIME)
    if frames is None or fps is None or not fps > 0:
        return stamps
    even = require_numbers(FRAME, frames) / float(fps)
    if stamps is None:
        return even
    times = require_numbers(TIME, stamps)
    allowed = _TIMES_AGREE_S + np.spacing(np.float32(np.abs(even).max()))
    return even if times.shape == even.shape and np.abs(times - even).max() <= allowed else stamps
