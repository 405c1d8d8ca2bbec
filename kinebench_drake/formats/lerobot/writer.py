"""Writer of LeRobot datasets v3.0: many episodes in a few parquet and mp4 files, with statistics of every feature.

The layout is that of LeRobot's own writer. Each episode is first written to files of its own, its parts, which are
joined at the end. Frame k of an episode is at k / fps, also in the video.
"""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.formats.camerafile import CAMERA_NAME, save_camera
from kinebench_drake.formats.lerobot.dataset import (
    DATA,
    EPISODE,
    EPISODES,
    FRAME,
    INFO,
    PLACE,
    SPAN,
    TIME,
    VIDEO,
)
from kinebench_drake.geometry import Array, to_quaternion
from kinebench_drake.io.atomic import atomic_path
from kinebench_drake.io.container import join_videos, write_video
from kinebench_drake.io.jsonl import write_json
from kinebench_drake.io.npz import write_arrays

VERSION = "v3.0"
CAMERA = "observation.images.benchmark"
STATE = "observation.state"
POSE = "observation.tcp_pose"
ACTION = "action"
_JOINTS = [f"joint_{i}" for i in range(1, 8)]
_POSE = ["x", "y", "z", "qw", "qx", "qy", "qz"]
STATES: Mapping[str, Sequence[str]] = {
    STATE: [*_JOINTS, "gripper_width"],
    POSE: _POSE,
    ACTION: [*_JOINTS, "gripper_width"],
}
"""Columns of a recording and their elements: radians and metres, poses in the robot base frame."""
POSE_ACTION = "pose_action"
DELTA_ACTION = "delta_action"
CONFIDENCE = "confidence"
USABLE = "usable"
GRIPPER_KNOWN = "gripper_known"
ESTIMATES: Mapping[str, Sequence[str]] = {
    **STATES,
    POSE_ACTION: [*_POSE, "gripper_width"],
    DELTA_ACTION: ["dx", "dy", "dz", "rx", "ry", "rz", "gripper_width"],
    CONFIDENCE: [CONFIDENCE],
    USABLE: [USABLE],
    GRIPPER_KNOWN: [GRIPPER_KNOWN],
}
"""Columns of an episode whose motion was estimated from its video."""
COUNTERS = {TIME: "float32", **dict.fromkeys((FRAME, EPISODE, "index", "task_index"), "int64")}
"""Columns of every LeRobot dataset."""

_CHUNK_FILES = 1000
_DATA_MB = 100
_VIDEO_MB = 200

Columns = dict[str, NDArray[Any]]


def part_files(parts: Path, id: str) -> tuple[Path, Path]:
    """Return the files of an episode's columns and of its video in a folder of parts."""
    return parts / f"{id}.npz", parts / f"{id}.mp4"


def write_part(
    parts: Path, id: str, rgb: NDArray[np.uint8], columns: Mapping[str, NDArray[Any]], *, fps: float, crf: int
) -> None:
    """Write the parts of an episode of T frames to a folder.

    Args:
        rgb: (T, H, W, 3) video.
        columns: (T, n) or (T,) numbers or booleans by the name of the column.
        fps: frames per second [1/s].
        crf: quality of x264.
    """
    columns_file, video_file = part_files(parts, id)
    pixels = rgb[:, ::4, ::4]  # for the statistics of images
    histograms = np.stack([np.bincount(pixels[..., c].ravel(), minlength=256) for c in range(3)])
    own = {name: values if values.dtype == bool else values.astype(np.float32) for name, values in columns.items()}
    write_arrays(columns_file, {**own, CAMERA: histograms})
    write_video(video_file, rgb, fps, crf=crf, keyframe_every=10)  # training reads single frames at random


def pose_columns(X_BG: Array) -> Array:
    """Return x, y, z [m] and a quaternion of poses (T, 4, 4), as a column (T, 7)."""
    return np.column_stack([X_BG[:, :3, 3], make_continuous(np.stack([to_quaternion(X[:3, :3]) for X in X_BG]))])


def make_continuous(quaternions: Array) -> Array:
    """Return quaternions wxyz (T, 4) whose signs do not jump: q and -q are the same rotation.

    The first has the sign of a gripper that points down, (0, 1, 0, 0), every other one that of the frame before.
    """
    before = np.vstack([[0.0, 1.0, 0.0, 0.0], quaternions[:-1]])
    turns = np.cumsum(np.sum(quaternions * before, axis=1) < 0.0) % 2
    return np.asarray(quaternions * np.where(turns, -1.0, 1.0)[:, None])


