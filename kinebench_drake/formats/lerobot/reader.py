"""LeRobot datasets v2.x and v3: their episodes as videos and as trajectories."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow
from numpy.typing import NDArray
from pyarrow import compute

from kinebench_drake.errors import InputError
from kinebench_drake.formats.camerafile import CAMERA_NAME, CameraLookup
from kinebench_drake.formats.lerobot.dataset import EPISODE, FRAME, INFO, TIME, LeRobotDataset
from kinebench_drake.formats.samples import MAX_PERIOD_S, MIN_PERIOD_S
from kinebench_drake.formats.trajectories.columns import complete
from kinebench_drake.formats.trajectories.reading import Reading, TrajectoryOptions
from kinebench_drake.formats.trajectories.trajectory import (
    MAX_FRAMES,
    ColumnTable,
    NumberColumn,
    TrajectoryFormat,
    TrajectorySample,
    require_numbers,
)
from kinebench_drake.formats.videos.sample import Search, VideoSample
from kinebench_drake.geometry import Array
from kinebench_drake.io.files import absence
from kinebench_drake.io.jsonl import as_object, as_type
from kinebench_drake.io.parquet import read_table
from kinebench_drake.io.video import VideoPart

_NO_NUMBERS = ("video", "image", "string", "bool")
_INDEX_COLUMNS = ("timestamp", "frame_index", "episode_index", "index", "task_index")
ROUNDING_S = 1e-4
"""Greatest difference between a time stamp and frame / fps to which it is rounded: LeRobot's own tolerance [s]."""


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
        problem = None
        path = episode.data
        part = VideoPart(key=key, episode=episode.number, frames=episode.length)
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


def list_lerobot_file(path: Path, search: Search) -> list[VideoSample]:
    """List the episodes in a video file of a dataset; none where it holds a single one, or is of no dataset.

    Raises:
        InputError: the dataset cannot be used.
        UsageError: a camera.json is unusable.
    """
    path = path.absolute()
    folder = next((parent for parent in path.parents if is_lerobot(parent)), None)
    if folder is None:
        return []
    dataset = LeRobotDataset.open(folder)
    key = next((name for name in dataset.cameras() if name in path.parts), None)
    if key is None or path.stem.startswith("episode_"):  # v2.x: a file for each episode
        return []
    of_dataset = replace(search, top=folder, cameras=CameraLookup(folder), camera_key=key)
    samples = [sample for sample in list_lerobot_videos(folder, of_dataset) if sample.path == path]
    return samples if len(samples) > 1 else []


def list_lerobot_trajectories(folder: Path, name: str, choice: TrajectoryOptions) -> list[TrajectorySample]:
    """List the episodes of a dataset, called `name` in results, without reading them.

    Raises:
        InputError: the dataset has no description, no suitable column, or no episode.
    """
    dataset = LeRobotDataset.open(folder)
    # Reported once, not per episode.
    table = ColumnTable(columns=_columns(dataset), load=_no_values, t_s=np.empty(0), joints=choice.joints)
    complete(table, choice.reading or Reading())
    samples = [
        TrajectorySample(
            id=f"{folder.resolve().name}-{episode.name}",
            path=episode.data,
            video=f"{name}/{episode.data.relative_to(folder).as_posix()}#{episode.name}",
            format=TrajectoryFormat.LEROBOT,
            part=str(episode.number),
            about=(folder / INFO,),
            robot=as_type(dataset.info.get("robot_type"), str),
            prompt=episode.tasks,
            problem=_absence(episode.data, folder),
        )
        for episode in dataset.episodes()
    ]
    if not samples:
        raise InputError("the dataset holds no episode below data/")
    return samples


@contextmanager
def open_lerobot_table(sample: TrajectorySample) -> Iterator[ColumnTable]:
    """Open one episode.

    Raises:
        InputError: the file is damaged, or lacks a column or the episode.
    """
    dataset = LeRobotDataset.open(sample.about[0].parent.parent)
    number = int(str(sample.part))

    def load(name: str) -> NDArray[np.generic]:
        table = read_table(sample.path, optional=(name,), where=(EPISODE, number))
        if name not in table.column_names:
            raise InputError(f"lacks the column {name} that the dataset's description names")
        if not table.num_rows:
            raise InputError(f"holds no frame of episode {number}")
        if table.num_rows > MAX_FRAMES:
            raise InputError(f"has {table.num_rows} frames, at most {MAX_FRAMES} are accepted: cut it into parts")
        return _matrix(table, name)

    columns = _columns(dataset)
    times = _times(read_table(sample.path, optional=(TIME, FRAME), where=(EPISODE, number)), dataset.fps)
    yield ColumnTable(columns=columns, load=cache(load), t_s=times)


def _columns(dataset: LeRobotDataset) -> tuple[NumberColumn, ...]:
    """Return the columns of number lists, the state first."""
    columns = []
    for name, feature in dataset.features.items():
        about = as_object(feature)
        shape = about.get("shape")
        dtype = about.get("dtype")
        if dtype in _NO_NUMBERS or not isinstance(shape, list) or len(shape) != 1 or name in _INDEX_COLUMNS:
            continue
        names = tuple(_flat(about.get("names")))
        whole = len(names) == shape[0] and all(isinstance(element, str) for element in names)
        if isinstance(shape[0], int):
            columns.append(NumberColumn(name=name, size=shape[0], names=names if whole else ()))
    return tuple(sorted(columns, key=lambda column: column.name != "observation.state"))


def _flat(names: object) -> Iterator[str]:
    if isinstance(names, Mapping):
        for value in names.values():
            yield from _flat(value)
    elif isinstance(names, list):
        yield from names


@contextmanager
def open_parquet_table(sample: TrajectorySample) -> Iterator[ColumnTable]:
    """Open a parquet file of one trajectory that is no part of a LeRobot dataset: columns of numbers or of lists."""
    table = read_table(sample.path, every=True)
    first = table.slice(0, 1).to_pylist()
    row = first[0] if first else {}
    columns = tuple(NumberColumn(name=k, size=len(v) if isinstance(v, list) else 1) for k, v in row.items())
    vectors = {column.name for column in columns if isinstance(row[column.name], list)}
    yield ColumnTable(
        columns=columns,
        load=lambda name: _matrix(table, name) if name in vectors else np.asarray(_vector(table, name)),
    )


def _no_values(name: str) -> NDArray[np.generic]:
    raise InputError(f"{name} was not read")


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
    flat = column.flatten()
    lengths = compute.list_value_length(column).unique()
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
    frames = _vector(table, FRAME)
    stamps = _vector(table, TIME)
    if frames is None or fps is None or not fps > 0:
        return stamps
    even = require_numbers(FRAME, frames) / float(fps)
    if stamps is None:
        return even
    times = require_numbers(TIME, stamps)
    allowed = ROUNDING_S + np.spacing(np.float32(np.abs(even).max(initial=0.0)))
    return even if times.shape == even.shape and np.abs(times - even).max(initial=0.0) <= allowed else stamps
