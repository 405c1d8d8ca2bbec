"""Description of a LeRobot dataset of version 2.x or 3: names of its files and keys, its cameras and episodes."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from kinebench_drake.errors import InputError
from kinebench_drake.formats.folders import join_relative
from kinebench_drake.io.files import read_text
from kinebench_drake.io.jsonl import as_number, as_object, as_type, parse_json, read_object
from kinebench_drake.io.parquet import read_table
from kinebench_drake.io.video import VideoPart

INFO = Path("meta") / "info.json"
FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
"""Pattern of the files of v3."""
DATA = f"data/{FILE}.parquet"
EPISODES = f"meta/episodes/{FILE}.parquet"
VIDEO = f"videos/{{video_key}}/{FILE}.mp4"
PLACE = ("chunk_index", "file_index")
"""Keys of the file in which an episode lies (v3), below `data` and `videos/CAMERA`."""
SPAN = ("from_timestamp", "to_timestamp")
"""Keys of an episode's part of a video, below `videos/CAMERA` [s]."""
EPISODE = "episode_index"
FRAME = "frame_index"
TIME = "timestamp"
"""Columns with the number of the episode, of the frame in it, and its time [s]."""

_VIDEO_V2 = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"
_INDEX = (EPISODE, *(f"data/{key}" for key in PLACE))
_FIELD = re.compile(r"\{(\w+)(?::0(\d)d)?\}")


@dataclass(frozen=True, slots=True, kw_only=True)
class LeRobotEpisode:
    """Metadata of one episode."""

    number: int
    data: Path
    """Parquet file of its rows, which may be absent."""
    row: Mapping[str, object]
    """Its row in the list of episodes."""

    @property
    def name(self) -> str:
        """Name of the episode in ids and results."""
        return f"episode_{self.number:06d}"

    @property
    def tasks(self) -> str | None:
        """Instruction."""
        tasks = self.row.get("tasks")
        return "; ".join(map(str, tasks)) if isinstance(tasks, list) and tasks else None

    @property
    def length(self) -> int | None:
        """Number of frames by the metadata."""
        return _count(self.row.get("length"))


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
        return as_number(self.info.get("fps"))

    @property
    def chunk(self) -> int:
        """Episodes in a folder of v2: 1000, unless info.json says otherwise."""
        return _count(self.info.get("chunks_size")) or 1000

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
                    yield LeRobotEpisode(number=int(digits), data=file, row=metadata.get(int(digits), {}))
            return
        files = sorted((self.folder / "meta" / "episodes").glob("**/*.parquet"))
        names = (*_INDEX, "tasks", "length", *(f"videos/{camera}/{key}" for key in (*PLACE, *SPAN)))
        for file in files:
            for row in read_table(file, optional=names).to_pylist():
                try:
                    number, *place = (int(row[name]) for name in _INDEX)
                except (KeyError, TypeError, ValueError):
                    raise InputError(
                        f"meta/episodes/.../{file.name} names no {', '.join(_INDEX)} of each episode"
                    ) from None
                data = self.folder / DATA.format(**dict(zip(PLACE, place, strict=True)))
                yield LeRobotEpisode(number=number, data=data, row=row)
        if not files:
            for file in sorted((self.folder / "data").glob("chunk-*/file-*.parquet")):
                for number in read_table(file, [EPISODE]).column(EPISODE).unique().to_pylist():
                    yield LeRobotEpisode(number=int(number), data=file, row={})

    def video_part(self, episode: LeRobotEpisode, camera: str) -> tuple[Path, VideoPart]:
        """Return the video file of an episode, which may be absent, and the part of it.

        Of more frames than the table has rows, those of a discarded take, the first ones count.

        Raises:
            InputError: the metadata are incomplete, or lead out of the dataset.
        """
        if self.is_v2:
            fields = {"episode_chunk": episode.number // self.chunk, EPISODE: episode.number}
            return self._video_path(_VIDEO_V2, camera, fields), VideoPart(frames=episode.length)
        place = {key: _count(episode.row.get(f"videos/{camera}/{key}")) for key in PLACE}
        begin_s, end_s = (as_number(episode.row.get(f"videos/{camera}/{key}")) for key in SPAN)
        numbers = {key: number for key, number in place.items() if number is not None}
        if len(numbers) < len(PLACE) or begin_s is None or end_s is None:
            raise InputError(
                f"meta/episodes has no chunk, file and time stamps of {camera} for episode {episode.number}"
            )
        path = self._video_path(VIDEO, camera, numbers)
        return path, VideoPart(from_s=begin_s, to_s=end_s, frames=episode.length)

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


def _read_episodes_v2(path: Path) -> dict[int, Mapping[str, object]]:
    """Return the rows of meta/episodes.jsonl by episode, up to the first line that cannot be read."""
    rows: dict[int, Mapping[str, object]] = {}
    try:
        for line in read_text(path).splitlines():
            row = as_object(parse_json(line))
            number = row.get(EPISODE)
            if isinstance(number, int):
                rows[number] = row
    except (OSError, ValueError):
        pass
    return rows


def _count(value: object) -> int | None:
    number = as_type(value, int)
    return None if number is None or number < 0 else number
