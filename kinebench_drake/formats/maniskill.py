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

from kinebench_drake.errors import InputError, cause
from kinebench_drake.formats.samples import MAX_PERIOD_S, MIN_PERIOD_S
from kinebench_drake.formats.trajectories.check import MAX_FRAMES
from kinebench_drake.formats.trajectories.trajectory import (
    N_JOINTS,
    RawTrajectory,
    TrajectoryFormat,
    TrajectoryOptions,
    TrajectorySample,
)
from kinebench_drake.geometry import Array
from kinebench_drake.io.atomic import atomic_path
from kinebench_drake.io.hdf5 import DAMAGED, open_hdf5, read_all
from kinebench_drake.io.jsonl import as_number, as_object, as_type, read_object, write_json
from kinebench_drake.io.npz import write_arrays

States = Mapping[str, Mapping[str, NDArray[np.float32]]]
"""A state of ManiSkill: arrays by the name of the object, by the kind of object."""

DEFAULT_RATE_HZ = 20.0
"""Default control frequency of ManiSkill [Hz]."""

CONTROL_MODE = "pd_joint_pos"

_QPOS = "obs/agent/qpos"
_STATES = "env_states"
_ARTICULATIONS = f"{_STATES}/articulations"
_MAX_BYTES = 2**28
_SOURCE = {"source_type": "motionplanning", "source_desc": "scripted expert, planned with Drake"}
_ROOT = 13  # elements of an articulation's state before its joints
_TRAJECTORY = re.compile(r"traj_\d{1,9}", re.ASCII)
_ROBOT = re.compile(r"panda|franka|fr3", re.IGNORECASE)


def list_maniskill(path: Path, video: str) -> list[TrajectorySample]:
    """List the trajectories of an .h5 file, called `video` in results, by their numbers, without reading them."""
    unread = TrajectorySample(id=path.stem, path=path, video=video, format=TrajectoryFormat.MANISKILL)
    try:
        with open_hdf5(path) as file:
            names = [name for name in map(str, file) if _TRAJECTORY.fullmatch(name)]
            content = ", ".join(map(str, list(file)[:8]))
    except DAMAGED as error:
        return [replace(unread, problem=cause(error))]
    if not names:
        return [replace(unread, problem=f"holds no trajectory traj_0, traj_1, ... but {content or 'nothing'}")]
    about, note = _read_metadata(path.with_suffix(".json"))
    info, episodes = as_object(about.get("env_info")), about.get("episodes")
    entries = map(as_object, episodes if isinstance(episodes, list) else [])
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
                rate_hz=_rate(about),
                task=as_type(info.get("env_id"), str),
                seed=as_type(episode.get("episode_seed"), int),
                success=as_type(episode.get("success"), bool),
                warnings=(note,) if note else (),
            )
        )
    return samples


def read_maniskill(sample: TrajectorySample, choice: TrajectoryOptions) -> RawTrajectory:
    """Read the robot's joints of one trajectory: the data set that `choice` names, else obs/agent/qpos, else its state.

    Raises:
        InputError: the file is damaged, or holds no robot's joints.
    """
    if choice.poses is not None:
        raise InputError(
            "poses of a ManiSkill file are in its world frame, not in the robot's: only its joint angles are read "
            "($joints names their data set)"
        )
    group = str(sample.part)
    try:
        with open_hdf5(sample.path) as file:
            trajectory = file[group]
            if not isinstance(trajectory, h5py.Group):
                raise InputError(f"{group} is a data set, expected a group of them")
            name = choice.joints or _find_joints(trajectory)
            data = trajectory.get(name)
            if not isinstance(data, h5py.Dataset):
                raise InputError(f"{group} holds no data set {name!r}, but {_list_data_sets(trajectory)}")
            if data.file.filename != file.filename:
                raise InputError(f"{group}/{name} is a link to another file, which is not read")
            if data.dtype.kind not in "iuf":
                raise InputError(f"{group}/{name} holds {data.dtype}, expected real numbers")
            if data.shape and data.shape[0] > MAX_FRAMES:
                raise InputError(f"has {data.shape[0]} frames, at most {MAX_FRAMES} are accepted: cut it into parts")
            values = read_all(data, _MAX_BYTES)
    except DAMAGED as error:
        raise InputError(f"{group} cannot be read ({cause(error)})") from None
    columns, first = f"{group}/{name}", 0
    if name.startswith(_ARTICULATIONS):
        values, first = _joints_of_state(values, columns), _ROOT
    if values.ndim != 2:
        raise InputError(f"{columns} has shape {values.shape}, expected (T, 7) to (T, 9)")
    fingers = values[:, N_JOINTS:].sum(axis=1) if values.shape[1] == N_JOINTS + 2 else None
    values = values if fingers is None else values[:, :N_JOINTS]
    assumed = sample.rate_hz is None and choice.rate_hz is None
    warning = (
        f"control_freq is missing: ManiSkill's default of {DEFAULT_RATE_HZ:g} Hz is used; $rate_hz HZ overrides it"
    )
    return RawTrajectory(
        t_s=np.arange(len(values)) / (sample.rate_hz or DEFAULT_RATE_HZ),
        q=values,
        finger_width_m=fingers,
        columns=f"{columns}[:, {first}:{first + values.shape[1]}]",
        warnings=(warning,) if assumed else (),
    )


