"""What KineBench writes (https://github.com/minecraft-zzz/KineBench, revision b1f634a): runs and data set.

    RUN_20260101_120000/TASK-v1/0000/info.json           task, prompt, success, rollouts with the poses of each video
    RUN_20260101_120000/TASK-v1/0000/attempt_000/generated.mp4
    RUN_20260101_120000/TASK-v1/0000/trajectory.h5       executed poses; attribute format: kinebench_rollout_v1
    RUN_20260101_120000/TASK-v1/summary.csv              episode, done, success, error
    suite0/videos/videos/close_box_61/observation.images.base_camera.mp4

A video of `max_rollouts` attempts is one sample. Its poses are those of a CAD model of the hand in the robot's base
frame, executed with the TCP `eef_z_offset` further along z.
"""

import csv
import io
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from kinebench_drake.errors import InputError, UsageError, cause
from kinebench_drake.formats.trajectories.trajectory import (
    MAX_BYTES,
    ColumnTable,
    NumberColumn,
    TrajectoryFormat,
    TrajectorySample,
)
from kinebench_drake.formats.videos.sample import Search, VideoSample
from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.io.files import read_text
from kinebench_drake.io.hdf5 import open_hdf5, read_all
from kinebench_drake.io.jsonl import as_number, as_object, as_type, read_object
from kinebench_drake.results.inputs import BENCHMARK_PERIOD_S
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.track import MAX_WIDTH_M

INFO = "info.json"
SUMMARY = "summary.csv"
H5_FORMAT = "kinebench_rollout_v1"
_VIDEO = "observation.images.base_camera.mp4"
_STAMP = re.compile(r"_\d{8}_\d{6}")
_EPISODE = re.compile(r"\d{4,}", re.ASCII)
_CASE = re.compile(r"(?P<task>(?P<words>\w+?)(?:_(?P<version>v\d))?)_(?P<number>\d+)", re.ASCII)
_TASKS = {"pickfruits": "PickFruits-v1", "storefruitbox": "StoreFruitsBox-v1", "lift_peg": "LiftPegUpright-v1"}
"""Tasks whose names in the data set differ in more than spelling."""


def is_kinebench(folder: Path) -> bool:
    """Return whether a folder is an episode of a run or of the data set."""
    is_episode = bool(_EPISODE.fullmatch(folder.resolve().name)) and (folder / INFO).is_file()
    return is_episode or (bool(_CASE.fullmatch(folder.resolve().name)) and (folder / _VIDEO).is_file())


def list_kinebench(folder: Path, search: Search) -> list[VideoSample]:
    """List the generated videos of an episode, or the video of a case of the data set."""
    if case := _CASE.fullmatch(folder.resolve().name):
        words = "".join(word.capitalize() for word in case["words"].split("_"))
        task = _TASKS.get(case["task"], f"{words}-{case['version'] or 'v1'}")
        sample = replace(
            search.part_sample(folder / _VIDEO), id=case[0], dataset_period_s=BENCHMARK_PERIOD_S, task=task
        )
        return [replace(sample, seed=int(case["number"]))]
    info = read_object(folder / INFO)
    samples = []
    names = [folder.resolve().parents[1].name, folder.resolve().parent.name, folder.resolve().name]
    for rollout in map(as_object, as_type(info.get("rollouts"), list) or []):
        attempt = as_type(rollout.get("attempt_dir"), str) or ""
        video = folder / Path(attempt).name / "generated.mp4"
        labels = replace(
            search.part_sample(video),
            id="-".join([*names[1:], attempt]),
            task=as_type(info.get("env_id"), str),
            model=_STAMP.sub("", names[0]),
            prompt=as_type(info.get("prompt"), str),
            dataset_period_s=BENCHMARK_PERIOD_S,
            success=as_type(rollout.get("success"), bool),
            reference_X_BG=_executed_poses(as_object(rollout.get("action_meta"))),
        )
        missing = None if video.is_file() else f"{attempt} holds no generated.mp4: run with output.save_generated: true"
        samples.append(replace(labels, problem=missing))
    return samples


