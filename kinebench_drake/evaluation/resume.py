"""What a run may keep of what its folder holds, and what it must not lose."""

from collections.abc import Callable, Sequence

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.evaluation.evaluator import Evaluator, ResourcesT, SampleT
from kinebench_drake.results.metadata import RunMetadata, read_metadata
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import ResultStore

_SUBJECT = ("source", "suite", "split", "variant", "world_model")
"""What results are of, by keys of a run's configuration; options that say how may change."""


def resume(
    store: ResultStore,
    samples: Sequence[SampleT],
    chosen: Sequence[SampleT],
    measure: Evaluator[SampleT, ResourcesT],
    header: RunMetadata,
    warned: Callable[[str], None],
) -> list[SampleT]:
    """Drop kept rows that no longer hold; return the samples still to do. The folder is this run's from here on.

    Rows of samples that are not `chosen` stay only if they hold, too: what results tell of the run is true of all rows.

    Args:
        store: the folder, opened.
        samples: all that there are.
        chosen: those that this run is to do.
        measure: tells which rows hold.
        header: what the folder is to tell of the run.
        warned: told of rows that are dropped.

    Raises:
        UsageError: finished rows would be lost that this run does not measure anew.
    """
    known, doing = {sample.id for sample in samples}, {sample.id for sample in chosen}
    held = {s.id for s in samples if s.id in store.rows and measure.holds(s, store.rows[s.id])}
    waiting = [s for s in chosen if s.id not in held or store.rows[s.id].status is Status.ERROR]  # whose cause may go
    finished = {id for id, row in store.rows.items() if row.status is not Status.ERROR}
    lost = sorted(finished - held)
    strangers = sorted(store.rows.keys() - known)
    outdated = sorted((finished - held) & (known - doing))
    before = _header(store)
    if before is not None and lost and (differs := _subject(before, header)):
        raise _loss(store, lost, differs)
    # Of a folder a file may have been removed; a suite's episodes are all there, and were left out.
    if strangers and (len(strangers) == len(store.rows) or "source" not in header.config):
        raise _loss(store, strangers, f"not among the {len(samples)} {measure.kind.noun} named now")
    if outdated:
        raise _loss(store, outdated, "of other input, options or code, and not among those to be done now")
    if strangers:
        warned(
            f"{len(strangers)} earlier results are dropped: they are not among the {len(samples)} {measure.kind.noun} "
            f"named now (such as {strangers[0]!r})"
        )
    if waiting or strangers:
        store.begin(header.to_json())
    kept = held - {s.id for s in waiting}
    store.keep(lambda row: row.id in kept)
    return waiting


def _header(store: ResultStore) -> RunMetadata | None:
    """What run the kept rows are of; None where there are none, or nothing tells.

    Raises:
        UsageError: it is damaged.
    """
    try:
        found = read_metadata(store.out) if store.rows else None
    except InputError as error:
        raise UsageError(f"--out {error}; --overwrite starts anew") from None
    return None if found is None else found.header


def _subject(before: RunMetadata, now: RunMetadata) -> str:
    """What tells that results are of something else than this run's, which the user may mean to read; else nothing."""
    if before.kind != now.kind:
        return f"of a run of kind {before.kind}, this one is of kind {now.kind}"
    for key in _SUBJECT:
        was, is_now = before.config.get(key), now.config.get(key)
        if was != is_now:
            return f"of {key.replace('_', ' ')} {was!r}, this run is of {is_now!r}"
    return ""


def _loss(store: ResultStore, ids: Sequence[str], why: str) -> UsageError:
    return UsageError(
        f"--out {store.out}: {len(ids)} of its {len(store.rows)} results would be lost (such as {ids[0]!r}): they are "
        f"{why}; name another folder, or give --overwrite to drop them"
    )
