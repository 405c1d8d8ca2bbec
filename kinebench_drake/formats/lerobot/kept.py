"""Copy of a LeRobot dataset (v2, v3) with some of its episodes.

Rows and metadata are renumbered. Videos are copied as they are: files of v3 may hold the frames of other episodes, too,
to which nothing refers any more.
"""

import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from kinebench_drake.errors import InputError, cause
from kinebench_drake.formats.lerobot.dataset import (
    EPISODE,
    EPISODES,
    FRAME,
    INFO,
    PLACE,
    LeRobotDataset,
    LeRobotEpisode,
)
from kinebench_drake.io.atomic import atomic_folder
from kinebench_drake.io.jsonl import as_object, read_lines, write_json, write_lines

_LISTS = ("episodes.jsonl", "episodes_stats.jsonl")  # of v2: one line an episode
_STATS = Path("meta") / "stats.json"

Statistics = dict[str, dict[str, Any]]
"""Numbers by feature and kind: min, max, mean, std, quantiles, count."""


def write_kept(source: Path, target: Path, numbers: Iterable[int]) -> None:
    """Write the episodes of a dataset with these numbers to a new folder.

    Raises:
        InputError: no episode is left, the dataset is damaged, or writing failed.
    """
    dataset = LeRobotDataset.open(source)
    wanted = set(numbers)
    kept = [episode for episode in dataset.episodes() if episode.number in wanted]
    if not kept:
        raise InputError("no episode is left")
    try:
        with atomic_folder(target) as work:
            for file in (source / "meta").rglob("*"):
                if file.is_file() and file.name not in _LISTS and source / "meta" / "episodes" not in file.parents:
                    _copy(source, work, file)
            lengths, statistics = (_write_v2 if dataset.is_v2 else _write_v3)(dataset, work, kept)
            if statistics and (source / _STATS).is_file():
                write_json(work / _STATS, _join(statistics))
            totals: dict[str, Any] = {"total_episodes": len(kept), "total_frames": sum(lengths)}
            if "total_videos" in dataset.info:
                totals["total_videos"] = len(kept) * len(list(dataset.cameras()))
            write_json(work / INFO, {**dataset.info, **totals, "splits": {"train": f"0:{len(kept)}"}})
    except (OSError, KeyError, ValueError, pa.ArrowException) as error:
        raise InputError(f"the episodes cannot be copied ({cause(error)})") from None


def _write_v3(
    dataset: LeRobotDataset, work: Path, kept: Sequence[LeRobotEpisode]
) -> tuple[list[int], list[Statistics]]:
    """Write rows, videos and the list of episodes of v3; return the length and the statistics of each."""
    source = dataset.folder
    places = {episode.number: k for k, episode in enumerate(kept)}
    files = sorted((source / "meta" / "episodes").glob("**/*.parquet"))
    table = pa.concat_tables([pq.read_table(file) for file in files], promote_options="default")
    rows = [row for row in table.to_pylist() if row[EPISODE] in places]
    rows.sort(key=lambda row: places[row[EPISODE]])
    lengths = [int(row["length"]) for row in rows]
    starts = [0, *accumulate(lengths)]
    for path in dict.fromkeys(episode.data for episode in kept):
        _copy_rows(path, work / path.relative_to(source), places, starts)
    for k, row in enumerate(rows):
        for camera in dataset.cameras():
            if f"videos/{camera}/{PLACE[0]}" in row:
                path, _ = dataset.video_part(replace(kept[k], row=row), camera)
                _copy(source, work, path)
        moved = {"episode_index": k - row[EPISODE], "index": starts[k] - row["dataset_from_index"]}
        for key, value in row.items():
            feature, kind = key.split("/")[1:] if key.count("/") == 2 else ("", "")
            if key.startswith("stats/") and feature in moved and kind not in ("std", "count"):
                row[key] = [number + moved[feature] for number in value]
        row |= {EPISODE: k, "dataset_from_index": starts[k], "dataset_to_index": starts[k + 1]}
        row |= {f"meta/episodes/{key}": 0 for key in PLACE}
    path = work / EPISODES.format(**dict.fromkeys(PLACE, 0))
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.Table.from_pylist(rows, table.schema), path)
    keys = [key.removeprefix("stats/").rpartition("/") for key in table.column_names if key.startswith("stats/")]
    statistics: list[Statistics] = [{feature: {} for feature, _, _ in keys} for _ in rows if keys]
    for row, own in zip(rows, statistics, strict=False):
        for feature, _, kind in keys:
            own[feature][kind] = row[f"stats/{feature}/{kind}"]
    return lengths, statistics


