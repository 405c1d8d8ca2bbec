"""Trajectories of ManiSkill: an .h5 file of many, and a .json file beside it with their metadata.

The layout is that of mani_skill 3's `RecordEpisode` wrapper: groups `traj_K` with `obs`, `env_states`, `actions`,
`terminated`, `truncated` and `success`; the state of an articulation is the pose (7) and velocity (6) of its root,
joint positions, joint velocities. Files are written without `obs`, as with `obs_mode="none"`.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.formats.samples import MAX_PERIOD_S, MIN_PERIOD_S
from kinebench_drake.formats.trajectories.trajectory import TrajectoryFormat, TrajectorySample
from kinebench_drake.geometry import Array
from kinebench_drake.io.atomic import atomic_path
from kinebench_drake.io.hdf5 import open_hdf5
from kinebench_drake.io.jsonl import as_number, as_object, as_type, read_object, write_json
from kinebench_drake.io.npz import write_arrays

States = Mapping[str, Mapping[str, NDArray[np.float32]]]
"""A state of ManiSkill: arrays by the name of the object, by the kind of object."""

DEFAULT_RATE_HZ = 20.0
"""Default control frequency of ManiSkill [Hz]."""

CONTROL_MODE = "pd_joint_pos"

_STATES = "env_states"
_UNKNOWN = f"task, seed and success are unknown, and {DEFAULT_RATE_HZ:g} Hz is assumed; $rate_hz HZ overrides it"
_SOURCE = {"source_type": "motionplanning", "source_desc": "scripted expert, planned with Drake"}
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


def write_part(
    path: Path, actions: Array, states: Sequence[States], successes: Sequence[bool], *, truncated: bool
) -> None:
    """Write the arrays of one trajectory, named as in its group, to an npz file for `join_parts`.

    Args:
        actions: (N, 8) actions of `CONTROL_MODE`.
        states: N + 1 states.
        truncated: True if the last action is the last one allowed.
    """
    success = np.array(successes, dtype=bool)
    ends = np.zeros(len(actions), dtype=bool)
    ends[-1] = truncated
    arrays = {"actions": actions, "terminated": success, "truncated": ends, "success": success}
    parts = {
        f"{_STATES}/{kind}/{name}": np.stack([state[kind][name] for state in states])
        for kind, objects in states[0].items()
        for name in objects
    }
    write_arrays(path, {**arrays, **parts})


def join_parts(
    path: Path, parts: Sequence[Path], episodes: Sequence[Mapping[str, object]], environment: Mapping[str, object]
) -> None:
    """Write an .h5 file of successful trajectories and the .json file beside it.

    Args:
        path: the .h5 file.
        parts: files of `write_part`.
        episodes: `seed` of each trajectory, and further keys.
        environment: the .json file's `env_info`.
    """
    rows = []
    with atomic_path(path) as unfinished, h5py.File(unfinished, "w", libver="earliest") as file:
        for k, (part, episode) in enumerate(zip(parts, episodes, strict=True)):
            with np.load(part) as arrays:
                for name in arrays.files:
                    file.create_dataset(f"traj_{k}/{name}", data=arrays[name])
                steps = len(arrays["actions"])
            seed = episode["seed"]
            others = {key: value for key, value in episode.items() if key != "seed"}
            rows.append(
                {
                    "episode_id": k,
                    "episode_seed": seed,
                    "control_mode": CONTROL_MODE,
                    "elapsed_steps": steps,
                    "reset_kwargs": {"seed": seed, "options": {}},
                    "success": True,
                    **others,
                }
            )
    write_json(path.with_suffix(".json"), {"env_info": environment, "episodes": rows, **_SOURCE})
