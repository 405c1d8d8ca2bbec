"""Labels of videos in Hugging Face's VideoFolder layout: `metadata.csv`, `metadata.jsonl` or `metadata.parquet`.

A row belongs to the film that its column `file_name` (or `video_file_name`) names, relative to the file
(https://huggingface.co/docs/datasets/video_dataset). What a film shows is in a column text, prompt, caption or
instruction. `suite demos` writes such a file; its further columns are read under the names that they have in manifests.
"""

import csv
import io
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import pyarrow
import pyarrow.parquet as parquet

from kinebench_drake.datasets.manifest import MAX_PERIOD_S, MIN_PERIOD_S
from kinebench_drake.datasets.videos.sample import VideoSample
from kinebench_drake.datasets.videos.search import Search, below, plain
from kinebench_drake.errors import InputError, cause
from kinebench_drake.io.files import VIDEO_SUFFIXES, read_bytes
from kinebench_drake.io.jsonl import as_object, parse_json

Row = Mapping[str, object]

_FILES = ("file_name", "video_file_name")
_PROMPTS = ("text", "prompt", "caption", "instruction")


def list_metadata(path: Path, search: Search) -> list[VideoSample]:
    """The films that a metadata file names.

    Raises:
        InputError: it cannot be read, or names no film.
    """
    samples = with_labels([], [path], search)
    if not samples:
        raise InputError(f"names no video; expected a column file_name with {', '.join(sorted(VIDEO_SUFFIXES))} files")
    return samples


def with_labels(samples: Sequence[VideoSample], files: Sequence[Path], search: Search) -> list[VideoSample]:
    """The samples with what metadata files tell of them, and one with a problem for every film that is not there.

    The file nearest to a film goes before those above it.
    """
    told: dict[Path, tuple[Row, Path]] = {}
    added: dict[Path, VideoSample] = {}
    problems: list[VideoSample] = []
    found = {sample.path for sample in samples}
    for file in files:  # from the top down
        passed = 0
        for row in _rows(file, search):
            name = next((row[key] for key in _FILES if isinstance(row.get(key), str)), None)
            if not isinstance(name, str) or Path(name).suffix.lower() not in VIDEO_SUFFIXES:
                passed += 1
                continue
            try:
                path = below(file.parent, name)
            except InputError as error:
                problems.append(replace(plain(file, search), id=Path(name).stem, video=name, problem=str(error)))
                continue
            told[path] = row, file
            if path not in found:
                sample = plain(path, search)
                problem = None if path.is_file() else f"{name}: there is no such file ({file.name} names it)"
                added[path] = replace(sample, problem=problem)
        if passed:
            search.warnings.append(f"{search.name(file)}: {passed} of its rows name no video ({', '.join(_FILES)})")
    labelled = [_labelled(s, *told[s.path]) if s.path in told else s for s in (*samples, *added.values())]
    return [*labelled, *problems]


def _labelled(sample: VideoSample, row: Row, file: Path) -> VideoSample:
    """What a row tells, as far as it is of the right type: such files may hold columns of any meaning."""
    seed = _number(row.get("seed"), -math.inf, math.inf)
    return replace(
        sample,
        task=_text(row.get("task")),
        model=_text(row.get("model")),
        seed=None if seed is None or seed != int(seed) else int(seed),
        prompt=next((text for key in _PROMPTS if (text := _text(row.get(key)))), None),
        dataset_period_s=_number(row.get("frame_period_s"), MIN_PERIOD_S, MAX_PERIOD_S),
        first_frame=_picture(row.get("first_frame"), file.parent) or sample.first_frame,
    )


def _text(value: object) -> str | None:
    return value if isinstance(value, str) and value else None


def _number(value: object, least: float, most: float) -> float | None:
    """A number, in csv files written as text."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return None
    return number if math.isfinite(number) and least <= number <= most else None


def _picture(name: object, folder: Path) -> Path | None:
    if not isinstance(name, str):
        return None
    try:
        path = below(folder, name)
    except InputError:
        return None
    return path if path.is_file() else None


def _rows(file: Path, search: Search) -> list[Row]:
    """The rows of a metadata file; none, and a warning, where it cannot be read."""
    try:
        return list(_READERS[file.suffix](read_bytes(file)))
    except (OSError, ValueError, TypeError, MemoryError, csv.Error, pyarrow.ArrowException) as error:
        search.warnings.append(f"{search.name(file)} is not read ({cause(error).replace(str(file), file.name)})")
        return []


def _csv(data: bytes) -> Iterator[Row]:
    yield from csv.DictReader(io.StringIO(data.decode("utf-8-sig"), newline=""))


def _jsonl(data: bytes) -> Iterator[Row]:
    for line in data.decode("utf-8-sig").split("\n"):
        if line.strip():
            yield as_object(parse_json(line))


def _parquet(data: bytes) -> Iterator[Row]:
    yield from parquet.read_table(io.BytesIO(data)).to_pylist()


_READERS: Mapping[str, Callable[[bytes], Iterator[Row]]] = {".csv": _csv, ".jsonl": _jsonl, ".parquet": _parquet}
NAMES = tuple(f"metadata{suffix}" for suffix in _READERS)
"""What such files are called."""
