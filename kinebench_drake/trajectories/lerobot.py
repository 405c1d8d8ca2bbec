"""Joint angles or poses of the episodes of a LeRobot dataset."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow
from numpy.typing import NDArray
from pyarrow import compute

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array
from kinebench_drake.trajectories.check import MAX_FRAMES, numbers
from kinebench_drake.trajectories.columns import Columns, Layout, find_columns
from kinebench_drake.trajectories.dataset import INFO, list_episodes, read_info, read_rows, schema
from kinebench_drake.trajectories.description import mapping
from kinebench_drake.trajectories.pose import from_quaternions, from_vectors
from kinebench_drake.trajectories.sample import Format, TrajectorySample
from kinebench_drake.trajectories.trajectory import Choice, Recording

_TIMES_AGREE_S = 1e-4
"""Time stamps this near to frame / fps are taken to mean it (LeRobot's own tolerance)."""


def list_lerobot(folder: Path, name: str, choice: Choice) -> list[TrajectorySample]:
    """The episodes of a dataset, none of them read.

    Args:
        folder: the dataset.
        name: how results name it.
        choice: what the user says about its columns.

    Raises:
        InputError: the dataset cannot be used: no description, no fitting column, no episode.
    """
    info = read_info(folder)
    find_columns(mapping(info["features"]), choice)  # told once, not once an episode
    stem = folder.resolve().name
    samples = []
    for episode in list_episodes(folder, info):
        number, file = episode.number, episode.data
        samples.append(
            TrajectorySample(
                id=f"{stem}-episode_{number:06d}",
                path=file,
                video=f"{name}/{file.relative_to(folder).as_posix()}#episode_{number:06d}",
                format=Format.LEROBOT,
                part=str(number),
                about=(folder / INFO,),
                prompt=episode.tasks,
                problem=None if file.is_file() else f"{file.relative_to(folder).as_posix()}: there is no such file",
            )
        )
    if not samples:
        raise InputError("the dataset holds no episode below data/")
    return samples


def read_lerobot(path: Path, episode: int, info_path: Path, choice: Choice) -> Recording:
    """Read one episode.

    Args:
        path: the parquet file.
        episode: the episode's number.
        info_path: the dataset's meta/info.json.
        choice: what the user says about its columns.

    Raises:
        InputError: the file is damaged, or lacks a column or the episode.
    """
    info = read_info(info_path.parent.parent)
    columns = find_columns(mapping(info["features"]), choice)
    table = _rows(path, episode, columns)
    values = _matrix(table, columns.column)
    if max(columns.indices) >= values.shape[1]:
        raise InputError(f"{columns.column} holds {values.shape[1]} numbers, the dataset's description tells more")
    taken, warnings = values[:, columns.indices], list(columns.warnings)
    q: Array | None = None
    X_BG: Array | None = None
    if columns.layout is Layout.JOINTS:
        q = taken
    elif columns.layout is Layout.MATRIX:
        X_BG = taken.reshape(-1, 4, 4)
    elif columns.layout is Layout.QUATERNION:
        X_BG, mended = from_quaternions(taken[:, :3], taken[:, 3:])
        warnings += mended
    else:
        X_BG = from_vectors(taken[:, :3], taken[:, 3:], angles=columns.layout is Layout.ROLL_PITCH_YAW)
    return Recording(
        t_s=_times(table, info),
        X_BG=X_BG,
        q=q,
        finger_width_m=_width(values, columns),
        columns=columns.told,
        warnings=tuple(warnings),
    )


def _rows(path: Path, episode: int, columns: Columns) -> pyarrow.Table:
    there = schema(path)
    if columns.column not in there:
        raise InputError(f"lacks the column {columns.column} that the dataset's description names")
    wanted = [columns.column, *(name for name in ("timestamp", "frame_index") if name in there)]
    table = read_rows(path, wanted, episode if "episode_index" in there else None)
    if not table.num_rows:
        raise InputError(f"holds no frame of episode {episode}")
    if table.num_rows > MAX_FRAMES:
        raise InputError(f"has {table.num_rows} frames, at most {MAX_FRAMES} are taken: cut it into parts")
    return table


def _matrix(table: pyarrow.Table, name: str) -> Array:
    """A column of rows of numbers as (T, n)."""
    column = table.column(name).combine_chunks()
    lists = pyarrow.types.is_list(column.type) or pyarrow.types.is_fixed_size_list(column.type)
    if column.null_count or not (lists or pyarrow.types.is_large_list(column.type)):
        raise InputError(f"{name} holds {column.type} with {column.null_count} gaps, expected a row of numbers a frame")
    flat, lengths = column.flatten(), compute.list_value_length(column).unique()
    if flat.null_count or len(lengths) != 1:
        raise InputError(f"{name} holds rows of different lengths or with gaps")
    return numbers(name, flat.to_numpy(zero_copy_only=False)).reshape(len(column), lengths[0].as_py())


def _vector(table: pyarrow.Table, name: str) -> NDArray[np.generic] | None:
    """A column of single numbers as (T,); None where the file lacks it."""
    if name not in table.column_names:
        return None
    column = table.column(name).combine_chunks()
    if pyarrow.types.is_list(column.type) or pyarrow.types.is_fixed_size_list(column.type):
        column = column.flatten()
    return np.asarray(column.to_numpy(zero_copy_only=False))


def _times(table: pyarrow.Table, info: Mapping[str, object]) -> NDArray[np.generic] | None:
    """Frame / fps where the time stamps agree with it (they are rounded to single precision), else the stamps."""
    fps, frames, stamps = info.get("fps"), _vector(table, "frame_index"), _vector(table, "timestamp")
    if frames is None or not isinstance(fps, int | float) or isinstance(fps, bool) or not fps > 0:
        return stamps
    even = numbers("frame_index", frames) / float(fps)
    if stamps is None:
        return even
    told = numbers("timestamp", stamps)
    allowed = _TIMES_AGREE_S + np.spacing(np.float32(np.abs(even).max()))
    return even if told.shape == even.shape and np.abs(told - even).max() <= allowed else stamps


def _width(values: Array, columns: Columns) -> Array | None:
    if columns.width is not None:
        return values[:, columns.width]
    if columns.fingers:
        return np.asarray(2.0 * values[:, columns.fingers].mean(axis=1))
    return None
