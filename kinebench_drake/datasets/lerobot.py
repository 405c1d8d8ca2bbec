"""LeRobot datasets, v2.x and v3: metadata, episodes, their videos and their joint angles or poses."""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

import numpy as np
import pyarrow
import pyarrow.parquet as parquet
from numpy.typing import NDArray
from pyarrow import compute

from kinebench_drake.datasets.manifest import MAX_PERIOD_S, MIN_PERIOD_S
from kinebench_drake.datasets.trajectories.check import MAX_FRAMES, numbers
from kinebench_drake.datasets.trajectories.columns import ColumnLayout, Columns, find_columns
from kinebench_drake.datasets.trajectories.pose import from_quaternions, from_vectors
from kinebench_drake.datasets.trajectories.trajectory import (
    RawTrajectory,
    TrajectoryFormat,
    TrajectoryOptions,
    TrajectorySample,
)
from kinebench_drake.datasets.videos.sample import VideoSample, camera_of
from kinebench_drake.datasets.videos.search import CAMERA_NAME, Search
from kinebench_drake.errors import InputError, cause
from kinebench_drake.geometry import Array
from kinebench_drake.io.files import open_file, read_text, require_accessible
from kinebench_drake.io.jsonl import as_object, parse_json, read_object
from kinebench_drake.io.video import VideoPart

INFO = Path("meta") / "info.json"

_FILM_V2 = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"
_FILM_V3 = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
_DAMAGED = (OSError, ValueError, TypeError, MemoryError, pyarrow.ArrowException)
_CHUNK = 1000  # episodes a chunk of v2, where the description tells none
_FIELD = re.compile(r"\{(\w+)(?::0(\d)d)?\}")


@dataclass(frozen=True, slots=True, kw_only=True)
class LeRobotEpisode:
    """One episode of a dataset."""

    number: int
    data: Path
    """The parquet file that holds its rows, there or not."""
    tasks: str | None
    """What is done, in words."""
    length: int | None
    """Frames that its description tells."""
    places: Mapping[str, object] = field(default_factory=dict)
    """Columns `videos/...` of its description (v3)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeClip:
    """Where an episode's film is."""

    path: Path
    """The film, there or not."""
    from_s: float | None
    """When the episode begins in it [s]; None where the film is the episode's own."""
    to_s: float | None
    """When the next one begins [s]; None likewise."""


def is_lerobot(folder: Path) -> bool:
    """Whether a folder is a LeRobot dataset."""
    return (folder / INFO).is_file()


def read_lerobot_info(folder: Path) -> Mapping[str, object]:
    """A dataset's description.

    Raises:
        InputError: it is no JSON object, names no features, or is of a version that is not read.
    """
    try:
        info = read_object(folder / INFO)
    except FileNotFoundError:
        raise InputError(f"there is no {INFO.as_posix()}, expected a LeRobot v2 or v3 dataset") from None
    except InputError as error:
        raise InputError(f"{error}, expected the description of a LeRobot v2 or v3 dataset") from None
    if not isinstance(info.get("features"), Mapping):
        raise InputError(f"{INFO.as_posix()} names no features, expected a LeRobot v2 or v3 dataset")
    version = str(info.get("codebase_version"))
    if not re.match(r"v?[23]\.", version):
        raise InputError(f"the dataset is of LeRobot version {version}, expected v2.x or v3.x")
    return info


def list_lerobot_episodes(
    folder: Path, info: Mapping[str, object], film: str | None = None
) -> Iterator[LeRobotEpisode]:
    """Every episode, in order.

    Args:
        folder: the dataset.
        info: its description.
        film: feature whose films will be asked for by `film_place`.

    Raises:
        InputError: the list of a v3 dataset is damaged.
    """
    if _is_v2(info):
        yield from _episodes_v2(folder)
        return
    described = sorted((folder / "meta" / "episodes").glob("**/*.parquet"))
    index = ("episode_index", "data/chunk_index", "data/file_index")
    for file in described:
        there = schema(file)
        wanted = [n for n in (*index, "tasks", "length") if n in there]
        wanted += [n for n in there if film is not None and n.startswith(f"videos/{film}/")]
        for row in read_rows(file, wanted).to_pylist():
            try:
                number, chunk, part = (int(row[name]) for name in index)
            except (KeyError, TypeError, ValueError):
                raise InputError(f"meta/episodes/.../{file.name} names no {', '.join(index)} of each episode") from None
            yield LeRobotEpisode(
                number=number,
                data=folder / "data" / f"chunk-{chunk:03d}" / f"file-{part:03d}.parquet",
                tasks=_joined(row.get("tasks")),
                length=_count(row.get("length")),
                places={name: value for name, value in row.items() if name.startswith("videos/")},
            )
    if not described:
        for file in sorted((folder / "data").glob("chunk-*/file-*.parquet")):
            for number in read_rows(file, ["episode_index"]).column("episode_index").unique().to_pylist():
                yield LeRobotEpisode(number=int(number), data=file, tasks=None, length=None)