def join_parts(
    folder: Path,
    parts: Path,
    prompts: Mapping[str, str],
    fps: float,
    camera: Camera | None,
    *,
    size: tuple[int, int],
    features: Mapping[str, Sequence[str]] = STATES,
) -> list[Path]:
    """Join the parts of all episodes in a dataset, and write its metadata; return the files of data and videos.

    Args:
        prompts: instruction of each episode by the name of its parts.
        fps: frames per second, a whole number [1/s].
        camera: camera of the videos; None: they have several, or it is unknown.
        size: width and height of the videos [px].
    """
    tasks = list(dict.fromkeys(prompts.values()))
    columns, histograms = _read_columns(parts, prompts, fps, tasks, features)
    tables = [_table(own, features) for own in columns]
    videos = [part_files(parts, id)[1] for id in prompts]
    data_places = _places([table.nbytes for table in tables], _DATA_MB)
    video_places = _places([video.stat().st_size for video in videos], _VIDEO_MB)
    data_files = [folder / DATA.format(**place) for place in data_places]
    video_files = [folder / VIDEO.format(video_key=CAMERA, **place) for place in video_places]
    for path in dict.fromkeys(data_files):
        _write_tables(path, [table for table, file in zip(tables, data_files, strict=True) if file == path])
    for path in dict.fromkeys(video_files):
        join_videos(path, [video for video, file in zip(videos, video_files, strict=True) if file == path])
    episodes = []
    frames = Counter[Path]()
    for k, (prompt, own) in enumerate(zip(prompts.values(), columns, strict=True)):
        index = own["index"]
        begin = frames[video_files[k]]
        end = frames[video_files[k]] = begin + len(index)
        span = zip(SPAN, (begin / fps, end / fps), strict=True)
        statistics = feature_statistics([own], {CAMERA: [histograms[k]]})
        episodes.append(
            {
                EPISODE: k,
                "tasks": [prompt],
                "length": len(index),
                "dataset_from_index": int(index[0]),
                "dataset_to_index": int(index[0]) + len(index),
                **_below("data", data_places[k]),
                **_below(f"videos/{CAMERA}", {**video_places[k], **dict(span)}),
                **_below(
                    "stats", {f"{name}/{kind}": x for name, kinds in statistics.items() for kind, x in kinds.items()}
                ),
                **_below("meta/episodes", dict.fromkeys(PLACE, 0)),
            }
        )
    meta = folder / "meta"
    _write_tables(folder / EPISODES.format(**dict.fromkeys(PLACE, 0)), [pa.Table.from_pylist(episodes)])
    _write_tasks(meta / "tasks.parquet", tasks)
    write_json(meta / "stats.json", feature_statistics(columns, {CAMERA: histograms}))
    write_json(meta / INFO.name, _info(size, round(fps), columns, len(tasks), features))
    if camera is not None:
        save_camera(camera, meta / CAMERA_NAME)
    return sorted({*data_files, *video_files})


def _read_columns(
    parts: Path, prompts: Mapping[str, str], fps: float, tasks: Sequence[str], features: Mapping[str, Sequence[str]]
) -> tuple[list[Columns], list[NDArray[Any]]]:
    """Return the columns of each episode and the histograms of its images."""
    columns = []
    histograms = []
    frames_before = 0
    for k, (id, prompt) in enumerate(prompts.items()):
        with np.load(part_files(parts, id)[0]) as archive:
            own = {name: archive[name] for name in features}
            histograms.append(archive[CAMERA])
        frames = np.arange(len(own[STATE]))
        own |= {TIME: (frames / fps).astype(np.float32), FRAME: frames, EPISODE: np.full_like(frames, k)}
        own |= {"index": frames + frames_before, "task_index": np.full_like(frames, tasks.index(prompt))}
        frames_before += len(frames)
        columns.append(own)
    return columns, histograms


def _table(columns: Columns, features: Mapping[str, Sequence[str]]) -> pa.Table:
    vectors = {
        name: pa.array(columns[name].ravel())
        if len(elements) == 1
        else pa.FixedSizeListArray.from_arrays(pa.array(columns[name].ravel()), len(elements))
        for name, elements in features.items()
    }
    return pa.table(
        {**vectors, **{name: pa.array(columns[name], pa.type_for_alias(t)) for name, t in COUNTERS.items()}}
    )


def _places(sizes: Sequence[int], most_mb: int) -> list[dict[str, int]]:
    """Return chunk and file of each of some items of these sizes [bytes], with at most `most_mb` in a file."""
    places = []
    number = 0
    filled = 0
    for size in sizes:
        if filled and filled + size > most_mb * 2**20:
            number = number + 1
            filled = 0
        filled += size
        places.append(dict(zip(PLACE, divmod(number, _CHUNK_FILES), strict=True)))
    return places


