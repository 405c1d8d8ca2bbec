"""Output folders of shards joined into one, as if one run had done all of it."""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.evaluation.evaluator import SCHEMA_VERSION, RunKind
from kinebench_drake.evaluation.runner import NullRunObserver, RunObserver, RunSummary, close_run, summarize
from kinebench_drake.io.atomic import atomic_path, write_atomically
from kinebench_drake.io.jsonl import dump
from kinebench_drake.report.sample import worst_samples
from kinebench_drake.results.metadata import RunMetadata, read_metadata
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.results.store import ARTIFACTS, SAMPLES, TIMINGS, ResultStore, artifact_path, read_rows
from kinebench_drake.types import Json

_BLOCK = 2**20
ASIDE = ("limit", "shard", "jobs", "engine")
"""Settings in which shards of one run may differ: they say who does what, not what comes of it."""
_CLIP = re.compile(r"(?P<id>.+)_r\d+(\.[^.]+)?")
"""Names of what a world model imagined for an episode."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ShardFolder:
    """One folder to be merged."""

    path: Path
    header: RunMetadata
    finished: bool
    """Whether its run came to its end."""
    rows: Mapping[str, SampleRow]
    clips: Mapping[str, Sequence[Path]]
    """Files and folders of frames in `videos/` by the episode they were imagined for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Taken:
    """A row and the folder whose row and files it is."""

    row: SampleRow
    part: ShardFolder


def merge_folders(folders: Sequence[Path], out: Path, observer: RunObserver | None = None) -> RunSummary:
    """Join output folders of shards of one run into `out`: rows, their files and times, numbers and report made anew.

    The folders are only read. `out` may hold an earlier merge of the same run, which is added to. A sample that two
    folders hold is taken once; where one of them has an error for it, the other's result is taken, as a run that goes
    on would. Of folders whose run was stopped the finished samples are taken, with a warning.

    Raises:
        UsageError: the folders are not of one run, hold different results of one sample or are damaged, or `out` holds
            something else.
        SetupError: writing failed.
    """
    observer = observer or NullRunObserver()
    _check_names(folders, out)
    parts = [read_part(folder) for folder in folders]
    for part in parts[1:]:
        _check_same_run(parts[0], part, "run one of them again as the other, what still holds is kept")
    for part in parts:
        for warning in _flaws(part):
            observer.warn(warning)
    if (held := _held(out)) is not None:
        _check_same_run(held, parts[0], "name another --out")
        parts.insert(0, held)
    taken = _choose(parts)
    header = _joint_header([part.header for part in parts])
    for warning in _gaps([part.header for part in parts], header, len(taken)):
        observer.warn(warning)
    new = {id: found for id, found in taken.items() if found.part is not held}
    replayed = _replayed(taken, header)
    observer.start(total=len(taken), completed=len(taken) - len(new))
    with ResultStore(out) as store:
        store.begin(header.to_json())
        for id, found in new.items():
            for source in _files(found, replayed=id in replayed):
                _copy(source, out / source.relative_to(found.part.path))
            observer.finish(found.row, 0.0)
        store.keep_files("replays", replayed)
        write_atomically(out / TIMINGS, _timings(parts, taken).encode())
        store.rows = {id: found.row for id, found in taken.items()}
        store.finish(summarize(store.sorted_rows(), header))
        return close_run(store, RunKind(header.kind), header.bootstrap_seed)


def read_part(path: Path) -> ShardFolder:
    """Read one output folder.

    Raises:
        UsageError: it is none, is damaged or does not tell what run it is of.
    """
    if not (path / SAMPLES).is_file():
        raise UsageError(f"{path}: holds no {SAMPLES}, expected the output folder of a run")
    try:
        found, rows = read_metadata(path), read_rows(path)
        clips = _clips(path, rows)
    except (InputError, OSError) as error:
        raise UsageError(str(error)) from None
    if found is None:
        raise UsageError(
            f"{path}: does not tell what run it is of (neither results.json nor run.json); run the same command again "
            "to finish it"
        )
    header = found.header
    if header.schema_version != SCHEMA_VERSION:
        raise UsageError(
            f"{path}: has schema_version {header.schema_version}, this program writes {SCHEMA_VERSION}; run the same "
            "command again with this version"
        )
    kinds = [kind.value for kind in RunKind]
    if header.kind not in kinds:
        raise UsageError(f"{path}: is of a run of kind {header.kind!r}, expected one of {', '.join(kinds)}")
    return ShardFolder(path=path, header=header, finished=found.finished, rows=rows, clips=clips)