def episode_clip(folder: Path, info: Mapping[str, object], episode: LeRobotEpisode, key: str) -> EpisodeClip:
    """Where the film of an episode's camera is.

    Args:
        folder: the dataset.
        info: its description.
        episode: the episode.
        key: name of the camera's feature.

    Raises:
        InputError: the description does not tell, or leads out of the dataset.
    """
    if _is_v2(info):
        size = _count(info.get("chunks_size")) or _CHUNK
        fields = {"episode_chunk": episode.number // size, "episode_index": episode.number}
        return EpisodeClip(path=_filled(folder, info, _FILM_V2, key, fields), from_s=None, to_s=None)
    chunk, file = (_count(episode.places.get(f"videos/{key}/{name}_index")) for name in ("chunk", "file"))
    begin, end = (_finite(episode.places.get(f"videos/{key}/{name}_timestamp")) for name in ("from", "to"))
    if chunk is None or file is None or begin is None or end is None:
        raise InputError(f"meta/episodes tells no chunk, file and time stamps of {key} for episode {episode.number}")
    path = _filled(folder, info, _FILM_V3, key, {"chunk_index": chunk, "file_index": file})
    return EpisodeClip(path=path, from_s=begin, to_s=end)


def schema(path: Path) -> list[str]:
    """Names of a parquet file's columns.

    Raises:
        InputError: it is damaged.
    """
    try:
        with open_file(path) as file:
            return list(parquet.read_schema(file).names)
    except _DAMAGED as error:
        raise InputError(f"{path.name} is not a readable parquet file ({_told(path, error)})") from None


def read_rows(path: Path, columns: list[str], episode: int | None = None) -> pyarrow.Table:
    """Columns of a parquet file, of all its rows or of one episode's.

    Raises:
        InputError: it is damaged.
    """
    only = None if episode is None else [("episode_index", "==", episode)]
    try:
        with open_file(path) as file:
            return parquet.read_table(file, columns=columns, filters=only)
    except _DAMAGED as error:
        raise InputError(f"{path.name} is not a readable parquet file ({_told(path, error)})") from None


def _is_v2(info: Mapping[str, object]) -> bool:
    return str(info.get("codebase_version")).lstrip("v").startswith("2")


def _episodes_v2(folder: Path) -> Iterator[LeRobotEpisode]:
    described = _described(folder / "meta" / "episodes.jsonl")
    for file in sorted((folder / "data").glob("chunk-*/episode_*.parquet")):
        digits = file.stem.removeprefix("episode_")
        if digits.isdecimal():
            row = described.get(int(digits), {})
            yield LeRobotEpisode(
                number=int(digits), data=file, tasks=_joined(row.get("tasks")), length=_count(row.get("length"))
            )


def _described(path: Path) -> dict[int, Mapping[str, object]]:
    """What meta/episodes.jsonl of a v2 dataset tells, by episode; nothing from where on it cannot be read."""
    found: dict[int, Mapping[str, object]] = {}
    try:
        for line in read_text(path).splitlines():
            row = as_object(parse_json(line))
            number = row.get("episode_index")
            if isinstance(number, int):
                found[number] = row
    except (OSError, ValueError):
        return found
    return found


def _joined(tasks: object) -> str | None:
    return "; ".join(map(str, tasks)) if isinstance(tasks, list) and tasks else None


def _count(value: object) -> int | None:
    return value if isinstance(value, int) and not isinstance(value, bool) and value >= 0 else None


def _finite(value: object) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)


def _filled(folder: Path, info: Mapping[str, object], default: str, key: str, numbers: Mapping[str, int]) -> Path:
    """The path that the description's pattern, or the layout's own, gives; format strings are never run as such."""
    pattern = info.get("video_path")
    pattern = pattern if isinstance(pattern, str) and pattern else default

    def put(match: re.Match[str]) -> str:
        if match[1] == "video_key":
            return key
        if match[1] not in numbers:
            raise InputError(f"video_path {pattern!r} of {INFO.as_posix()} names {match[1]}, expected {default!r}")
        return f"{numbers[match[1]]:0{match[2] or 1}d}"

    pure = PurePosixPath(_FIELD.sub(put, pattern))
    if pure.is_absolute() or ".." in pure.parts:
        raise InputError(f"video_path {pattern!r} of {INFO.as_posix()} leads out of the dataset")
    return require_accessible(
        folder / pure, f"video_path {pattern!r} of {INFO.as_posix()}"
    )  # links are followed wherever they lead: the Hub's cache consists of them


def _told(path: Path, error: Exception) -> str:
    """The error in one line without the paths of this machine, which Arrow likes to name."""
    return cause(error).replace(str(path), path.name)


