"""LeRobot datasets, v3.0: many demonstrations in a few parquet and mp4 files, with statistics of every feature.

The layout is that of LeRobot's own writer. An episode is a whole demonstration; its clock is the task's: frame k is at
k times the frame period, also in the film.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from kinebench_drake.errors import SetupError
from kinebench_drake.geometry import to_quaternion
from kinebench_drake.io.atomic import atomic_path, disk_errors
from kinebench_drake.io.camerafile import save_camera
from kinebench_drake.io.container import join_videos, write_video
from kinebench_drake.io.jsonl import write_json
from kinebench_drake.io.npz import write_arrays
from kinebench_drake.suites.formats.demo import PARTS, Content, Demo, Record, Shots

QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
"""Quantiles by name."""


def of_rows(values: NDArray[Any]) -> dict[str, list[float] | list[int]]:
    """Statistics of each element of the rows (N, d) or of the numbers (N,)."""
    rows = np.asarray(values, dtype=np.float64).reshape(len(values), -1)
    moments = {"min": rows.min(axis=0), "max": rows.max(axis=0), "mean": rows.mean(axis=0), "std": rows.std(axis=0)}
    quantiles = {name: np.quantile(rows, share, axis=0) for name, share in QUANTILES.items()}
    return {**{name: found.tolist() for name, found in (moments | quantiles).items()}, "count": [len(rows)]}


def of_histograms(counts: NDArray[Any], frames: int) -> dict[str, Any]:
    """Statistics of pictures in 0..1, each (3, 1, 1), from how often (3, 256) each channel has each of its values.

    Args:
        counts: the histograms.
        frames: pictures that they are of.
    """
    level = np.arange(256) / 255.0
    total = counts.sum(axis=1, keepdims=True)
    mean = (counts * level).sum(axis=1) / total[:, 0]
    seen = counts > 0
    ranks = np.cumsum(counts, axis=1) / total
    moments = {
        "min": level[seen.argmax(axis=1)],
        "max": level[255 - seen[:, ::-1].argmax(axis=1)],
        "mean": mean,
        "std": np.sqrt((counts * (level - mean[:, None]) ** 2).sum(axis=1) / total[:, 0]),
    }
    quantiles = {name: level[(ranks >= share).argmax(axis=1)] for name, share in QUANTILES.items()}
    found = {name: [[[float(x)]] for x in values] for name, values in (moments | quantiles).items()}
    return {**found, "count": [frames]}


def of_features(
    rows: Sequence[Mapping[str, NDArray[Any]]], histograms: Mapping[str, Sequence[NDArray[Any]]]
) -> dict[str, dict[str, Any]]:
    """Statistics of every feature over some episodes.

    Args:
        rows: columns by name, one mapping an episode.
        histograms: those of each camera's pictures, one an episode.
    """
    frames = sum(len(next(iter(columns.values()))) for columns in rows)
    told = {name: of_rows(np.concatenate([columns[name] for columns in rows])) for name in rows[0]}
    return {
        **told,
        **{name: of_histograms(np.sum(counts, axis=0), frames) for name, counts in histograms.items()},
    }


VERSION = "v3.0"
CAMERA = "observation.images.benchmark"
STATE, POSE, ACTION = "observation.state", "observation.tcp_pose", "action"
_JOINTS = [f"joint_{i}" for i in range(1, 8)]
VECTORS = {
    STATE: [*_JOINTS, "gripper_width"],
    POSE: ["x", "y", "z", "qw", "qx", "qy", "qz"],
    ACTION: [*_JOINTS, "gripper_width"],
}
"""Columns of numbers and what their elements are: radians and metres, poses in the robot's base frame."""
COUNTERS = {"timestamp": "float32", **dict.fromkeys(("frame_index", "episode_index", "index", "task_index"), "int64")}
"""Columns that every LeRobot dataset has."""

_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
_DATA, _EPISODES = f"data/{_FILE}.parquet", f"meta/episodes/{_FILE}.parquet"
_VIDEO = f"videos/{{video_key}}/{_FILE}.mp4"
_CHUNK_FILES, _DATA_MB, _VIDEO_MB = 1000, 100, 200
_KEYFRAME_EVERY = 10  # training reads single frames from anywhere
_THINNED = 4  # of so many pixels, both ways, one counts in the pictures' statistics

