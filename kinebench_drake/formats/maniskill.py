"""Trajectories of ManiSkill: an .h5 file of many, and a .json file beside it with their metadata.

The layout is that of mani_skill 3's wrapper that records episodes, a group for each; the state of an articulation is
the pose (7) and velocity (6) of its root, joint positions, joint velocities.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from kinebench_drake.errors import InputError
from kinebench_drake.formats.samples import MAX_PERIOD_S, MIN_PERIOD_S
from kinebench_drake.formats.trajectories.trajectory import TrajectoryFormat, TrajectorySample
from kinebench_drake.io.hdf5 import open_hdf5
from kinebench_drake.io.jsonl import as_number, as_object, as_type, read_object

DEFAULT_RATE_HZ = 20.0
"""Default control frequency of ManiSkill [Hz]."""

_UNKNOWN = f"task, seed and success are unknown, and {DEFAULT_RATE_HZ:g} Hz is assumed; $rate_hz HZ overrides it"
_TRAJECTORY = re.compile(r"traj_\d{1,9}", re.ASCII)


def list_maniskill(path: Path, video: str) -> list[TrajectorySample]:
    """List the trajectories of an .h5 file, called `video` in results, by their numbers, without reading them."""
    unread = TrajectorySample(id=path.stem, path=path, video=video, format=TrajectoryFormat.MANISKILL)
    try:
        with open_hdf5(path) as file:
            names = [name for name in map(str, file) if _TRAJECTORY.fullmatch(name)]
            content = ", ".join(map(str, list(file)[:8]))
    except InputError as error:
        return [replace(unread, problem=str(error))]
    if not names:
        return [replace(unread, problem=f"holds no trajectory traj_0, traj_1, ... but {content or 'nothing'}")]
    about, note = _read_metadata(path.with_suffix(".json"))
    info = as_object(about.get("env_info"))
    entries = map(as_object, as_type(about.get("episodes"), list) or [])
    by_id = {entry["episode_id"]: entry for entry in entries if isinstance(entry.get("episode_id"), int)}
    samples = []
    for number, name in sorted((int(name.removeprefix("traj_")), name) for name in names):
        episode = as_object(by_id.get(number))
        samples.append(
            TrajectorySample(
                id=f"{path.stem}-{name}",
                path=path,
                video=f"{video}#{name}",
                format=TrajectoryFormat.MANISKILL,
                part=name,
                rate_hz=_rate(about) or DEFAULT_RATE_HZ,
                task=as_type(info.get("env_id"), str),
                seed=as_type(episode.get("episode_seed"), int),
                success=as_type(episode.get("success"), bool),
                robot=as_type(as_object(info.get("env_kwargs")).get("robot_uids"), str),
                warnings=(note,) if note else (),
            )
        )
    return samples


def _read_metadata(path: Path) -> tuple[Mapping[str, object], str | None]:
    """Read the metadata beside a file; return them and a warning if they are missing or damaged."""
    try:
        return read_object(path), None
    except FileNotFoundError:
        return {}, f"{path.name} is not there: {_UNKNOWN}"
    except InputError as error:
        return {}, f"{error}: {_UNKNOWN}"


def _rate(about: Mapping[str, object]) -> float | None:
    """Return the control frequency by the metadata [Hz]."""
    info = as_object(about.get("env_info"))
    arguments = as_object(info.get("env_kwargs"))
    for place in (info, arguments, as_object(arguments.get("sim_config")), as_object(arguments.get("sim_cfg"))):
        rate_hz = as_number(place.get("control_freq"))
        if rate_hz is not None and 1.0 / MAX_PERIOD_S <= rate_hz <= 1.0 / MIN_PERIOD_S:
            return rate_hz
    return None
