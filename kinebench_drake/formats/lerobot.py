"""LeRobot datasets v2.x and v3: episodes, their videos, and their joint angles or poses."""

import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from io import BufferedReader
from pathlib import Path

import numpy as np
import pyarrow
import pyarrow.parquet as parquet
from numpy.typing import NDArray
from pyarrow import compute

from kinebench_drake.errors import InputError, cause
from kinebench_drake.formats.folders import join_relative
from kinebench_drake.formats.manifest import MAX_PERIOD_S, MIN_PERIOD_S
from kinebench_drake.formats.trajectories.check import MAX_FRAMES
from kinebench_drake.formats.trajectories.columns import ColumnLayout, Columns, find_columns
from kinebench_drake.formats.trajectories.numbers import require_numbers
from kinebench_drake.formats.trajectories.pose import from_quaternions, from_vectors
from kinebench_drake.formats.trajectories.trajectory import (
    RawTrajectory,
    TrajectoryFormat,
    TrajectoryOptions,
    TrajectorySample,
)
from kinebench_drake.formats.videos.sample import VideoSample
from kinebench_drake.formats.videos.search import CAMERA_NAME, Search
from kinebench_drake.geometry import Array
from kinebench_drake.io.files import absence, open_file, read_text
from kinebench_drake.io.jsonl import as_object, parse_json, read_object
from kinebench_drake.io.video import VideoPart

INFO = Path("meta") / "info.json"