def _write_v2(
    dataset: LeRobotDataset, work: Path, kept: Sequence[LeRobotEpisode]
) -> tuple[list[int], list[Statistics]]:
    """Write rows, videos and lists of v2; return the length and, of v2.1, the statistics of each episode."""
    source = dataset.folder
    places = {episode.number: k for k, episode in enumerate(kept)}
    lengths = [pq.read_metadata(episode.data).num_rows for episode in kept]
    starts = [0, *accumulate(lengths)]
    for k, episode in enumerate(kept):
        for path in (episode.data, *(dataset.video_part(episode, camera)[0] for camera in dataset.cameras())):
            chunk = f"chunk-{k // dataset.chunk:03d}"
            parts = [chunk if part.startswith("chunk-") else part for part in path.relative_to(source).parent.parts]
            target = work.joinpath(*parts, f"episode_{k:06d}{path.suffix}")
            if path.suffix == ".parquet":
                _copy_rows(path, target, places, starts)
            else:
                _copy(source, work, path, target)
    statistics: list[Statistics] = []
    for name in _LISTS:
        if (source / "meta" / name).is_file():
            rows: list[dict[str, Any]] = [dict(row) for row in read_lines(source / "meta" / name, as_object)]
            rows = sorted((row for row in rows if row.get(EPISODE) in places), key=lambda row: places[row[EPISODE]])
            write_lines(work / "meta" / name, ({**row, EPISODE: places[row[EPISODE]]} for row in rows))
            statistics = [dict(row["stats"]) for row in rows if "stats" in row]
    return lengths, statistics


def _copy_rows(path: Path, target: Path, places: Mapping[int, int], starts: Sequence[int]) -> None:
    """Copy the rows of the kept episodes, with their new numbers `places` and the first rows `starts` of each."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with pq.ParquetFile(path) as file, pq.ParquetWriter(target, file.schema_arrow) as writer:
        for batch in file.iter_batches():
            old = batch.column(EPISODE).to_numpy()
            mask = np.isin(old, list(places))
            new = np.array([places[number] for number in old[mask].tolist()], dtype=np.int64)
            rows = pa.Table.from_batches([batch]).filter(pa.array(mask))
            for name, values in ((EPISODE, new), ("index", np.array(starts)[new] + rows[FRAME].to_numpy())):
                where = rows.schema.get_field_index(name)
                if where >= 0:
                    rows = rows.set_column(
                        where, rows.schema.field(name), pa.array(values, rows.schema.field(name).type)
                    )
            if rows.num_rows:
                writer.write_table(rows)


def _copy(source: Path, work: Path, path: Path, target: Path | None = None) -> None:
    target = target or work / path.relative_to(source)
    if not target.exists():
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, target)


def _join(statistics: Sequence[Statistics]) -> Statistics:
    """Return statistics over all episodes; quantiles are weighted means of those of the episodes, as LeRobot's."""
    joined: Statistics = {}
    for feature in statistics[0]:
        own = [each[feature] for each in statistics if feature in each]
        count = np.array([float(np.ravel(each["count"])[0]) for each in own])
        weight = count / count.sum()
        values = {kind: np.array([np.asarray(each[kind], dtype=np.float64) for each in own]) for kind in own[0]}
        mean = np.tensordot(weight, values["mean"], 1)
        variance = np.tensordot(weight, values["std"] ** 2 + (values["mean"] - mean) ** 2, 1)
        fixed = {"min": values["min"].min(axis=0), "max": values["max"].max(axis=0), "std": np.sqrt(variance)}
        joined[feature] = {kind: np.tensordot(weight, own, 1).tolist() for kind, own in values.items()}
        joined[feature] |= {kind: value.tolist() for kind, value in fixed.items()} | {"count": [int(count.sum())]}
    return joined