def _clips(path: Path, rows: Mapping[str, SampleRow]) -> dict[str, list[Path]]:
    clips: dict[str, list[Path]] = {}
    folder = path / "videos"
    for clip in sorted(folder.iterdir()) if folder.is_dir() else ():
        match = _CLIP.fullmatch(clip.name)
        if match and match["id"] in rows:
            clips.setdefault(match["id"], []).append(clip)
    return clips


def _check_names(folders: Sequence[Path], out: Path) -> None:
    if not folders:
        raise UsageError("no folder named, expected the output folders of shards")
    seen: set[Path] = set()
    for folder in folders:
        if out.resolve().is_relative_to(folder.resolve()):
            raise UsageError(f"--out {out}: is or lies in {folder}, which is to be merged and only read; name another")
        if folder.resolve() in seen:
            raise UsageError(f"{folder}: named twice")
        seen.add(folder.resolve())


def _held(out: Path) -> ShardFolder | None:
    """What `out` holds from an earlier merge.

    Raises:
        UsageError: it holds something else.
    """
    if not out.is_dir():
        return None
    files = (file for file in out.rglob("*") if file.is_file() and ".part." not in file.name)
    if (stranger := next((file for file in files if file != out / SAMPLES or file.stat().st_size), None)) is None:
        return None
    try:
        return read_part(out)
    except UsageError:
        raise UsageError(
            f"--out {out}: holds something else (such as {stranger.relative_to(out)}); name a new or empty folder"
        ) from None


def _check_same_run(one: ShardFolder, other: ShardFolder, fix: str) -> None:
    """Hold two folders against each other.

    Raises:
        UsageError: they are not of one run.
    """
    a, b = _identity(one.header), _identity(other.header)
    differing = [name for name in {**a, **b} if a.get(name) != b.get(name)]
    if not differing:
        return
    told = "; ".join(f"{name} is {_brief(a.get(name))} and {_brief(b.get(name))}" for name in differing)
    raise UsageError(f"{one.path} and {other.path} are not shards of one run: {told}; {fix}")


def _identity(header: RunMetadata) -> dict[str, Json]:
    """All in which shards of one run agree."""
    return {
        "kind": header.kind,
        "suite_version": header.suite_version,
        "code_sha256": header.code_sha256,
        "weights_sha256": header.weights_sha256,
        "samples_found": header.samples_found,
        "tags": dict(header.tags),
        **{name: value for name, value in header.config.items() if name not in ASIDE},
    }


