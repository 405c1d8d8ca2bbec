"""Merging of the output folders of shards into one, as if a single run had processed all samples."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from kinebench_drake.errors import InputError, UsageError, count_noun
from kinebench_drake.io.atomic import atomic_path, write_atomically
from kinebench_drake.io.jsonl import Json
from kinebench_drake.report.sample import worst_samples
from kinebench_drake.results.aggregate import RunStatistics
from kinebench_drake.results.metadata import RunMetadata, read_metadata
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.results.store import (
    ARTIFACTS,
    SAMPLES,
    TIMINGS,
    ResultStore,
    artifact_path,
    read_rows,
    require_output,
)
from kinebench_drake.runs.benchmark_registry import load_benchmark
from kinebench_drake.runs.config import RunKind
from kinebench_drake.runs.resume import SCHEMA_VERSION
from kinebench_drake.runs.runner import NullRunObserver, RunObserver, RunSummary, close_run, summarize

_SHARD_SETTINGS = ("limit", "shard", "jobs", "engine")
"""Settings in which shards of one run may differ: they distribute the work and do not affect results."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ShardFolder:
    """Output folder of one shard."""

    path: Path
    run: RunMetadata
    finished: bool
    """True if the run has ended."""
    rows: Mapping[str, SampleRow]
    episode_files: Mapping[str, Sequence[Path]]
    """Files besides artifacts, by the id of their episode; empty for runs without episodes."""

    def artifact(self, kind: str, id: str) -> Path:
        """Return the path of an artifact of a sample."""
        return artifact_path(self.path, kind, id)


def merge_folders(folders: Sequence[Path], out: Path, observer: RunObserver | None = None) -> RunSummary:
    """Merge the output folders of shards of one run into `out`: rows, artifacts and timings; compute new aggregates.

    The folders are only read. `out` may hold an earlier merge of the same run, which is extended. If two folders hold
    the same sample, a result takes precedence over an error, as in a resumed run. Of a run that was stopped the
    finished samples are used, with a warning.
    """
    observer = observer or NullRunObserver()
    _check_paths(folders, out)
    shards = [_read_shard(folder) for folder in folders]
    for shard in shards[1:]:
        _check_same_run(shards[0], shard, "run one of them again as the other, valid results are kept")
    for shard in shards:
        for warning in _shard_warnings(shard):
            observer.warn(warning)
    if (earlier := _read_earlier_merge(out)) is not None:
        _check_same_run(earlier, shards[0], "name another $out")
        shards.insert(0, earlier)
    sources = _select_samples(shards)
    rows = {id: shard.rows[id] for id, shard in sources.items()}
    run = _merge_metadata([shard.run for shard in shards])
    for warning in _merge_warnings([shard.run for shard in shards], run, len(rows)):
        observer.warn(warning)
    new = [id for id, shard in sources.items() if shard is not earlier]
    most = run.config.get("replays")
    replays = {*rows}
    if isinstance(most, int):  # a single run would have written those of its worst samples alone
        replays = {*worst_samples(rows.values(), lambda id: sources[id].artifact("tracks", id), most)}
    observer.start(total=len(rows), completed=len(rows) - len(new))
    with ResultStore(out) as store:
        store.begin(run.to_json())
        for id in new:
            for file in _sample_files(rows[id], sources[id], with_replay=id in replays):
                copy_artifact(file, out / file.relative_to(sources[id].path))
            observer.finish(rows[id], 0.0)
        store.keep_artifacts("replays", replays)
        write_atomically(out / TIMINGS, _merge_timings(shards, sources).encode())
        store.rows = rows
        statistics = RunStatistics.of(rows.values(), run.bootstrap_seed)
        store.finish(summarize(store.sorted_rows(), run, statistics))
        summary = close_run(store, RunKind(run.kind), run.bootstrap_seed, statistics)
        if run.kind == RunKind.SUITE.value:
            load_benchmark().write_requests(out, summary.pending)
        return summary


