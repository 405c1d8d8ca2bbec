"""Labels of videos in Hugging Face's VideoFolder layout: `metadata.csv`, `metadata.jsonl` or `metadata.parquet`.

A row belongs to the video that its column `file_name` (or `video_file_name`) names, relative to the file
(https://huggingface.co/docs/datasets/video_dataset). The prompt is in a column text, prompt, caption or instruction;
further columns have the names of the keys in manifests.
"""

import csv
import io
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

from kinebench_drake.errors import InputError, cause
from kinebench_drake.formats.folders import join_relative
from kinebench_drake.formats.samples import MAX_PERIOD_S, MIN_PERIOD_S
from kinebench_drake.formats.videos.sample import Search, VideoSample
from kinebench_drake.io import parquet
from kinebench_drake.io.files import VIDEO_SUFFIXES, absence, read_text
from kinebench_drake.io.jsonl import as_object, as_type, parse_json

Row = Mapping[str, object]

_FILES = ("file_name", "video_file_name")
_MOST_ROWS = 200_000
_PROMPTS = ("text", "prompt", "caption", "instruction")
LABELS = "metadata.jsonl"
"""Metadata file that is written."""


def label_row(video: str, prompt: str, labels: Row) -> Row:
    """Return a row to write, of a video's name relative to the file."""
    return {_FILES[0]: video, _PROMPTS[0]: prompt, **labels}


def list_metadata(path: Path, search: Search) -> list[VideoSample]:
    """List the videos that a metadata file names.

    Raises:
        InputError: it cannot be read, or names no video.
    """
    samples = add_labels([], [path], search)
    if not samples:
        raise InputError(f"names no video; expected a column file_name with {', '.join(sorted(VIDEO_SUFFIXES))} files")
    return samples


def add_labels(samples: Sequence[VideoSample], files: Sequence[Path], search: Search) -> list[VideoSample]:
    """Return the samples with the labels of metadata files, and a sample with a problem for every missing video.

    The files are ordered from the top folder down: the one nearest to a video takes precedence.
    """
    labels: dict[Path, tuple[Row, Path]] = {}
    added: dict[Path, VideoSample] = {}
    problems: list[VideoSample] = []
    listed = {sample.path for sample in samples}
    for file in files:
        unnamed = 0
        for row in _read_rows(file, search):
            name = next((row[key] for key in _FILES if isinstance(row.get(key), str)), None)
            if not isinstance(name, str) or Path(name).suffix.lower() not in VIDEO_SUFFIXES:
                unnamed += 1
                continue
            try:
                path = join_relative(file.parent, name, "file_name")
            except InputError as error:
                problems.append(replace(search.sample(file), id=Path(name).stem, video=name, problem=str(error)))
                continue
            labels[path] = row, file
            if path not in listed:
                problem = None if path.is_file() else f"{name}: {absence(path)} ({file.name} names it)"
                added[path] = replace(search.sample(path), problem=problem)
        if unnamed:
            search.warnings.append(f"{search.name(file)}: {unnamed} of its rows name no video ({', '.join(_FILES)})")
    labelled = [_add_label(s, *labels[s.path]) if s.path in labels else s for s in (*samples, *added.values())]
    return [*labelled, *problems]


def _add_label(sample: VideoSample, row: Row, file: Path) -> VideoSample:
    """Return the sample with the values of a row that have the right type: columns may have any meaning."""
    seed = _number(row.get("seed"), -math.inf, math.inf)
    return replace(
        sample,
        task=as_type(row.get("task"), str) or None,
        model=as_type(row.get("model"), str) or None,
        seed=None if seed is None or seed != int(seed) else int(seed),
        prompt=next((text for key in _PROMPTS if (text := as_type(row.get(key), str))), None),
        dataset_period_s=_number(row.get("frame_period_s"), MIN_PERIOD_S, MAX_PERIOD_S),
        first_frame=_image(row.get("first_frame"), file.parent) or sample.first_frame,
    )


def _number(value: object, least: float, most: float) -> float | None:
    """Return a number in a range, also one written as text as in csv files; None for other values."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return None
    return number if math.isfinite(number) and least <= number <= most else None


def _image(name: object, folder: Path) -> Path | None:
    try:
        path = join_relative(folder, name, "first_frame") if isinstance(name, str) else None
    except InputError:
        return None
    return path if path is not None and path.is_file() else None


def _read_rows(file: Path, search: Search) -> list[Row]:
    """Return the rows of a metadata file; none, with a warning, if it cannot be read."""
    try:
        if len(rows := list(islice(_READERS[file.suffix](file), _MOST_ROWS + 1))) > _MOST_ROWS:
            raise ValueError(f"it has more than {_MOST_ROWS} rows")
        return rows
    except (OSError, ValueError, MemoryError, csv.Error, InputError) as error:
        search.warnings.append(f"{search.name(file)} is not read ({cause(error)})")
        return []


def _jsonl(file: Path) -> Iterator[Row]:
    for line in io.StringIO(read_text(file)):
        if line.strip():
            yield as_object(parse_json(line))


def _parquet(file: Path) -> Iterator[Row]:
    with parquet.open_batches(file, every=True) as (_, batches):
        for batch in batches:
            yield from batch.to_pylist()


_READERS: Mapping[str, Callable[[Path], Iterable[Row]]] = {
    ".csv": lambda file: csv.DictReader(io.StringIO(read_text(file), newline="")),
    ".jsonl": _jsonl,
    ".parquet": _parquet,
}
NAMES = tuple(f"metadata{suffix}" for suffix in _READERS)
"""Names of metadata files."""
