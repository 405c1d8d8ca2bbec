"""LeRobot datasets v3.0: many demonstrations in a few parquet and mp4 files, with statistics of every feature.

The layout is that of LeRobot's own writer. An episode is a whole demonstration, in task time: frame k is at k times the
frame period, also in the video.
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

from kinebench_drake.errors import SetupError
from kinebench_drake.geometry import Array, to_quaternion
from kinebench_drake.io.atomic import atomic_path, disk_errors
from kinebench_drake.io.camerafile import save_camera
from kinebench_drake.io.container import join_videos, write_video
from kinebench_drake.io.jsonl import write_json
from kinebench_drake.io.npz import write_arrays
from kinebench_drake.suites.formats.demo import PARTS, Content, Demo, Record, RenderOptions

VERSION = "v3.0"
CAMERA = "observation.images.benchmark"
STATE, POSE, ACTION = "observation.state", "observation.tcp_pose", "action"
_JOINTS = [f"joint_{i}" for i in range(1, 8)]
VECTORS = {
    STATE: [*_JOINTS, "gripper_width"],
    POSE: ["x", "y", "z", "qw", "qx", "qy", "qz"],
    ACTION: [*_JOINTS, "gripper_width"],
}
"""Numeric columns and their elements: radians and metres, poses in the robot base frame."""
COUNTERS = {"timestamp": "float32", **dict.fromkeys(("frame_index", "episode_index", "index", "task_index"), "int64")}
"""Columns of every LeRobot dataset."""

_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
_DATA, _EPISODES = f"data/{_FILE}.parquet", f"meta/episodes/{_FILE}.parquet"
_VIDEO = f"videos/{{video_key}}/{_FILE}.mp4"
_DATA_FILES, _VIDEO_FILES = (_DATA, "data"), (_VIDEO, f"videos/{CAMERA}")  # patterns, and prefixes of keys in meta
_CHUNK_FILES, _DATA_MB, _VIDEO_MB = 1000, 100, 200
_KEYFRAME_EVERY = 10  # training reads single frames at random
_STRIDE_PX = 4  # of the pixels in image statistics, along both axes

Columns = dict[str, NDArray[Any]]


def _continuous(quaternions: Array) -> Array:
    """Return quaternions wxyz (T, 4) whose signs do not jump: q and -q are the same rotation.

    The first has the sign of a gripper that points down, (0, 1, 0, 0), every other one that of the frame before.
    """
    before = np.vstack([[0.0, 1.0, 0.0, 0.0], quaternions[:-1]])
    turns = np.cumsum(np.sum(quaternions * before, axis=1) < 0.0) % 2
    return np.asarray(quaternions * np.where(turns, -1.0, 1.0)[:, None])


class LeRobot:
    """Format of LeRobot datasets."""

    content = Content.VIDEO

    def part_files(self, folder: Path, record: Record) -> list[Path]:
        """Return columns, video and ground truth of a demonstration."""
        return [*_parts(folder, record.id), folder / "truth" / f"{record.id}.npz"]

    def write_part(self, folder: Path, demo: Demo) -> None:
        """Write columns, video and ground truth of a demonstration."""
        video, every = demo.video, demo.options.every
        if video is None:
            raise SetupError("a LeRobot dataset needs videos")
        columns_file, video_file = _parts(folder, demo.id)
        write_arrays(folder / "truth" / f"{demo.id}.npz", demo.truth())
        actions = demo.rollout.controls[every - 1 :: every]  # command until the next frame; the last frame repeats it
        quaternions = _continuous(np.stack([to_quaternion(X[:3, :3]) for X in video.X_BG]))
        pixels = video.rgb[:, ::_STRIDE_PX, ::_STRIDE_PX]
        columns = {
            STATE: np.column_stack([video.q, video.finger_width_m]).astype(np.float32),
            POSE: np.column_stack([video.X_BG[:, :3, 3], quaternions]).astype(np.float32),
            ACTION: np.concatenate([actions, actions[-1:]]).astype(np.float32),
            CAMERA: np.stack([np.bincount(pixels[..., c].ravel(), minlength=256) for c in range(3)]),
        }
        write_arrays(columns_file, columns)
        with disk_errors(video_file.name):
            write_video(video_file, video.rgb, demo.options.fps, crf=demo.options.crf, keyframe_every=_KEYFRAME_EVERY)

    def finish(
        self, folder: Path, records: Sequence[Record], options: RenderOptions, about: dict[str, Any]
    ) -> list[Path]:
        """Join the parts and write the metadata."""
        tasks = list(dict.fromkeys(record.prompt for record in records))
        columns, histograms = _columns(folder, records, options, tasks)
        data = _write_data(folder, columns)
        places = [a | b for a, b in zip(data, _join_videos(folder, records, columns, options), strict=True)]
        episodes = []
        for k, (record, own, histogram, place) in enumerate(zip(records, columns, histograms, places, strict=True)):
            features = feature_statistics([own], {CAMERA: [histogram]})
            stats = {f"stats/{name}/{kind}": value for name, kinds in features.items() for kind, value in kinds.items()}
            first, length = int(own["index"][0]), len(own["index"])
            description = {"episode_index": k, "tasks": [record.prompt], "length": length}
            rows = {"dataset_from_index": first, "dataset_to_index": first + length}
            file = {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0}
            episodes.append({**description, **rows, **place, **stats, **file})
        _write_table(folder / _EPISODES.format(chunk_index=0, file_index=0), [pa.Table.from_pylist(episodes)])
        _write_tasks(folder / "meta" / "tasks.parquet", tasks)
        write_json(folder / "meta" / "stats.json", feature_statistics(columns, {CAMERA: histograms}))
        write_json(folder / "meta" / "info.json", _info(options, columns, len(tasks)))
        save_camera(options.camera, folder / "meta" / "camera.json")
        return sorted({_path(folder, *file, place) for file in (_DATA_FILES, _VIDEO_FILES) for place in places})

    def index_files(self, folder: Path, tasks: Sequence[str]) -> list[Path]:
        """Return the files in `meta`."""
        names = ("tasks.parquet", "stats.json", "info.json", "camera.json")
        return [folder / _EPISODES.format(chunk_index=0, file_index=0), *(folder / "meta" / name for name in names)]


def _parts(folder: Path, id: str) -> tuple[Path, Path]:
    return folder / PARTS / f"{id}.npz", folder / PARTS / f"{id}.mp4"


def _columns(
    folder: Path, records: Sequence[Record], options: RenderOptions, tasks: Sequence[str]
) -> tuple[list[Columns], list[NDArray[Any]]]:
    """Return the columns of each episode and the histograms of its images."""
    columns, histograms, frames_before = [], [], 0
    for k, record in enumerate(records):
        with np.load(_parts(folder, record.id)[0]) as archive:
            own = {name: archive[name] for name in VECTORS}
            histograms.append(archive[CAMERA])
        frames = np.arange(len(own[STATE]))
        own["timestamp"] = (frames / options.fps).astype(np.float32)
        own |= {"frame_index": frames, "episode_index": np.full_like(frames, k), "index": frames + frames_before}
        own["task_index"] = np.full_like(frames, tasks.index(record.prompt))
        frames_before += len(frames)
        columns.append(own)
    return columns, histograms


def _write_data(folder: Path, columns: Sequence[Columns]) -> list[dict[str, int]]:
    """Write the columns of all episodes; return the file of each."""
    tables = [
        pa.table(
            {
                **{
                    name: pa.FixedSizeListArray.from_arrays(pa.array(own[name].ravel()), len(elements))
                    for name, elements in VECTORS.items()
                },
                **{name: pa.array(own[name], pa.type_for_alias(kind)) for name, kind in COUNTERS.items()},
            }
        )
        for own in columns
    ]
    places = _places("data", [table.nbytes for table in tables], _DATA_MB)
    paths = [_path(folder, *_DATA_FILES, place) for place in places]
    for path in dict.fromkeys(paths):
        _write_table(path, [table for table, own in zip(tables, paths, strict=True) if own == path])
    return places


def _join_videos(
    folder: Path, records: Sequence[Record], columns: Sequence[Columns], options: RenderOptions
) -> list[dict[str, int | float]]:
    """Join the videos of all episodes; return file, start and end of each."""
    key = f"videos/{CAMERA}"
    videos = [_parts(folder, record.id)[1] for record in records]
    places = _places(key, [video.stat().st_size for video in videos], _VIDEO_MB)
    joined: dict[Path, list[Path]] = {}
    lengths: Counter[Path] = Counter()
    parts = []
    for place, own, video in zip(places, columns, videos, strict=True):
        path = _path(folder, *_VIDEO_FILES, place)
        joined.setdefault(path, []).append(video)
        first = lengths[path]
        last = lengths[path] = first + len(own["index"])
        parts.append({**place, f"{key}/from_timestamp": first / options.fps, f"{key}/to_timestamp": last / options.fps})
    for path, own_videos in joined.items():
        with disk_errors(path.name):
            path.parent.mkdir(parents=True, exist_ok=True)
            join_videos(path, own_videos)
    return parts


def _places(key: str, sizes: Sequence[int], most_mb: int) -> list[dict[str, int]]:
    """Distribute items of these sizes [bytes] to chunks and files of at most `most_mb`."""
    places, number, filled = [], 0, 0
    for size in sizes:
        if filled and filled + size > most_mb * 2**20:
            number, filled = number + 1, 0
        filled += size
        chunk, file = divmod(number, _CHUNK_FILES)
        places.append({f"{key}/chunk_index": chunk, f"{key}/file_index": file})
    return places


def _path(folder: Path, pattern: str, key: str, place: Mapping[str, Any]) -> Path:
    """Return the file of a place from the pattern of its path and the prefix of its keys."""
    numbers = {name: place[f"{key}/{name}"] for name in ("chunk_index", "file_index")}
    return folder / pattern.format(video_key=CAMERA, **numbers)


def _write_table(path: Path, tables: Sequence[pa.Table]) -> None:
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
    _write_table(path, [table.replace_schema_metadata({"pandas": json.dumps(pandas)})])


def _info(options: RenderOptions, columns: Sequence[Columns], tasks: int) -> dict[str, Any]:
    """Return the description of the dataset."""
    rate, side = round(options.fps), options.size
    encoding = {
        "video.height": side + side % 2,
        "video.width": side + side % 2,
        "video.codec": "h264",
        "video.pix_fmt": "yuv420p",
        "video.is_depth_map": False,
        "video.fps": rate,
        "video.channels": 3,
        "has_audio": False,
    }
    image = {"dtype": "video", "shape": [encoding["video.height"], encoding["video.width"], 3], "info": encoding}
    return {
        "codebase_version": VERSION,
        "robot_type": "panda",
        "total_episodes": len(columns),
        "total_frames": sum(len(own["index"]) for own in columns),
        "total_tasks": tasks,
        "chunks_size": _CHUNK_FILES,
        "data_files_size_in_mb": _DATA_MB,
        "video_files_size_in_mb": _VIDEO_MB,
        "fps": rate,
        "splits": {"train": f"0:{len(columns)}"},
        "data_path": _DATA,
        "video_path": _VIDEO,
        "features": {
            CAMERA: {**image, "names": ["height", "width", "channels"]},
            **{
                name: {"dtype": "float32", "shape": [len(elements)], "names": elements}
                for name, elements in VECTORS.items()
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
    """Return statistics of images in 0..1, each (3, 1, 1), from the histograms of their channels.

    Args:
        counts: (3, 256) number of pixels of each value.
        frames: number of images.
    """
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
    """Return statistics of every feature over episodes.

    Args:
        rows: columns by name, one mapping per episode.
        histograms: histograms of each camera's images, one per episode.
    """
    frames = sum(len(next(iter(columns.values()))) for columns in rows)
    return {
        **{name: row_statistics(np.concatenate([columns[name] for columns in rows])) for name in rows[0]},
        **{name: histogram_statistics(np.sum(counts, axis=0), frames) for name, counts in histograms.items()},
    }
