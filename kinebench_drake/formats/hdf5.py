"""HDF5 files as videos and as trajectories.

An episode is a group (demo_K of robomimic and LIBERO, traj_K of ManiSkill), or the whole file (ALOHA, RoboTwin, DROID).
The JSON file beside a ManiSkill file gives task, seeds and the control frequency, which is the frame rate.
"""

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
from kinebench_drake.formats.trajectories.trajectory import (
    MAX_BYTES,
    N_JOINTS,
    ColumnTable,
    NumberColumn,
    TrajectoryFormat,
    TrajectorySample,
)
from kinebench_drake.formats.videos.sample import Search, VideoSample
from kinebench_drake.io.hdf5 import list_hdf5_videos, open_hdf5, read_all
from kinebench_drake.io.jsonl import as_number, as_object, parse_json
from kinebench_drake.io.video import VideoPart

_EPISODE = re.compile(r"(?P<episode>(?:data/)?(?:demo|traj|episode)_\d+)/(?P<camera>.+)")


def list_hdf5(path: Path, search: Search) -> list[VideoSample]:
    """List the episodes of a file, one camera of each."""
    episodes: dict[str, dict[str, str]] = {}
    for name in list_hdf5_videos(path):
        match = _EPISODE.fullmatch(name)
        episode, camera = (match["episode"], match["camera"]) if match else ("", name)
        episodes.setdefault(episode, {})[camera] = name
    key = search.choose_camera(list(dict.fromkeys(key for videos in episodes.values() for key in videos)), path.name)
    # the metadata of ManiSkill's trajectories, by their group
    listed = list_maniskill(path, path.name) if any(name.startswith("traj_") for name in episodes) else []
    metadata = {sample.part: sample for sample in listed if sample.problem is None}
    sample = search.part_sample(path)
    samples = []
    for episode, videos in episodes.items():
        about = metadata.get(episode)
        part = episode.rpartition("/")[2]
        samples.append(
            replace(
                sample,
                id=f"{path.stem}-{part}" if part else path.stem,
                part=VideoPart(key=videos.get(key, key)),
                video=f"{path.name}#{part or key}",
                camera_key=key,
                task=about.task if about else None,
                seed=about.seed if about else None,
                dataset_period_s=1.0 / about.rate_hz if about and about.rate_hz else None,
                problem=None if key in videos else f"{episode} has no video {key}, but {', '.join(videos)}",
            )
        )
    return samples


_GROUP = re.compile(r"(?:data/)?(?:demo|episode)_(?P<number>\d{1,9})", re.ASCII)
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
    episodes = sorted((int(match["number"]), name) for name in below if (match := _GROUP.fullmatch(name)))
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