Columns = dict[str, NDArray[Any]]


class LeRobot:
    """See the module."""

    content = Content.FILM

    def part_files(self, folder: Path, record: Record) -> list[Path]:
        """Numbers, film and truth of a demonstration."""
        return [*_parts(folder, record.id), folder / "truth" / f"{record.id}.npz"]

    def write_part(self, folder: Path, demo: Demo) -> None:
        """Write numbers, film and truth of a demonstration."""
        film, every = demo.film, demo.shots.every
        if film is None:
            raise SetupError("a LeRobot dataset needs films")
        numbers, video = _parts(folder, demo.id)
        write_arrays(folder / "truth" / f"{demo.id}.npz", demo.truth())
        asked = demo.performance.controls[every - 1 :: every]  # what each frame leads to; the last one holds still
        turned = np.stack([to_quaternion(X[:3, :3]) for X in film.X_BG])
        thin = film.rgb[:, ::_THINNED, ::_THINNED]
        columns = {
            STATE: np.column_stack([film.q, film.finger_width_m]).astype(np.float32),
            POSE: np.column_stack([film.X_BG[:, :3, 3], turned]).astype(np.float32),
            ACTION: np.concatenate([asked, asked[-1:]]).astype(np.float32),
            CAMERA: np.stack([np.bincount(thin[..., c].ravel(), minlength=256) for c in range(3)]),
        }
        write_arrays(numbers, columns)
        with disk_errors(video.name):
            write_video(video, film.rgb, demo.shots.fps, crf=demo.shots.crf, keyframe_every=_KEYFRAME_EVERY)

    def finish(self, folder: Path, records: Sequence[Record], shots: Shots, about: dict[str, Any]) -> list[Path]:
        """Join the parts and describe them."""
        tasks = list(dict.fromkeys(record.prompt for record in records))
        columns, histograms = _columns(folder, records, shots, tasks)
        data, films = _write_data(folder, columns), _join_films(folder, records, columns, shots)
        places = [rows | film for rows, film in zip(data, films, strict=True)]
        episodes = []
        for k, (record, own, histogram, place) in enumerate(zip(records, columns, histograms, places, strict=True)):
            told = of_features([own], {CAMERA: [histogram]})
            stats = {f"stats/{name}/{kind}": value for name, kinds in told.items() for kind, value in kinds.items()}
            first = int(own["index"][0])
            about_it = {"episode_index": k, "tasks": [record.prompt], "length": len(own["index"])}
            rows = {"dataset_from_index": first, "dataset_to_index": first + len(own["index"])}
            itself = {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0}
            episodes.append({**about_it, **rows, **place, **stats, **itself})
        _write_table(folder / _EPISODES.format(chunk_index=0, file_index=0), [pa.Table.from_pylist(episodes)])
        _write_tasks(folder / "meta" / "tasks.parquet", tasks)
        write_json(folder / "meta" / "stats.json", of_features(columns, {CAMERA: histograms}))
        write_json(folder / "meta" / "info.json", _info(shots, columns, len(tasks)))
        save_camera(shots.camera, folder / "meta" / "camera.json")
        return sorted(
            {folder / _DATA.format(**_numbers(place, "data")) for place in places}
            | {folder / _VIDEO.format(video_key=CAMERA, **_numbers(place, f"videos/{CAMERA}")) for place in places}
        )

    def lists(self, folder: Path, tasks: Sequence[str]) -> list[Path]:
        """All in `meta`."""
        names = ("tasks.parquet", "stats.json", "info.json", "camera.json")
        return [folder / _EPISODES.format(chunk_index=0, file_index=0), *(folder / "meta" / name for name in names)]


def _parts(folder: Path, id: str) -> tuple[Path, Path]:
    return folder / PARTS / f"{id}.npz", folder / PARTS / f"{id}.mp4"


def _columns(
    folder: Path, records: Sequence[Record], shots: Shots, tasks: Sequence[str]
) -> tuple[list[Columns], list[NDArray[Any]]]:
    """Columns of each episode, and the histograms of its pictures."""
    columns, histograms, frames_before = [], [], 0
    for k, record in enumerate(records):
        with np.load(_parts(folder, record.id)[0]) as archive:
            own = {name: archive[name] for name in VECTORS}
            histograms.append(archive[CAMERA])
        frames = np.arange(len(own[STATE]))
        own["timestamp"] = (frames / shots.fps).astype(np.float32)
        own |= {"frame_index": frames, "episode_index": np.full_like(frames, k), "index": frames + frames_before}
        own["task_index"] = np.full_like(frames, tasks.index(record.prompt))
        frames_before += len(frames)
        columns.append(own)
    return columns, histograms


