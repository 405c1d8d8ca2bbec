"""`report.html`: the self-contained page of one output folder."""

import hashlib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.io.jsonl import Json, as_object
from kinebench_drake.metrics.executable import LOST, UNCHECKED, reason_kind
from kinebench_drake.metrics.trust import trust_lines
from kinebench_drake.report.horizon import draw_horizon, horizon_lines
from kinebench_drake.report.metric import BY_NAME, Metric, layout_of
from kinebench_drake.report.run import read_results
from kinebench_drake.report.sample import (
    badness,
    goodness,
    has_thumbnail,
    numeric_value,
    view_sample,
)
from kinebench_drake.report.table import template_environment
from kinebench_drake.report.timeline import SEVERITY_UNITS
from kinebench_drake.report.verdict import (
    GOOD_VERDICTS,
    VERDICT_LABELS,
    describe_trust,
    explain_verdict,
    follow_lines,
    name_verdict,
    verdict_of,
)
from kinebench_drake.results.aggregate import Aggregate, RunStatistics, split_rows
from kinebench_drake.results.drops import GATED, Drop, DropReason, list_drops
from kinebench_drake.results.inputs import input_lines
from kinebench_drake.results.row import VERDICT_SHARES, SampleRow, Status
from kinebench_drake.results.store import ARTIFACTS, REPORT, RESULTS, read_rows

PICTURED = 100
"""Samples, the worst first, whose images are on the page, and that its table shows until all are requested: all would
make it slow to open."""
DRAWN = 20
"""Samples, the worst first, whose curves are on the page: those of one take a quarter of a second to draw."""
_HEAD = 2048
"""Characters at the beginning of a page that hold its stamp."""
LISTED = 1000
"""Samples in the table."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleGroup:
    """Samples that share a task or a model."""

    name: str
    total: Aggregate
    verdicts: Mapping[str, int]
    """Samples of each verdict that occurs, the worst verdict first."""


def write_report(out: Path, rows: Iterable[SampleRow] | None = None, statistics: RunStatistics | None = None) -> Path:
    """Write `report.html` from the rows and files of an output folder; the same folder gives the same bytes.

    Args:
        rows: its rows; None: they are read.
        statistics: their statistics; None: they are computed.
    """
    path = out / REPORT
    write_atomically(path, build_page(out, rows, statistics).encode())
    return path


def is_report_current(out: Path) -> bool:
    """Return whether `report.html` is that of the present `results.json` and files."""
    path = out / REPORT
    try:
        written = path.stat().st_mtime_ns
        with path.open(errors="replace") as page:
            head = page.read(_HEAD)
        folders = [folder for kind in ARTIFACTS if (folder := out / kind).is_dir()]
        return _stamp(out) in head and all(folder.stat().st_mtime_ns < written for folder in folders)
    except OSError:
        return False


def _stamp(out: Path) -> str:
    """Return the SHA-256 of `results.json`, which a page is of and which has the version of the program."""
    path = out / RESULTS
    return hashlib.sha256(path.read_bytes() if path.is_file() else b"").hexdigest()


def build_page(out: Path, rows: Iterable[SampleRow] | None = None, statistics: RunStatistics | None = None) -> str:
    """Build the html of an output folder's report.

    Args:
        rows: its rows; None: they are read.
        statistics: their statistics; None: they are computed.
    """
    rows = sorted(read_rows(out).values() if rows is None else rows, key=badness)
    results = read_results(out)
    statistics = statistics or RunStatistics.of(rows, _bootstrap_seed(results))
    total = statistics.total
    layout = layout_of(results)
    worst, best = choose_gallery(out, rows)
    large = {row.id for row in (*worst, *best)}
    samples = [
        view_sample(out, row, pictured=k < PICTURED or row.id in large, drawn=k < DRAWN or row.id in large)
        for k, row in enumerate(rows)
        if k < LISTED or row.id in large
    ]
    views = {sample.row.id: sample for sample in samples}
    columns = [BY_NAME[n] for n in layout.columns if _is_measured(total, n)]
    templates = template_environment()
    templates.filters |= {
        "chips": _fault_chips,
        "label": VERDICT_LABELS.__getitem__,
        "verdict": verdict_of,
        "named": name_verdict,
        "explanation": explain_verdict,
        "trust": describe_trust,
        "severity_unit": lambda kind: SEVERITY_UNITS.get(kind, ""),
    }
    return templates.get_template("page.html.j2").render(
        title=_title(results),
        stamp=_stamp(out),
        results=results,
        inputs=[*follow_lines(rows), *input_lines(rows), *trust_lines(rows)],
        total=total,
        drops=_group_drops(list_drops(sorted(rows, key=lambda row: row.id))) if results.get("kind") in GATED else [],
        headlines=[(BY_NAME[n], total.estimates[n]) for n in layout.headlines if _is_measured(total, n)],
        metrics=[
            (m, total.estimates[m.name])
            for m in (*BY_NAME.values(), *_other_metrics(total))
            if _is_measured(total, m.name)
        ],
        groups=[(key, groups) for key in ("task", "model") if (groups := _group_rows(rows, key, statistics))],
        horizon=draw_horizon(out, rows),
        horizon_lines=horizon_lines(rows, _bootstrap_seed(results)),
        gallery=[(title, [views[row.id] for row in chosen]) for title, chosen in (("Worst", worst), ("Best", best))]
        if large
        else [],
        columns=columns,
        shares=[BY_NAME[n] for n in layout.shares if _is_measured(total, n)],
        samples=samples,
        pictured=any(sample.thumbnail for sample in samples),
        large=large,
        first=PICTURED,
        drawn=min(DRAWN, len(samples)),
        left_out=max(len(rows) - DRAWN, 0),
        unlisted=len(rows) - len(samples),
        counts=_count_verdicts(rows),
        numeric_value=numeric_value,
        Status=Status,
    )


def _group_drops(drops: Sequence[Drop]) -> list[tuple[DropReason, list[Drop]]]:
    """Group a drop list by reason; the reasons that occur."""
    groups = ((reason, [drop for drop in drops if drop.reason is reason]) for reason in DropReason)
    return [(reason, group) for reason, group in groups if group]


def _bootstrap_seed(results: Mapping[str, Json]) -> int:
    """Return the seed of the resampling of a run's intervals."""
    seed = as_object(results.get("seeds")).get("bootstrap", 0)
    return seed if isinstance(seed, int) else 0