_VIDEO_V2 = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"
_VIDEO_V3 = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
_INDEX_V3 = ("episode_index", "data/chunk_index", "data/file_index")
_FIELD = re.compile(r"\{(\w+)(?::0(\d)d)?\}")
_DAMAGED = (OSError, ValueError, TypeError, MemoryError, pyarrow.ArrowException)
_CHUNK = 1000  # episodes per chunk of v2, unless info.json says otherwise
_TIMES_AGREE_S = 1e-4
"""Greatest difference between a time stamp and frame / fps to which it is rounded (LeRobot's own tolerance)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LeRobotEpisode:
    """Metadata of one episode."""

    number: int
    data: Path
    """Parquet file of its rows, which may be absent."""
    tasks: str | None
    """Instruction."""
    length: int | None
    """Number of frames by the metadata."""
    columns: Mapping[str, object] = field(default_factory=dict)
    """Columns of the episode in meta/episodes (v3)."""

    @property
    def name(self) -> str:
        """Name of the episode in ids and results."""
        return f"episode_{self.number:06d}"


@dataclass(frozen=True, slots=True, kw_only=True)
class LeRobotDataset:
    """A dataset and its meta/info.json."""

    folder: Path
    info: Mapping[str, object]

    @classmethod
    def open(cls, folder: Path) -> "LeRobotDataset":
        """Read the description of a dataset.

        Raises:
            InputError: it is no JSON object, names no features, or is of an unsupported version.
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
        return cls(folder=folder, info=info)

    @property
    def is_v2(self) -> bool:
        """True for versions 2.x."""
        return str(self.info.get("codebase_version")).lstrip("v").startswith("2")

    @property
    def features(self) -> Mapping[str, object]:
        """Columns of the dataset by name."""
        return as_object(self.info["features"])

    @property
    def fps(self) -> float | None:
        """Frames per second [1/s]; None if missing or not a number."""
        fps = self.info.get("fps")
        return None if isinstance(fps, bool) or not isinstance(fps, int | float) else fps

    def cameras(self) -> Iterator[str]:
        """Yield the names of the features that hold colour images."""
        for name, feature in self.features.items():
            about = as_object(feature)
            details = {**as_object(about.get("info")), **as_object(about.get("video_info"))}
            depth = any(details.get(key) is True for key in ("video.is_depth_map", "is_depth_map"))
            if about.get("dtype") in ("video", "image") and not depth:
                yield name

    def episodes(self, camera: str | None = None) -> Iterator[LeRobotEpisode]:
        """Yield all episodes in order; `camera` names the feature whose columns `video_part` needs.

        Raises:
            InputError: the list of a v3 dataset is damaged.
        """
        if self.is_v2:
            metadata = _read_episodes_v2(self.folder / "meta" / "episodes.jsonl")
            for file in sorted((self.folder / "data").glob("chunk-*/episode_*.parquet")):
                digits = file.stem.removeprefix("episode_")
                if digits.isdecimal():
                    yield _episode(int(digits), file, metadata.get(int(digits), {}))
            return
        files = sorted((self.folder / "meta" / "episodes").glob("**/*.parquet"))
        for file in files:
            available = _column_names(file)
            columns = [n for n in (*_INDEX_V3, "tasks", "length") if n in available]
            columns += [n for n in available if camera is not None and n.startswith(f"videos/{camera}/")]
            for row in _read_table(file, columns).to_pylist():
                try:
                    number, chunk, part = (int(row[name]) for name in _INDEX_V3)
                except (KeyError, TypeError, ValueError):
                    raise InputError(
                        f"meta/episodes/.../{file.name} names no {', '.join(_INDEX_V3)} of each episode"
                    ) from None
                data = self.folder / "data" / f"chunk-{chunk:03d}" / f"file-{part:03d}.parquet"
                yield _episode(number, data, row)
        if not files:
            for file in sorted((self.folder / "data").glob("chunk-*/file-*.parquet")):
                for number in _read_table(file, ["episode_index"]).column("episode_index").unique().to_pylist():
                    yield _episode(int(number), file, {})

    def video_part(self, episode: LeRobotEpisode, camera: str) -> tuple[Path, VideoPart]:
        """Return the video file of an episode, which may be absent, and the part of it.

        A file of one episode (v2) may be longer than its table; of a shared one (v3) all frames must be there.

        Raises:
            InputError: the metadata are incomplete, or lead out of the dataset.
        """
        if self.is_v2:
            size = _count(self.info.get("chunks_size")) or _CHUNK
            fields = {"episode_chunk": episode.number // size, "episode_index": episode.number}
            return self._video_path(_VIDEO_V2, camera, fields), VideoPart()
        chunk, file = (_count(episode.columns.get(f"videos/{camera}/{name}_index")) for name in ("chunk", "file"))
        begin, end = (_finite(episode.columns.get(f"videos/{camera}/{name}_timestamp")) for name in ("from", "to"))
        if chunk is None or file is None or begin is None or end is None:
            raise InputError(
                f"meta/episodes has no chunk, file and time stamps of {camera} for episode {episode.number}"
            )
        path = self._video_path(_VIDEO_V3, camera, {"chunk_index": chunk, "file_index": file})
        return path, VideoPart(from_s=begin, to_s=end, frames=episode.length)

    def _video_path(self, default: str, camera: str, numbers: Mapping[str, int]) -> Path:
        """Fill in the path pattern of info.json, or that of the version; it is never used as a format string."""
        pattern = self.info.get("video_path")
        pattern = pattern if isinstance(pattern, str) and pattern else default

        def fill(match: re.Match[str]) -> str:
            if match[1] == "video_key":
                return camera
            if match[1] not in numbers:
                raise InputError(f"video_path {pattern!r} of {INFO.as_posix()} names {match[1]}, expected {default!r}")
            return f"{numbers[match[1]]:0{match[2] or 1}d}"

        return join_relative(self.folder, _FIELD.sub(fill, pattern), "video_path")


def is_lerobot(folder: Path) -> bool:
    """Return whether a folder is a LeRobot dataset."""
    return (folder / INFO).is_file()


def list_lerobot_videos(folder: Path, search: Search) -> list[VideoSample]:
    """List the episodes of a dataset, one camera of each.

    Raises:
        InputError: the dataset cannot be used, or the choice of the camera is ambiguous.
        UsageError: a camera.json is unusable.
    """
    dataset = LeRobotDataset.open(folder)
    cameras = list(dataset.cameras())
    if not cameras:
        expected = "expected a feature of dtype video or image (`audit` reads its trajectories)"
        raise InputError(f"the LeRobot dataset has no video, {expected}")
    key = search.choose_camera(cameras, "the dataset")
    in_parquet = as_object(dataset.features[key]).get("dtype") == "image"
    search.cameras.assign(folder, folder / "meta" / CAMERA_NAME)
    fps = dataset.fps
    period_s = None if fps is None or not 1.0 / MAX_PERIOD_S <= fps <= 1.0 / MIN_PERIOD_S else 1.0 / fps
    samples = []
    for episode in dataset.episodes(key):
        problem, path, part = None, episode.data, VideoPart(key=key, episode=episode.number, frames=episode.length)
        if not in_parquet:
            try:
                path, part = dataset.video_part(episode, key)
            except InputError as error:
                problem = str(error)
        sample = search.part_sample(path)
        samples.append(
            replace(
                sample,
                id=f"{folder.resolve().name}-{episode.name}",
                part=part,
                video=f"{sample.video}#{episode.name}",
                camera_key=key,
                prompt=episode.tasks,
                dataset_period_s=period_s,
                problem=problem or _absence(path, folder),
            )
        )
    if not samples:
        raise InputError("the dataset holds no episode")
    return samples


def list_lerobot_trajectories(folder: Path, name: str, choice: TrajectoryOptions) -> list[TrajectorySample]:
    """List the episodes of a dataset without reading them.

    Args:
        folder: the dataset.
        name: name of the dataset in results.
        choice: columns chosen by the user.

    Raises:
        InputError: the dataset has no description, no suitable column, or no episode.
    """
    dataset = LeRobotDataset.open(folder)
    find_columns(dataset.features, choice)  # reported once, not per episode
    samples = [
        TrajectorySample(
            id=f"{folder.resolve().name}-{episode.name}",
            path=episode.data,
            video=f"{name}/{episode.data.relative_to(folder).as_posix()}#{episode.name}",
            format=TrajectoryFormat.LEROBOT,
            part=str(episode.number),
            about=(folder / INFO,),
            prompt=episode.tasks,
            problem=_absence(episode.data, folder),
        )
        for episode in dataset.episodes()
    ]
    if not samples:
        raise InputError("the dataset holds no episode below data/")
    return samples


def read_lerobot(path: Path, episode: int, info_path: Path, choice: TrajectoryOptions) -> RawTrajectory:
    """Read the joint angles or poses of one episode.

    Args:
        path: the parquet file.
        episode: number of the episode.
        info_path: meta/info.json of the dataset.
        choice: columns chosen by the user.

    Raises:
        InputError: the file is damaged, or lacks a column or the episode.
    """
    dataset = LeRobotDataset.open(info_path.parent.parent)
    columns = find_columns(dataset.features, choice)
    table = _read_episode(path, episode, columns)
    values = _matrix(table, columns.column)
    if max(columns.indices) >= values.shape[1]:
        raise InputError(f"{columns.column} holds {values.shape[1]} numbers, less than {INFO.as_posix()} says")
    selected, warnings = values[:, columns.indices], list(columns.warnings)
    q: Array | None = None
    X_BG: Array | None = None
    if columns.layout is ColumnLayout.JOINTS:
        q = selected
    elif columns.layout is ColumnLayout.MATRIX:
        X_BG = selected.reshape(-1, 4, 4)
    elif columns.layout is ColumnLayout.QUATERNION:
        X_BG, repairs = from_quaternions(selected[:, :3], selected[:, 3:])
        warnings += repairs
    else:
        X_BG = from_vectors(selected[:, :3], selected[:, 3:], angles=columns.layout is ColumnLayout.ROLL_PITCH_YAW)
    return RawTrajectory(
        t_s=_times(table, dataset.fps),
        X_BG=X_BG,
        q=q,
        finger_width_m=_width(values, columns),
        columns=columns.description,
        warnings=tuple(warnings),
    )


def _read_episodes_v2(path: Path) -> dict[int, Mapping[str, object]]:
    """Return the rows of meta/episodes.jsonl by episode, up to the first line that cannot be read."""
    rows: dict[int, Mapping[str, object]] = {}
    try:
        for line in read_text(path).splitlines():
            row = as_object(parse_json(line))
            number = row.get("episode_index")
            if isinstance(number, int):
                rows[number] = row
    except (OSError, ValueError):
        pass
    return rows


def _episode(number: int, data: Path, row: Mapping[str, object]) -> LeRobotEpisode:
    tasks = row.get("tasks")
    text = "; ".join(map(str, tasks)) if isinstance(tasks, list) and tasks else None
    return LeRobotEpisode(number=number, data=data, tasks=text, length=_count(row.get("length")), columns=row)


def _count(value: object) -> int | None:
    return value if isinstance(value, int) and not isinstance(value, bool) and value >= 0 else None


def _finite(value: object) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)