def _below(prefix: str, values: Mapping[str, Any]) -> dict[str, Any]:
    return {f"{prefix}/{key}": value for key, value in values.items()}


def _write_tables(path: Path, tables: Sequence[pa.Table]) -> None:
    """Write tables to one file, each as a row group."""
    with atomic_path(path) as part, pq.ParquetWriter(part, tables[0].schema) as writer:
        for table in tables:
            writer.write_table(table)


def _write_tasks(path: Path, tasks: Sequence[str]) -> None:
    """Write prompts and their numbers; the prompts are pandas' index, as LeRobot's loader expects."""
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), "task": pa.array(tasks, pa.string())})
    columns = [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": own, "metadata": None}
        for name, kind, own in (("task_index", "int64", "int64"), ("task", "unicode", "object"))
    ]
    pandas = {"index_columns": ["task"], "column_indexes": [], "columns": columns, "pandas_version": "2.0.0"}
    _write_tables(path, [table.replace_schema_metadata({"pandas": json.dumps(pandas)})])


def _info(
    size: tuple[int, int], fps: int, columns: Sequence[Columns], tasks: int, features: Mapping[str, Sequence[str]]
) -> dict[str, Any]:
    """Return the description of the dataset."""
    width, height = (side + side % 2 for side in size)
    encoding = {
        "video.height": height,
        "video.width": width,
        "video.codec": "h264",
        "video.pix_fmt": "yuv420p",
        "video.is_depth_map": False,
        "video.fps": fps,
        "video.channels": 3,
        "has_audio": False,
    }
    image = {"dtype": "video", "shape": [height, width, 3], "info": encoding}
    return {
        "codebase_version": VERSION,
        "robot_type": "panda",
        "total_episodes": len(columns),
        "total_frames": sum(len(own["index"]) for own in columns),
        "total_tasks": tasks,
        "chunks_size": _CHUNK_FILES,
        "data_files_size_in_mb": _DATA_MB,
        "video_files_size_in_mb": _VIDEO_MB,
        "fps": fps,
        "splits": {"train": f"0:{len(columns)}"},
        "data_path": DATA,
        "video_path": VIDEO,
        "features": {
            CAMERA: {**image, "names": ["height", "width", "channels"]},
            **{
                name: {"dtype": str(columns[0][name].dtype), "shape": [len(elements)], "names": list(elements)}
                for name, elements in features.items()
            },
            **{name: {"dtype": kind, "shape": [1], "names": None} for name, kind in COUNTERS.items()},
        },
    }


QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
"""Quantiles by name."""


def row_statistics(values: NDArray[Any]) -> dict[str, list[float] | list[int]]:
    """Return statistics of each element of the rows (N, d) or of the numbers (N,)."""
    rows = np.asarray(values, dtype=np.float64).reshape(len(values), -1)
    moments = {"min": rows.min(axis=0), "max": rows.max(axis=0), "mean": rows.mean(axis=0), "std": rows.std(axis=0)}
    quantiles = {name: np.quantile(rows, share, axis=0) for name, share in QUANTILES.items()}
    return {**{name: value.tolist() for name, value in (moments | quantiles).items()}, "count": [len(rows)]}


def histogram_statistics(counts: NDArray[Any], frames: int) -> dict[str, Any]:
    """Return statistics of `frames` images in 0..1, each (3, 1, 1), from the histograms (3, 256) of their channels."""
    level = np.arange(256) / 255.0
    total = counts.sum(axis=1, keepdims=True)
    mean = (counts * level).sum(axis=1) / total[:, 0]
    present = counts > 0
    ranks = np.cumsum(counts, axis=1) / total
    moments = {
        "min": level[present.argmax(axis=1)],
        "max": level[255 - present[:, ::-1].argmax(axis=1)],
        "mean": mean,
        "std": np.sqrt((counts * (level - mean[:, None]) ** 2).sum(axis=1) / total[:, 0]),
    }
    quantiles = {name: level[(ranks >= share).argmax(axis=1)] for name, share in QUANTILES.items()}
    statistics = {name: [[[float(x)]] for x in values] for name, values in (moments | quantiles).items()}
    return {**statistics, "count": [frames]}


def feature_statistics(
    rows: Sequence[Mapping[str, NDArray[Any]]], histograms: Mapping[str, Sequence[NDArray[Any]]]
) -> dict[str, dict[str, Any]]:
    """Return statistics of every feature over episodes: of the columns of each, and of the histograms of its images."""
    frames = sum(len(next(iter(columns.values()))) for columns in rows)
    return {
        **{name: row_statistics(np.concatenate([columns[name] for columns in rows])) for name in rows[0]},
        **{name: histogram_statistics(np.sum(counts, axis=0), frames) for name, counts in histograms.items()},
    }