def _group_rows(rows: Sequence[SampleRow], key: str, statistics: RunStatistics) -> list[SampleGroup]:
    """Group rows by `task` or `model`, sorted by name; rows without one are left out."""
    return [
        SampleGroup(name=name, total=statistics.groups[key][name], verdicts=_count_verdicts(group))
        for name, group in split_rows(rows, key).items()
    ]


def _count_verdicts(rows: Sequence[SampleRow]) -> dict[str, int]:
    """Count the verdicts that occur, in the order of their labels."""
    verdicts = Counter(map(verdict_of, rows))
    return {verdict: verdicts[verdict] for verdict in VERDICT_LABELS if verdict in verdicts}


def choose_gallery(out: Path, rows: Sequence[SampleRow], most: int = 6) -> tuple[list[SampleRow], list[SampleRow]]:
    """Choose the worst samples with an image, of those that are not good, and the best of the good ones."""
    pictured = [row for row in rows if has_thumbnail(out, row)]
    good = [row for row in pictured if verdict_of(row) in GOOD_VERDICTS]
    worst = [row for row in pictured if verdict_of(row) not in GOOD_VERDICTS]
    return worst[:most], sorted(good, key=goodness)[:most]


def _title(results: Mapping[str, Json]) -> str:
    """Return the input of a run, or its model and suite."""
    config = as_object(results.get("config"))
    if "suite" in config:
        return f"{config.get('world_model')}, suite {config['suite']} ({config.get('split')})"
    return str(config.get("source") or "Report")


def _other_metrics(total: Aggregate) -> list[Metric]:
    """List metrics without a label, except noise floors, which mean nothing without their track."""
    names = [name for name in total.estimates if name not in {*BY_NAME, *VERDICT_SHARES} and "_floor_" not in name]
    return [Metric(name=name, label=name, pattern="{:.4g}", meaning="") for name in names]


def _is_measured(total: Aggregate, name: str) -> bool:
    return name in total.estimates and total.estimates[name].n > 0


def _fault_chips(row: SampleRow) -> list[tuple[str, str]]:
    """List the kinds of faults of a sample once each, with the class of their colour."""
    chips = [(v.kind.value, "") for v in row.violations] + [(a.kind.value, "anomaly") for a in row.anomalies]
    lost = [(reason, "lost") for reason in row.executable_reasons if reason_kind(reason) in (LOST, UNCHECKED)]
    lost += [("motionless", "lost")] if row.metrics.motionless else []
    return list(dict.fromkeys((kind.replace("_", " "), css) for kind, css in [*chips, *lost]))
