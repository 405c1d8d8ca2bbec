"""Resumption of a run: what makes a stored row valid, which rows are kept, and which samples are evaluated."""

import hashlib
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.io.archive import hash_file
from kinebench_drake.io.jsonl import Json, dump
from kinebench_drake.results.metadata import RunMetadata, read_metadata
from kinebench_drake.results.record import to_json
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.results.store import ResultStore
from kinebench_drake.runs.evaluator import Evaluator, ResourcesT, SampleHashes, SampleT

SCHEMA_VERSION = 2
"""Version of the format of the output folder."""
_SUBJECT = ("source", "suite", "split", "variant", "world_model")
"""Keys of a run's configuration that identify the subject of its results; the other options may change."""


def resume(
    store: ResultStore,
    samples: Sequence[SampleT],
    selected: Sequence[SampleT],
    evaluator: Evaluator[SampleT, ResourcesT],
    metadata: RunMetadata,
    warn: Callable[[str], None],
) -> list[SampleT]:
    """Drop stored rows that are no longer valid, claim the folder for this run, return the samples to evaluate.

    Rows of samples that are not selected stay only if they are valid, too: the metadata describe every row.

    Args:
        selected: samples of this run (limit, shard).

    Raises:
        UsageError: finished rows would be lost that this run does not evaluate again, or the metadata are damaged.
    """
    noun = evaluator.config.kind.noun
    ids = {sample.id for sample in samples}
    selected_ids = {sample.id for sample in selected}
    current = {s.id for s in samples if s.id in store.rows and is_current(evaluator, s, store.rows[s.id])}
    # The cause of an error may be gone: errors are evaluated again.
    waiting = [s for s in selected if s.id not in current or store.rows[s.id].status is Status.ERROR]
    finished = {id for id, row in store.rows.items() if row.status is not Status.ERROR}
    lost = sorted(finished - current)
    unlisted = sorted(store.rows.keys() - ids)
    outdated = sorted((finished - current) & (ids - selected_ids))
    try:
        stored = read_metadata(store.out) if store.rows else None
    except InputError as error:
        raise UsageError(f"$out {error}; $overwrite=True removes the earlier results") from None
    if stored is not None and lost and (difference := _subject_difference(stored.run, metadata)):
        raise _loss(store, lost, difference)
    # A file may have been removed from a folder; a suite always has all its episodes, so these were deselected.
    if unlisted and (len(unlisted) == len(store.rows) or "source" not in metadata.config):
        raise _loss(store, unlisted, f"not among the {len(samples)} {noun} named now")
    if outdated:
        raise _loss(store, outdated, "of other input, options or code, and not among those to be done now")
    if unlisted:
        warn(
            f"{len(unlisted)} earlier results are dropped: they are not among the {len(samples)} {noun} "
            f"named now (such as {unlisted[0]!r})"
        )
    if store.rows.keys() - current or any(s.id not in current for s in waiting):
        store.begin(metadata.to_json())
    store.keep_rows(lambda row: row.id in current)
    return waiting


def is_current(evaluator: Evaluator[SampleT, ResourcesT], sample: SampleT, row: SampleRow) -> bool:
    """Return whether a stored row is still valid: same content hash, all files present."""
    present = all(file.is_file() for file in evaluator.files_of(row))
    return present and row.content_hash == hash_sample(evaluator, sample).content


def hash_sample(evaluator: Evaluator[SampleT, ResourcesT], sample: SampleT) -> SampleHashes:
    """Hash all that determines a sample's row, and its input files.

    The content is labels, options, code, robot, and name and SHA-256 of each input file. The hash of the input is that
    of the only file, of several files that of `sha256sum FILES`.
    """
    config = evaluator.config
    make = config.make_resources
    key: dict[str, Json] = {
        "schema": SCHEMA_VERSION,
        "kind": config.kind.value,
        "tools": f"{make.__module__}:{make.__qualname__}",
        "code": evaluator.code,
        "table_height_m": config.robot_options().table_height_m,
        "robot": evaluator.robot_id,
        "sample": [sample.id, sample.video, sample.task, sample.model],
        **evaluator.cache_key(sample),
    }
    content = hashlib.sha256(dump(to_json(key)).encode())  # labels of a broken sample may be NaN
    digests = [(file.name.encode(errors="surrogateescape"), _digest(file)) for file in evaluator.input_files(sample)]
    for name, digest in digests:
        content.update(name + b"\0" + digest)
    if len(digests) == 1:
        return SampleHashes(content=content.hexdigest(), input=digests[0][1].hex())
    lines = b"".join(f"{digest.hex()}  ".encode() + name + b"\n" for name, digest in digests)
    return SampleHashes(content=content.hexdigest(), input=hashlib.sha256(lines).hexdigest() if lines else None)


def _digest(file: Path) -> bytes:
    """Return the SHA-256 of a file's bytes; a file shared by many samples is read once."""
    try:
        state = file.stat()
        return _digest_of(file, state.st_ino, state.st_size, state.st_mtime_ns, state.st_ctime_ns)
    except OSError as error:
        return f"unreadable: {error.strerror}".encode()


@lru_cache(maxsize=256)
def _digest_of(file: Path, *_state: int) -> bytes:
    return bytes.fromhex(hash_file(file))


def _subject_difference(before: RunMetadata, now: RunMetadata) -> str:
    """Return how the stored results differ in their subject from those of this run; empty if they do not."""
    if before.kind != now.kind:
        return f"of a run of kind {before.kind}, this one is of kind {now.kind}"
    for key in _SUBJECT:
        stored = before.config.get(key)
        current = now.config.get(key)
        if stored != current:
            return f"of {key.replace('_', ' ')} {stored!r}, this run is of {current!r}"
    return ""


def _loss(store: ResultStore, ids: Sequence[str], why: str) -> UsageError:
    return UsageError(
        f"$out {store.out}: {len(ids)} of its {len(store.rows)} results would be lost (such as {ids[0]!r}): they are "
        f"{why}; name another folder, or give $overwrite=True to drop them"
    )
