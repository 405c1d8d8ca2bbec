"""The gate of a data set: what a finished run writes for those who build on it, and the bounds that it must keep."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from kinebench_drake.errors import InputError, UsageError, count_noun
from kinebench_drake.formats.lerobot.kept import write_kept
from kinebench_drake.io.jsonl import write_json
from kinebench_drake.results.drops import to_sarif
from kinebench_drake.results.provenance import versions
from kinebench_drake.results.row import VERDICT_SHARES, Status
from kinebench_drake.runs.config import SourceConfig
from kinebench_drake.runs.runner import RunSummary


def close_gate(config: SourceConfig, summary: RunSummary) -> RunSummary:
    """Write the SARIF file and the kept episodes, and return the summary with the bounds that are missed."""
    if config.sarif is not None:
        write_json(config.sarif, to_sarif(summary.drops, str(versions()["kinebench_drake"])))
    if config.write_kept is not None:
        dropped = {drop.id for drop in summary.drops if drop.reason.drops_all}
        videos = [row.video for row in summary.rows if row.id not in dropped]
        try:
            write_kept(config.source, config.write_kept, [int(video.rpartition("#episode_")[2]) for video in videos])
        except InputError as error:
            raise UsageError(f"$write_kept {config.write_kept}: {error}") from None
    return replace(summary, missed=tuple(_missed(config, summary)))


def passes(summary: RunSummary) -> bool:
    """Return whether a run succeeded: something was measured or waits for a video, and no bound is missed."""
    return bool(summary.counts[Status.OK] or summary.pending) and not summary.missed


def _missed(config: SourceConfig, summary: RunSummary) -> Iterator[str]:
    """Describe the faults that no sample may have, and the means below their bounds; what is not measurable is."""
    for kind in config.faults:
        ids = {drop.id for drop in summary.drops if drop.reason.key == kind}
        ids |= {row.id for row in summary.rows if any(v.kind.value == kind for v in row.violations)}
        if ids:
            yield f"{kind}: {count_noun(len(ids), 'sample')}, such as {min(ids)}"
    for name, least in config.fail_under.items():
        if name in VERDICT_SHARES:
            share = getattr(summary, name)
            value = None if share is None else share.mean
        else:
            values = [row.bound(name) for row in summary.rows if row.status is Status.OK]
            numbers = [value for value in values if value is not None]
            value = float(np.mean(numbers)) if numbers else None
        if value is None or value < float(least):
            yield f"{name} is {'unmeasurable' if value is None else f'{value:.4g}'}, expected {least} or more"