def _brief(value: Json) -> str:
    text = json.dumps(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def _choose(parts: Sequence[ShardFolder]) -> dict[str, Taken]:
    """A row for every id, sorted.

    Raises:
        UsageError: two folders hold different results of one sample.
    """
    taken: dict[str, Taken] = {}
    for part in parts:
        for id, row in part.rows.items():
            before = taken.get(id)
            if before is None or _supersedes(row, before.row):
                taken[id] = Taken(row=row, part=part)
            elif not _supersedes(before.row, row) and dump(before.row.to_json()) != dump(row.to_json()):
                raise UsageError(
                    f"{before.part.path} and {part.path} hold different results of {id!r}: leave out the folder that "
                    "is out of date"
                )
    return dict(sorted(taken.items()))


def _supersedes(row: SampleRow, other: SampleRow) -> bool:
    """Whether `row` came of the same sample, which had failed before."""
    return row.content_hash == other.content_hash and row.status is not Status.ERROR and other.status is Status.ERROR


def _joint_header(headers: Sequence[RunMetadata]) -> RunMetadata:
    """The header of the run as a whole; what its machines do not share is null, of versions all are told."""
    limits = [header.config.get("limit") for header in headers]
    numbers = [limit for limit in limits if isinstance(limit, int)]
    first = headers[0]
    joint = first.with_config(
        limit=max(numbers) if len(numbers) == len(limits) else None,
        shard=None,
        **{name: _shared([h.config.get(name) for h in headers]) for name in ("jobs", "engine")},
    )
    return replace(
        joint,
        versions={
            name: ", ".join(sorted({str(h.versions.get(name)) for h in headers}))
            if name in _unlike_versions(headers)
            else value
            for name, value in first.versions.items()
        },
        host={name: _shared([h.host.get(name) for h in headers]) for name in first.host},
    )


def _shared(values: Sequence[Json]) -> Json:
    return values[0] if all(value == values[0] for value in values) else None


def _unlike_versions(headers: Sequence[RunMetadata]) -> list[str]:
    first = headers[0].versions
    return [name for name in first if any(header.versions.get(name) != first[name] for header in headers)]


def _flaws(part: ShardFolder) -> Iterator[str]:
    """What is wrong with a folder that can be merged all the same."""
    if not part.finished:
        yield (
            f"{part.path}: its run has not ended; the {len(part.rows)} samples finished so far are taken (run the same "
            "command again, then merge again)"
        )
    lost = [id for id, row in part.rows.items() if row.status is Status.OK and not _track(part, id).is_file()]
    if lost:
        yield f"{part.path}: {len(lost)} samples lack their tracks (such as {lost[0]!r}): was all of it copied?"


def _gaps(headers: Sequence[RunMetadata], joint: RunMetadata, samples: int) -> Iterator[str]:
    """What the folders together leave open."""
    if unlike := _unlike_versions(headers):
        yield f"the shards were made with different versions of {', '.join(unlike)}; results.json names them all"
    if samples < joint.planned:
        yield f"{joint.planned - samples} of {joint.planned} samples are absent{_absent_shards(headers)}"


def _absent_shards(headers: Sequence[RunMetadata]) -> str:
    shards = [shard for header in headers if (shard := header.shard) is not None]
    counts = {shard.count for shard in shards}
    if len(counts) != 1:
        return ""
    (count,) = counts
    absent = sorted(set(range(1, count + 1)) - {shard.index for shard in shards})
    named = ", ".join(f"{index}/{count}" for index in absent[:8]) + (", ..." if len(absent) > 8 else "")
    return f": no folder is of shard {named}" if absent else ""


def _track(part: ShardFolder, id: str) -> Path:
    return artifact_path(part.path, "tracks", id)


def _replayed(taken: Mapping[str, Taken], header: RunMetadata) -> set[str]:
    """Samples whose replays one run would have written: each shard wrote those of its own worst."""
    most = header.config.get("replays")
    if not isinstance(most, int):
        return set(taken)
    return set(worst_samples((found.row for found in taken.values()), lambda id: _track(taken[id].part, id), most))


def _files(found: Taken, *, replayed: bool) -> Iterator[Path]:
    """Every file of a sample."""
    for part in ARTIFACTS:
        path = artifact_path(found.part.path, part, found.row.id)
        if path.is_file() and (part != "replays" or replayed):
            yield path
    for clip in found.part.clips.get(found.row.id, ()):
        yield from (file for file in sorted(clip.rglob("*")) if file.is_file()) if clip.is_dir() else (clip,)


def _copy(source: Path, target: Path) -> None:
    """Copy a file's bytes. No link: whoever changes the copy later shall not change the shard.

    Raises:
        UsageError: the source cannot be read.
        SetupError: writing failed.
    """
    with atomic_path(target) as part, part.open("wb") as copy:
        copy.writelines(_blocks(source))


def _blocks(source: Path) -> Iterator[bytes]:
    """A file's bytes, piece by piece. What fails here is not told as a failure to write.

    Raises:
        UsageError: it cannot be read.
    """
    try:
        with source.open("rb") as file:
            while block := file.read(_BLOCK):
                yield block
    except OSError as error:
        raise UsageError(f"{source}: cannot be read ({error.strerror or error})") from None


def _timings(parts: Sequence[ShardFolder], taken: Mapping[str, Taken]) -> str:
    """Lines of all folders about the samples taken from them."""
    lines = []
    for part in parts:
        path = part.path / TIMINGS
        for line in path.read_text(errors="replace").splitlines() if path.is_file() else ():
            try:
                id = json.loads(line).get("id")
            except (ValueError, AttributeError, RecursionError):
                continue  # torn by a crash
            if isinstance(id, str) and id in taken and taken[id].part is part:
                lines.append(line + "\n")
    return "".join(lines)
