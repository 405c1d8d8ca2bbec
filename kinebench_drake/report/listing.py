"""The samples of a page beyond the first ones: one compact line each, compressed, unfolded by the page's script."""

import base64
import json
import zlib
from collections.abc import Hashable, Sequence
from pathlib import Path

from kinebench_drake.io.jsonl import as_object
from kinebench_drake.metrics.trust import TRUST, TrustLevel
from kinebench_drake.report.metric import Metric
from kinebench_drake.report.sample import VERDICT_LABELS, VIDEOS, explain, is_viewable, numeric_value, verdict_of
from kinebench_drake.report.table import format_value
from kinebench_drake.report.timeline import anomalies_of
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.store import artifact_path

LOST = "lost frames"


def fault_chips(row: SampleRow) -> list[tuple[str, str]]:
    """List the kinds of faults of a sample once each, and trust that needs a look, with the class of their colour."""
    chips = [(str(v["kind"]), "") for v in row.violations] + [(str(a["kind"]), "anomaly") for a in anomalies_of(row)]
    lost = [(LOST, "lost")] if "lost" in row.executable_reasons else []
    level = as_object(row.extra.get(TRUST)).get("level")
    trust = [(f"trust: {level}", "lost")] if level in (TrustLevel.CHECK.value, TrustLevel.UNKNOWN.value) else []
    return list(dict.fromkeys((kind.replace("_", " "), css) for kind, css in [*chips, *lost, *trust]))


def pack_listing(out: Path, rows: Sequence[SampleRow], columns: Sequence[Metric]) -> str:
    """Return the rows as base64 of deflated JSON (RFC 1950), which browsers unpack without a library.

    The JSON is an object of `rows` and of the lists that their numbers refer to. A row: id, video, task, model,
    verdict, whether it is executable, number of faults, chips, prompt, links (1: a track, 2: a replay, then 4, 8, ...
    in the order of VIDEOS), explanation, and the texts of `columns`, joined by "|".

    Args:
        out: the output folder.
        rows: the samples.
        columns: metrics of the table.
    """
    lists: dict[str, dict[Hashable, int]] = {name: {} for name in ("tasks", "models", "chips", "prompts")}

    def number(name: str, value: Hashable) -> int:
        return lists[name].setdefault(value, len(lists[name]))

    verdicts = list(VERDICT_LABELS)
    lines = []
    for row in rows:
        links = [is_viewable(out, row), *(artifact_path(out, kind, row.id).is_file() for kind in ("replays", *VIDEOS))]
        values = (numeric_value(row, metric.name) for metric in columns)
        texts = ("" if x is None else format_value(x, m.pattern) for x, m in zip(values, columns, strict=True))
        lines.append(
            [
                row.id,
                row.video,
                number("tasks", row.task),
                number("models", row.model),
                verdicts.index(verdict_of(row)),
                int(bool(row.executable)),
                len(row.violations) + len(anomalies_of(row)),
                number("chips", tuple(fault_chips(row))),
                number("prompts", str(row.extra.get("prompt") or "")),
                sum(2**k for k, link in enumerate(links) if link),
                explain(row),
                "|".join(texts),
            ]
        )
    data = {
        "rows": lines,
        **{name: list(values) for name, values in lists.items()},
        "verdicts": list(VERDICT_LABELS.items()),
        "videos": list(VIDEOS.items()),
    }
    text = json.dumps(data, separators=(",", ":"), ensure_ascii=False)
    return base64.b64encode(zlib.compress(text.encode(errors="replace"), 9)).decode()