def _absence(path: Path, folder: Path) -> str | None:
    return None if path.is_file() else f"{path.relative_to(folder).as_posix()}: {absence(path)}"


@contextmanager
def _open_parquet(path: Path) -> Iterator[BufferedReader]:
    """Open a parquet file for reading within the context.

    Raises:
        InputError: it is damaged.
    """
    try:
        with open_file(path) as file:
            yield file
    except _DAMAGED as error:
        reason = cause(error).replace(str(path), path.name)  # Arrow's messages contain paths of this machine
        raise InputError(f"{path.name} is not a readable parquet file ({reason})") from None


def _column_names(path: Path) -> list[str]:
    """Return the names of the columns of a parquet file."""
    with _open_parquet(path) as file:
        return list(parquet.read_schema(file).names)


def _read_table(path: Path, columns: list[str], episode: int | None = None) -> pyarrow.Table:
    """Read columns of a parquet file, of all rows or of those of one episode, as a table."""
    filters = None if episode is None else [("episode_index", "==", episode)]
    with _open_parquet(path) as file:
        return parquet.read_table(file, columns=columns, filters=filters)


def _read_episode(path: Path, episode: int, columns: Columns) -> pyarrow.Table:
    available = _column_names(path)
    if columns.column not in available:
        raise InputError(f"lacks the column {columns.column} that the dataset's description names")
    names = [columns.column, *(name for name in ("timestamp", "frame_index") if name in available)]
    table = _read_table(path, names, episode if "episode_index" in available else None)
    if not table.num_rows:
        raise InputError(f"holds no frame of episode {episode}")
    if table.num_rows > MAX_FRAMES:
        raise InputError(f"has {table.num_rows} frames, at most {MAX_FRAMES} are accepted: cut it into parts")
    return table


