"""LeRobot datasets as folders: their description, their episodes, and where the data and the films of each lie.

Layouts: v2.x has a parquet file and a film an episode and lists episodes in meta/episodes.jsonl; v3 has many episodes
a file and lists them in meta/episodes/*.parquet, of each film from when to when an episode is in it. Paths of films
follow `video_path` of meta/info.json. (LeRobot's own `LeRobotDataset` v2.1 and v3.0.)
"""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

import pyarrow
import pyarrow.parquet as parquet

from kinebench_drake.errors import InputError, cause
from kinebench_drake.plainfile import open_file, parse_json, reach, read_text
from kinebench_drake.trajectories.description import mapping, read_description

INFO = Path("meta") / "info.json"

_FILM_V2 = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"
_FILM_V3 = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
_DAMAGED = (OSError, ValueError, TypeError, MemoryError, pyarrow.ArrowException)
_CHUNK = 1000  # episodes a chunk of v2, where the description tells none
_FIELD = re.compile(r"\{(\w+)(?::0(\d)d)?\}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Episode:
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
class FilmPlace:
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


def read_info(folder: Path) -> Mapping[str, object]:
    """A dataset's description.

    Raises:
        InputError: it is no JSON object, names no features, or is of a version that is not read.
    """
    try:
        info = read_description(folder / INFO)
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


def list_episodes(folder: Path, info: Mapping[str, object], film: str | None = None) -> Iterator[Episode]:
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
            yield Episode(
                number=number,
                data=folder / "data" / f"chunk-{chunk:03d}" / f"file-{part:03d}.parquet",
                tasks=_joined(row.get("tasks")),
                length=_count(row.get("length")),
                places={name: value for name, value in row.items() if name.startswith("videos/")},
            )
    if not described:
        for file in sorted((folder / "data").glob("chunk-*/file-*.parquet")):
            for number in read_rows(file, ["episode_index"]).column("episode_index").unique().to_pylist():
                yield Episode(number=int(number), data=file, tasks=None, length=None)


def film_place(folder: Path, info: Mapping[str, object], episode: Episode, key: str) -> FilmPlace:
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
        return FilmPlace(path=_filled(folder, info, _FILM_V2, key, fields), from_s=None, to_s=None)
    chunk, file = (_count(episode.places.get(f"videos/{key}/{name}_index")) for name in ("chunk", "file"))
    begin, end = (_finite(episode.places.get(f"videos/{key}/{name}_timestamp")) for name in ("from", "to"))
    if chunk is None or file is None or begin is None or end is None:
        raise InputError(f"meta/episodes tells no chunk, file and time stamps of {key} for episode {episode.number}")
    path = _filled(folder, info, _FILM_V3, key, {"chunk_index": chunk, "file_index": file})
    return FilmPlace(path=path, from_s=begin, to_s=end)


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


def _episodes_v2(folder: Path) -> Iterator[Episode]:
    described = _described(folder / "meta" / "episodes.jsonl")
    for file in sorted((folder / "data").glob("chunk-*/episode_*.parquet")):
        digits = file.stem.removeprefix("episode_")
        if digits.isdecimal():
            row = described.get(int(digits), {})
            yield Episode(
                number=int(digits), data=file, tasks=_joined(row.get("tasks")), length=_count(row.get("length"))
            )


def _described(path: Path) -> dict[int, Mapping[str, object]]:
    """What meta/episodes.jsonl of a v2 dataset tells, by episode; nothing from where on it cannot be read."""
    found: dict[int, Mapping[str, object]] = {}
    try:
        for line in read_text(path).splitlines():
            row = mapping(parse_json(line))
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
    return reach(
        folder / pure, f"video_path {pattern!r} of {INFO.as_posix()}"
    )  # links are followed wherever they lead: the Hub's cache consists of them


def _told(path: Path, error: Exception) -> str:
    """The error in one line without the paths of this machine, which Arrow likes to name."""
    return cause(error).replace(str(path), path.name)
