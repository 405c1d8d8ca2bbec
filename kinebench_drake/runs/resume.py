"""Resumption of a run: which stored rows are kept, and which samples are evaluated."""

from collections.abc import Callable, Sequence

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.results.metadata import RunMetadata, read_metadata
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import ResultStore
from kinebench_drake.runs.evaluator import Evaluator, ResourcesT, SampleT

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
    current = {s.id for s in samples if s.id in store.rows and evaluator.is_current(s, store.rows[s.id])}
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