def _matrix(table: pyarrow.Table, name: str) -> Array:
    """Return a column of number lists as (T, n)."""
    column = table.column(name).combine_chunks()
    lists = pyarrow.types.is_list(column.type) or pyarrow.types.is_fixed_size_list(column.type)
    if column.null_count or not (lists or pyarrow.types.is_large_list(column.type)):
        raise InputError(
            f"{name} holds {column.type} with {column.null_count} gaps, expected a list of numbers per frame"
        )
    flat, lengths = column.flatten(), compute.list_value_length(column).unique()
    if flat.null_count or len(lengths) != 1:
        raise InputError(f"{name} holds rows of different lengths or with gaps")
    return require_numbers(name, flat.to_numpy(zero_copy_only=False)).reshape(len(column), lengths[0].as_py())


def _vector(table: pyarrow.Table, name: str) -> NDArray[np.generic] | None:
    """Return a column of numbers as (T,); None if the file lacks it."""
    if name not in table.column_names:
        return None
    column = table.column(name).combine_chunks()
    if pyarrow.types.is_list(column.type) or pyarrow.types.is_fixed_size_list(column.type):
        column = column.flatten()
    return np.asarray(column.to_numpy(zero_copy_only=False))


def _times(table: pyarrow.Table, fps: float | None) -> NDArray[np.generic] | None:
    """Return frame / fps if the time stamps, rounded to single precision, agree with it, else the stamps."""
    frames, stamps = _vector(table, "frame_index"), _vector(table, "timestamp")
    if frames is None or fps is None or not fps > 0:
        return stamps
    even = require_numbers("frame_index", frames) / float(fps)
    if stamps is None:
        return even
    times = require_numbers("timestamp", stamps)
    allowed = _TIMES_AGREE_S + np.spacing(np.float32(np.abs(even).max()))
    return even if times.shape == even.shape and np.abs(times - even).max() <= allowed else stamps


def _width(values: Array, columns: Columns) -> Array | None:
    if columns.width is not None:
        return values[:, columns.width]
    if columns.fingers:
        return np.asarray(2.0 * values[:, columns.fingers].mean(axis=1))
    return None