def _write_data(folder: Path, columns: Sequence[Columns]) -> list[dict[str, int]]:
    """Write the columns of all episodes; returns which file has each."""
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
    for where in {tuple(place.items()): place for place in places}.values():
        path = folder / _DATA.format(**_numbers(where, "data"))
        _write_table(path, [table for table, place in zip(tables, places, strict=True) if place == where])
    return places


def _join_films(
    folder: Path, records: Sequence[Record], columns: Sequence[Columns], shots: Shots
) -> list[dict[str, int | float]]:
    """Join the films of all episodes; returns which file has each, from when to when."""
    key = f"videos/{CAMERA}"
    films = [_parts(folder, record.id)[1] for record in records]
    places = _places(key, [film.stat().st_size for film in films], _VIDEO_MB)
    begun: dict[tuple[int, ...], int] = {}
    found = []
    for place, own in zip(places, columns, strict=True):
        first = begun.get(tuple(place.values()), 0)
        last = first + len(own["index"])
        begun[tuple(place.values())] = last
        found.append({**place, f"{key}/from_timestamp": first / shots.fps, f"{key}/to_timestamp": last / shots.fps})
    for where in {tuple(place.items()): place for place in places}.values():
        path = folder / _VIDEO.format(video_key=CAMERA, **_numbers(where, key))
        with disk_errors(path.name):
            path.parent.mkdir(parents=True, exist_ok=True)
            join_videos(path, [film for film, place in zip(films, places, strict=True) if place == where])
    return found


def _places(key: str, sizes: Sequence[int], most_mb: int) -> list[dict[str, int]]:
    """Chunk and file of things of these sizes [bytes]: a file is full before it is larger than `most_mb`."""
    places, number, filled = [], 0, 0
    for size in sizes:
        if filled and filled + size > most_mb * 2**20:
            number, filled = number + 1, 0
        filled += size
        chunk, file = divmod(number, _CHUNK_FILES)
        places.append({f"{key}/chunk_index": chunk, f"{key}/file_index": file})
    return places


def _numbers(place: dict[str, Any], key: str) -> dict[str, int]:
    return {name: place[f"{key}/{name}"] for name in ("chunk_index", "file_index")}


def _write_table(path: Path, tables: Sequence[pa.Table]) -> None:
    """Write tables to one file, each a row group."""
    with atomic_path(path) as part, pq.ParquetWriter(part, tables[0].schema) as writer:
        for table in tables:
            writer.write_table(table)


def _write_tasks(path: Path, tasks: Sequence[str]) -> None:
    """Write prompts and their numbers, the prompts being pandas' index as LeRobot's loader expects."""
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), "task": pa.array(tasks, pa.string())})
    named = [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": own, "metadata": None}
        for name, kind, own in (("task_index", "int64", "int64"), ("task", "unicode", "object"))
    ]
    pandas = {"index_columns": ["task"], "column_indexes": [], "columns": named, "pandas_version": "2.0.0"}
    _write_table(path, [table.replace_schema_metadata({"pandas": json.dumps(pandas)})])


def _info(shots: Shots, columns: Sequence[Columns], tasks: int) -> dict[str, Any]:
    """The dataset's description."""
    rate, side = round(shots.fps), shots.size
    film = {
        "video.height": side + side % 2,
        "video.width": side + side % 2,
        "video.codec": "h264",
        "video.pix_fmt": "yuv420p",
        "video.is_depth_map": False,
        "video.fps": rate,
        "video.channels": 3,
        "has_audio": False,
    }
    picture = {"dtype": "video", "shape": [film["video.height"], film["video.width"], 3], "info": film}
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
            CAMERA: {**picture, "names": ["height", "width", "channels"]},
            **{
                name: {"dtype": "float32", "shape": [len(elements)], "names": elements}
                for name, elements in VECTORS.items()
            },
            **{name: {"dtype": kind, "shape": [1], "names": None} for name, kind in COUNTERS.items()},
        },
    }