def _executed_poses(meta: Mapping[str, object]) -> Array | None:
    """Return the TCP poses (T, 4, 4) that were executed; None without valid poses."""
    try:
        pose7 = np.array(meta.get("pose7"), dtype=np.float64).reshape(-1, 7)
        X = make_pose(Rotation.from_quat(pose7[:, 3:], scalar_first=True).as_matrix(), pose7[:, :3])
    except (TypeError, ValueError):
        return None
    offset = np.array([0.0, 0.0, as_number(meta.get("eef_z_offset")) or 0.0])
    X[:, :3, 3] += offset if meta.get("eef_offset_frame") == "world" else X[:, :3, :3] @ offset
    return X


def is_run(folder: Path) -> bool:
    """Return whether a folder is a run: it holds tasks with episodes or summaries."""
    return any(folder.glob(f"*/[0-9]*/{INFO}")) or any(folder.glob(f"*/{SUMMARY}"))


def is_summary(path: Path) -> bool:
    """Return whether a file is the summary of a task of a run."""
    return path.name == SUMMARY and is_run(path.parent.parent)


def read_rows(folder: Path) -> list[SampleRow]:
    """Read the outcomes of a run: of each task from the info.json of its episodes, else from its summary.csv.

    Raises:
        UsageError: a file is damaged.
    """
    rows = []
    try:
        for task in sorted(path for path in folder.iterdir() if path.is_dir()):
            infos = [read_object(path) for path in sorted(task.glob(f"[0-9]*/{INFO}"))]
            if not infos and (task / SUMMARY).is_file():
                lines = csv.DictReader(io.StringIO(read_text(task / SUMMARY)))
                infos = [{**line, "success": (line.get("success") or "").lower() == "true"} for line in lines]
            rows += [_row(task, number, info) for number, info in enumerate(infos)]
    except (OSError, ValueError, csv.Error, InputError) as error:
        raise UsageError(f"{folder}: {cause(error) if isinstance(error, OSError) else error}") from None
    return rows


def _row(task: Path, number: int, info: Mapping[str, object]) -> SampleRow:
    seed = as_type(info.get("episode"), int)
    name = f"{task.name}-{number if seed is None else seed:04d}"
    error = as_type(info.get("error"), str) or None
    rounds = as_type(info.get("num_rollouts"), int)
    return SampleRow(
        id=name,
        video=name,
        task=as_type(info.get("env_id"), str) or task.name,
        model=_STAMP.sub("", task.resolve().parent.name),
        status=Status.ERROR if error else Status.OK,
        reason=error,
        content_hash="",
    ).extended(success=info.get("success") is True, rounds=rounds, seed=number if seed is None else seed)


def list_executed(file: h5py.File, path: Path, video: str) -> list[TrajectorySample]:
    """List the attempts of an open trajectory.h5, called `video` in results."""
    names = sorted((n for n in map(str, file) if n.startswith("traj_")), key=lambda n: (len(n), n))
    task, prompt = (str(file.attrs.get(name) or "") or None for name in ("env_id", "prompt"))
    about = TrajectorySample(
        id=path.stem,
        path=path,
        video=video,
        format=TrajectoryFormat.KINEBENCH,
        rate_hz=1.0 / BENCHMARK_PERIOD_S,
        task=task,
    )
    return [replace(about, id=f"{path.stem}-{n}", video=f"{video}#{n}", part=n, prompt=prompt) for n in names]


@contextmanager
def open_executed_table(sample: TrajectorySample) -> Iterator[ColumnTable]:
    """Open the commands of an attempt: TCP poses from x, y, z and Euler angles XYZ, and the label of the gripper.

    Raises:
        InputError: the file is damaged.
    """
    with open_hdf5(sample.path, f"{sample.part}/actions") as file:
        data = file[f"{sample.part}/actions"]
        if not isinstance(data, h5py.Dataset):
            raise InputError(f"{sample.part}/actions is a group, expected a data set")
        actions = np.asarray(read_all(data, MAX_BYTES), dtype=np.float64).reshape(-1, 7)
    arrays: dict[str, NDArray[np.generic]] = {
        "base_from_tcp": make_pose(Rotation.from_euler("XYZ", actions[:, 3:6]).as_matrix(), actions[:, :3]),
        "finger_width_m": np.where(actions[:, 6] > 0.0, MAX_WIDTH_M, 0.0),
    }
    columns = tuple(NumberColumn(name=name, size=array[0].size) for name, array in arrays.items())
    yield ColumnTable(columns=columns, load=arrays.__getitem__, rate_hz=sample.rate_hz)