def _find_joints(trajectory: h5py.Group) -> str:
    """Return the name of the data set that holds the robot's joints."""
    if isinstance(trajectory.get(_QPOS), h5py.Dataset):
        return _QPOS
    articulations = trajectory.get(_ARTICULATIONS)
    names = list(articulations) if isinstance(articulations, h5py.Group) else []
    robots = [name for name in map(str, names) if _ROBOT.search(name)]
    if len(robots) == 1:
        return f"{_ARTICULATIONS}/{robots[0]}"
    if robots:
        raise InputError(f"holds {len(robots)} robots: $joints {_ARTICULATIONS}/{robots[0]} names one of them")
    raise InputError(
        f"holds {_list_data_sets(trajectory)}, expected {_QPOS} or {_ARTICULATIONS}/panda...; record it with "
        "observations or states, or name the data set by $joints"
    )


def _joints_of_state(state: NDArray[np.generic], name: str) -> NDArray[np.generic]:
    """Return the joint positions (T, n) from the states of an articulation (T, 13 + 2 n)."""
    if state.ndim != 2 or state.shape[1] <= _ROOT or (state.shape[1] - _ROOT) % 2:
        raise InputError(f"{name} has shape {state.shape}, expected (T, {_ROOT} + 2 x joints)")
    return state[:, _ROOT : _ROOT + (state.shape[1] - _ROOT) // 2]


def _list_data_sets(trajectory: h5py.Group) -> str:
    names: list[str] = []
    trajectory.visititems(lambda name, item: names.append(str(name)) if isinstance(item, h5py.Dataset) else None)
    return ", ".join(names[:10]) + (", ..." if len(names) > 10 else "") if names else "nothing"


def _read_metadata(path: Path) -> tuple[Mapping[str, object], str | None]:
    """Read the metadata beside a file; return them and a warning if they are missing or damaged."""
    try:
        return read_object(path), None
    except FileNotFoundError:
        return {}, f"{path.name} is not there: task, seed and success are unknown"
    except InputError as error:
        return {}, f"{error}: task, seed and success are unknown"


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
        path: the npz file.
        actions: (N, 8) actions of `CONTROL_MODE`.
        states: N + 1 states.
        successes: success after each action.
        truncated: True if the last action is the last one allowed.
    """
    success = np.array(successes, dtype=bool)
    ends = np.zeros(len(actions), dtype=bool)
    ends[-1] = truncated
    arrays = {"actions": actions, "terminated": success, "truncated": ends, "success": success}
    for kind, objects in states[0].items():
        for name in objects:
            arrays[f"{_STATES}/{kind}/{name}"] = np.stack([state[kind][name] for state in states])
    write_arrays(path, arrays)


def join_parts(
    path: Path, parts: Sequence[Path], episodes: Sequence[Mapping[str, object]], environment: Mapping[str, object]
) -> None:
    """Write an .h5 file of successful trajectories and the .json file beside it.

    Args:
        path: the .h5 file.
        parts: files of `write_part`.
        episodes: `seed` of each trajectory, and further keys.
        environment: the .json file's `env_info`.

    Raises:
        SetupError: writing failed.
    """
    rows = []
    with atomic_path(path) as unfinished, h5py.File(unfinished, "w", libver="earliest") as file:
        for k, (part, episode) in enumerate(zip(parts, episodes, strict=True)):
            with np.load(part) as arrays:
                for name in arrays.files:
                    file.create_dataset(f"traj_{k}/{name}", data=arrays[name])
                steps = len(arrays["actions"])
            seed, others = episode["seed"], {key: value for key, value in episode.items() if key != "seed"}
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
    about = {"env_info": environment, "episodes": rows, **_SOURCE}
    write_json(path.with_suffix(".json"), about)