def _read_shard(path: Path) -> ShardFolder:
    """Read one output folder."""
    require_output(path)
    try:
        metadata = read_metadata(path)
        rows = read_rows(path)
    except (InputError, OSError) as error:
        raise UsageError(str(error)) from None
    if metadata is None:
        raise UsageError(
            f"{path}: lacks the metadata of its run (neither results.json nor run.json); run the same command again "
            "to finish it"
        )
    run = metadata.run
    if run.schema_version != SCHEMA_VERSION:
        raise UsageError(
            f"{path}: has schema_version {run.schema_version}, this program writes {SCHEMA_VERSION}; run the same "
            "command again with this version"
        )
    kinds = [kind.value for kind in RunKind]
    if run.kind not in kinds:
        raise UsageError(f"{path}: is of a run of kind {run.kind!r}, expected one of {', '.join(kinds)}")
    episode_files = load_benchmark().list_files(path, rows) if run.kind == RunKind.SUITE.value else {}
    return ShardFolder(path=path, run=run, finished=metadata.finished, rows=rows, episode_files=episode_files)


def _check_paths(folders: Sequence[Path], out: Path) -> None:
    if not folders:
        raise UsageError("no folder named, expected the output folders of shards")
    for k, folder in enumerate(folders):
        if out.resolve().is_relative_to(folder.resolve()):
            raise UsageError(f"$out {out}: is or lies in {folder}, which is to be merged and only read; name another")
        if folder.resolve() in {other.resolve() for other in folders[:k]}:
            raise UsageError(f"{folder}: named twice")


def _read_earlier_merge(out: Path) -> ShardFolder | None:
    """Read the earlier merge in `out`; None if there is none."""
    if not out.is_dir():
        return None
    files = (file for file in out.rglob("*") if file.is_file() and ".part." not in file.name)
    if (stranger := next((file for file in files if file != out / SAMPLES or file.stat().st_size), None)) is None:
        return None
    try:
        return _read_shard(out)
    except UsageError:
        raise UsageError(
            f"$out {out}: holds something else (such as {stranger.relative_to(out)}); name a new or empty folder"
        ) from None


def _check_same_run(one: ShardFolder, other: ShardFolder, fix: str) -> None:
    """Check that two folders are of one run."""
    a = _identity(one.run)
    b = _identity(other.run)
    differences = [name for name in {**a, **b} if a.get(name) != b.get(name)]
    if differences:
        values = "; ".join(f"{name} is {_brief(a.get(name))} and {_brief(b.get(name))}" for name in differences)
        raise UsageError(f"{one.path} and {other.path} are not shards of one run: {values}; {fix}")


def _identity(run: RunMetadata) -> dict[str, Json]:
    """Return the properties that all shards of a run share."""
    return {
        "kind": run.kind,
        "suite_version": run.suite_version,
        "code_sha256": run.code_sha256,
        "weights_sha256": run.weights_sha256,
        "samples_found": run.samples_found,
        "tags": dict(run.tags),
        **{name: value for name, value in run.config.items() if name not in _SHARD_SETTINGS},
    }


