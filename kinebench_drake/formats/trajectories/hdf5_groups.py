"""Tables in HDF5 files: an episode per group (robomimic, LIBERO, ManiSkill), or one file per episode (ALOHA, DROID)."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np

from kinebench_drake.errors import InputError
from kinebench_drake.formats.kinebench import H5_FORMAT, list_executed
from kinebench_drake.formats.maniskill import list_maniskill
from kinebench_drake.formats.trajectories.column_table import ColumnTable, NumberColumn
from kinebench_drake.formats.trajectories.trajectory import MAX_BYTES, N_JOINTS, TrajectoryFormat, TrajectorySample
from kinebench_drake.io.hdf5 import open_hdf5, read_all
from kinebench_drake.io.jsonl import as_number, as_object, parse_json

_EPISODE = re.compile(r"(?:data/)?(?:demo|episode)_(?P<number>\d{1,9})", re.ASCII)
_STATES = "env_states/articulations/"
_ROBOT = re.compile(r"panda|franka|fr3", re.IGNORECASE)
_ROOT = 13  # numbers of an articulation's state before its joints: pose (7) and velocity (6) of its root


def list_hdf5_trajectories(path: Path, video: str) -> list[TrajectorySample]:
    """List the episodes of a file, called `video` in results, by their numbers, without reading them."""
    whole = TrajectorySample(id=path.stem, path=path, video=video, format=TrajectoryFormat.HDF5)
    try:
        with open_hdf5(path) as file:
            if file.attrs.get("format") == H5_FORMAT:
                return list_executed(file, path, video)
            if any(name.startswith("traj_") for name in map(str, file)):
                return list_maniskill(path, video)
            data = file.get("data")
            below = list(map(str, file))
            if isinstance(data, h5py.Group):
                below = [f"data/{name}" for name in data]
                whole = replace(whole, rate_hz=_rate(data.attrs.get("env_args")))
    except InputError as error:
        return [replace(whole, problem=str(error))]
    episodes = sorted((int(match["number"]), name) for name in below if (match := _EPISODE.fullmatch(name)))
    names = [(name, name.rpartition("/")[2]) for _, name in episodes]
    return [replace(whole, id=f"{path.stem}-{own}", video=f"{video}#{own}", part=name) for name, own in names] or [
        whole
    ]


@contextmanager
def open_hdf5_table(sample: TrajectorySample) -> Iterator[ColumnTable]:
    """Open an episode. Data sets in other files are not read.

    Raises:
        InputError: the file is damaged.
    """
    group = sample.part or "/"
    with open_hdf5(sample.path, group) as file:
        episode = file[group]
        if not isinstance(episode, h5py.Group):
            raise InputError(f"{group} is a data set, expected a group of them")
        columns: list[NumberColumn] = []

        def visit(name: str, item: object) -> None:  # names that are not valid text come as bytes
            if isinstance(name, str) and isinstance(item, h5py.Dataset) and (column := _column(name, item)):
                columns.append(column)

        episode.visititems(visit)
        robots = [c.name for c in columns if c.name.startswith(_STATES) and c.names]
        others = [c.name for c in columns if c.name.startswith(("next_obs/", "actions"))]
        yield ColumnTable(
            columns=tuple(columns),
            load=lambda name: read_all(episode[name], MAX_BYTES),
            rate_hz=sample.rate_hz,
            optional=frozenset([*others, *(robots if len(robots) > 1 else ())]),
        )


def _column(name: str, data: h5py.Dataset) -> NumberColumn | None:
    """Return the column of a data set with a row per frame; that of a robot's state in ManiSkill names its joints."""
    if data.dtype.kind not in "iufb" or not data.shape or len(data.shape) > 3:
        return None
    size = int(np.prod(data.shape[1:]))
    joints, rest = divmod(size - _ROOT, 2)
    if name.startswith(_STATES) and _ROBOT.search(name) and joints >= N_JOINTS and not rest:
        fingers = [f"finger_joint_{k}" for k in range(1, joints - N_JOINTS + 1)]
        root = [f"root_{k}" for k in range(_ROOT)]
        rates = [f"rate_{k}" for k in range(joints)]
        return NumberColumn(name=name, size=size, names=(*root, *(f"joint_{k}" for k in range(1, 8)), *fingers, *rates))
    return NumberColumn(name=name, size=size) if size <= 256 else None  # numbers of a frame; more are images


def _rate(env_args: object) -> float | None:
    """Return the control frequency in the attributes of robomimic's files [Hz]."""
    try:
        about = as_object(parse_json(str(env_args)))
    except ValueError:
        return None
    return as_number(as_object(about.get("env_kwargs")).get("control_freq"))