def list_lerobot_videos(folder: Path, search: Search) -> list[VideoSample]:
    """The episodes of a dataset, one camera of each.

    Raises:
        InputError: the dataset cannot be used, or it is not said which of its cameras to take.
        UsageError: a camera.json is unusable.
    """
    info = read_lerobot_info(folder)
    features = as_object(info["features"])
    cameras = list(_cameras(features))
    if not cameras:
        expected = "expected a feature of dtype video or image (`audit` reads its trajectories)"
        raise InputError(f"the LeRobot dataset has no video, {expected}")
    key = search.choose(cameras, "the dataset")
    in_parquet = as_object(features[key]).get("dtype") == "image"
    search.cameras.settle(folder, folder / "meta" / CAMERA_NAME)
    samples = []
    for episode in list_lerobot_episodes(folder, info, key):
        problem, path, part = None, episode.data, VideoPart(key=key, episode=episode.number, frames=episode.length)
        if not in_parquet:
            try:
                place = episode_clip(folder, info, episode, key)
                # A film of its own may be longer than the table; of a shared one all frames must be there.
                told = None if place.to_s is None else episode.length
                path, part = place.path, VideoPart(from_s=place.from_s, to_s=place.to_s, frames=told)
            except InputError as error:
                problem = str(error)
        if problem is None and not path.is_file():
            problem = f"{path.relative_to(folder).as_posix()}: there is no such file"
        taken, source = camera_of(search.cameras.of(path.parent))
        samples.append(
            VideoSample(
                id=f"{folder.resolve().name}-episode_{episode.number:06d}",
                path=path,
                part=part,
                video=f"{search.name(path)}#episode_{episode.number:06d}",
                camera=taken,
                camera_source=source,
                camera_key=key,
                prompt=episode.tasks,
                dataset_period_s=_period_s(info),
                problem=problem,
            )
        )
    if not samples:
        raise InputError("the dataset holds no episode")
    return samples


def _cameras(features: Mapping[str, object]) -> Iterator[str]:
    """Features that hold colour pictures."""
    for name, feature in features.items():
        about = as_object(feature)
        told = {**as_object(about.get("info")), **as_object(about.get("video_info"))}
        depth = any(told.get(key) is True for key in ("video.is_depth_map", "is_depth_map"))
        if about.get("dtype") in ("video", "image") and not depth:
            yield name


def _period_s(info: Mapping[str, object]) -> float | None:
    fps = info.get("fps")
    if isinstance(fps, bool) or not isinstance(fps, int | float):
        return None
    return 1.0 / fps if 1.0 / MAX_PERIOD_S <= fps <= 1.0 / MIN_PERIOD_S else None


_TIMES_AGREE_S = 1e-4
"""Time stamps this near to frame / fps are taken to mean it (LeRobot's own tolerance)."""


def list_lerobot_trajectories(folder: Path, name: str, choice: TrajectoryOptions) -> list[TrajectorySample]:
    """The episodes of a dataset, none of them read.

    Args:
        folder: the dataset.
        name: how results name it.
        choice: what the user says about its columns.

    Raises:
        InputError: the dataset cannot be used: no description, no fitting column, no episode.
    """
    info = read_lerobot_info(folder)
    find_columns(as_object(info["features"]), choice)  # told once, not once an episode
    stem = folder.resolve().name
    samples = []
    for episode in list_lerobot_episodes(folder, info):
        number, file = episode.number, episode.data
        samples.append(
            TrajectorySample(
                id=f"{stem}-episode_{number:06d}",
                path=file,
                video=f"{name}/{file.relative_to(folder).as_posix()}#episode_{number:06d}",
                format=TrajectoryFormat.LEROBOT,
                part=str(number),
                about=(folder / INFO,),
                prompt=episode.tasks,
                problem=None if file.is_file() else f"{file.relative_to(folder).as_posix()}: there is no such file",
            )
        )
    if not samples:
        raise InputError("the dataset holds no episode below data/")
    return samples


def read_lerobot(path: Path, episode: int, info_path: Path, choice: TrajectoryOptions) -> RawTrajectory:
    """Read one episode.

    Args:
        path: the parquet file.
        episode: the episode's number.
        info_path: the dataset's meta/info.json.
        choice: what the user says about its columns.

    Raises:
        InputError: the file is damaged, or lacks a column or the episode.
    """
    info = read_lerobot_info(info_path.parent.parent)
    columns = find_columns(as_object(info["features"]), choice)
    table = _rows(path, episode, columns)
    values = _matrix(table, columns.column)
    if max(columns.indices) >= values.shape[1]:
        raise InputError(f"{columns.column} holds {values.shape[1]} numbers, the dataset's description tells more")
    taken, warnings = values[:, columns.indices], list(columns.warnings)
    q: Array | None = None
    X_BG: Array | None = None
    if columns.layout is ColumnLayout.JOINTS:
        q = taken
    elif columns.layout is ColumnLayout.MATRIX:
        X_BG = taken.reshape(-1, 4, 4)
    elif columns.layout is ColumnLayout.QUATERNION:
        X_BG, mended = from_quaternions(taken[:, :3], taken[:, 3:])
        warnings += mended
    else:
        X_BG = from_vectors(taken[:, :3], taken[:, 3:], angles=columns.layout is ColumnLayout.ROLL_PITCH_YAW)
    return RawTrajectory(
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