def _brief(value: Json) -> str:
    text = json.dumps(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def _select_samples(shards: Sequence[ShardFolder]) -> dict[str, ShardFolder]:
    """Select the folder whose row is taken of every id; ids are sorted."""
    sources: dict[str, ShardFolder] = {}
    for shard in shards:
        for id, row in shard.rows.items():
            before = sources.get(id)
            if before is None or _supersedes(row, before.rows[id]):
                sources[id] = shard
            elif not _supersedes(before.rows[id], row) and not row.is_same(before.rows[id]):
                raise UsageError(
                    f"{before.path} and {shard.path} hold different results of {id!r}: leave out the folder that is "
                    "out of date"
                )
    return dict(sorted(sources.items()))


def _supersedes(row: SampleRow, other: SampleRow) -> bool:
    """Return whether `row` is a result of the same sample for which `other` is an error."""
    return row.content_hash == other.content_hash and row.status is not Status.ERROR and other.status is Status.ERROR


def _merge_metadata(runs: Sequence[RunMetadata]) -> RunMetadata:
    """Return the metadata of the whole run: values that the shards do not share are null, versions are listed."""
    limits = [run.config.get("limit") for run in runs]
    numbers = [limit for limit in limits if isinstance(limit, int)]
    first = runs[0]
    return replace(
        first,
        config={
            **first.config,
            "limit": max(numbers) if len(numbers) == len(limits) else None,
            "shard": None,
            **{name: _common([run.config.get(name) for run in runs]) for name in ("jobs", "engine")},
        },
        versions={
            name: ", ".join(sorted({version for run in runs for version in str(run.versions.get(name)).split(", ")}))
            if name in _differing_versions(runs)
            else value
            for name, value in first.versions.items()
        },
        host={name: _common([run.host.get(name) for run in runs]) for name in first.host},
    )


def _common(values: Sequence[Json]) -> Json:
    return values[0] if all(value == values[0] for value in values) else None


def _differing_versions(runs: Sequence[RunMetadata]) -> list[str]:
    first = runs[0].versions
    return [name for name in first if any(run.versions.get(name) != first[name] for run in runs)]


def _shard_warnings(shard: ShardFolder) -> Iterator[str]:
    if not shard.finished:
        yield (
            f"{shard.path}: its run has not ended; {count_noun(len(shard.rows), 'sample')} finished so far merged "
            "(run the same command again, then merge again)"
        )
    ok = [id for id, row in shard.rows.items() if row.status is Status.OK]
    lost = [id for id in ok if not shard.artifact("tracks", id).is_file()]
    if lost:
        absent = f"tracks are absent of {count_noun(len(lost), 'sample')} (such as {lost[0]!r})"
        yield f"{shard.path}: {absent}: was all of it copied?"


def _merge_warnings(runs: Sequence[RunMetadata], merged: RunMetadata, samples: int) -> Iterator[str]:
    if differing := _differing_versions(runs):
        yield f"the shards were made with different versions of {', '.join(differing)}; results.json lists them all"
    if samples < merged.planned:
        yield f"{merged.planned - samples} of {merged.planned} samples are absent{_absent_shards(runs)}"


def _absent_shards(runs: Sequence[RunMetadata]) -> str:
    if any(run.shard is None for run in runs):  # an earlier merge does not say which shards it holds
        return ""
    shards = [shard for run in runs if (shard := run.shard) is not None]
    counts = {shard.count for shard in shards}
    if len(counts) != 1:
        return ""
    (count,) = counts
    absent = sorted(set(range(1, count + 1)) - {shard.index for shard in shards})
    listing = ", ".join(f"{index}/{count}" for index in absent[:8]) + (", ..." if len(absent) > 8 else "")
    return f": no folder is of shard {listing}" if absent else ""


def _sample_files(row: SampleRow, shard: ShardFolder, *, with_replay: bool) -> Iterator[Path]:
    """Yield every file of a sample."""
    kinds = [kind for kind in ARTIFACTS if kind != "replays" or with_replay]
    files = [*(shard.artifact(kind, row.id) for kind in kinds), *shard.episode_files.get(row.id, ())]
    return (file for file in files if file.is_file())


def copy_artifact(source: Path, target: Path) -> None:
    """Copy the bytes of a file. A hard link would let later changes of the copy change the shard."""
    with atomic_path(target) as part, part.open("wb") as copy:
        copy.writelines(_read_blocks(source))


def _read_blocks(source: Path) -> Iterator[bytes]:
    """Yield the bytes of a file in blocks; errors here are not reported as errors of writing."""
    try:
        with source.open("rb") as file:
            while block := file.read(2**20):
                yield block
    except OSError as error:
        raise UsageError(f"{source}: cannot be read ({error.strerror or error})") from None


def _merge_timings(shards: Sequence[ShardFolder], sources: Mapping[str, ShardFolder]) -> str:
    """Return the timings of the selected samples, each from its own folder."""
    lines = []
    for shard in shards:
        path = shard.path / TIMINGS
        for line in path.read_text(errors="replace").splitlines() if path.is_file() else ():
            try:
                id = json.loads(line).get("id")
            except (ValueError, AttributeError, RecursionError):
                continue  # torn by a crash
            if isinstance(id, str) and sources.get(id) is shard:
                lines.append(line + "\n")
    return "".join(lines)
