"""The html report of an output folder: content, template environment."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from kinebench_drake.errors import InputError, cause
from kinebench_drake.io.jsonl import intern_text, read_json
from kinebench_drake.report.histogram import Histogram, count_values, draw_histogram
from kinebench_drake.report.metric import BY_NAME, METRICS, Metric, MetricLayout, layout_of
from kinebench_drake.report.sample import (
    FAILURES,
    GOOD,
    RANK,
    badness,
    goodness,
    has_picture,
    number_of,
    verdict_of,
    view_sample,
)
from kinebench_drake.results.aggregate import Aggregate, Estimate, aggregate, split_rows
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.results.store import RESULTS, read_rows
from kinebench_drake.types import Json


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleGroup:
    """Samples that share a task or a model."""

    name: str
    total: Aggregate
    verdicts: Mapping[str, int]
    """Samples of each verdict that occurs, the worst verdict first."""


def group_rows(rows: Sequence[SampleRow], key: str, seed: int = 0) -> list[SampleGroup]:
    """Groups of rows by their `task` or `model`, sorted by name; rows without one are left out."""
    found = []
    for name, group in split_rows(rows, key).items():
        told = [verdict_of(row) for row in group]
        verdicts = {verdict: told.count(verdict) for verdict in RANK if verdict in told}
        found.append(SampleGroup(name=name, total=aggregate(group, seed), verdicts=verdicts))
    return found


HOME = "kinebench_drake.report"


def environment(package: str = HOME) -> Environment:
    """Templates of a package, then those that all pages share; what is put into them is escaped."""
    return Environment(
        loader=ChoiceLoader([PackageLoader(package, "."), PackageLoader(HOME, ".")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


DRAWN = 100
"""Samples, the worst first, whose curves and findings stand on the page: the rest would make it slow to open."""
PICTURED = 40
"""Samples, the worst first, whose pictures stand on the page."""
SHOWN = 100
"""Samples in the table until more are asked for."""
GALLERY = 6
"""Worst and best samples that are shown in large."""


def build_page(out: Path) -> str:
    """The html text of an output folder's report.

    Raises:
        InputError: the folder's files are broken.
    """
    rows = sorted(read_rows(out).values(), key=badness)
    results = read_results(out)
    seed = bootstrap_seed(results)
    total = aggregate(rows, seed)
    layout = layout_of(results)
    worst, best = _outstanding(out, rows)
    large = {row.id for row in (*worst, *best)}
    samples = [
        view_sample(out, row, drawn=k < DRAWN or row.id in large, pictured=k < PICTURED or row.id in large)
        for k, row in enumerate(rows)
    ]
    views = {sample.row.id: sample for sample in samples}
    names = {verdict: FAILURES.get(verdict, verdict) for verdict in RANK}
    templates = environment()
    templates.filters.update(shown=shown, named=names.__getitem__)
    return templates.get_template("page.html.j2").render(
        title=_title(results),
        results=results,
        total=total,
        headlines=[(BY_NAME[n], total.estimates[n]) for n in layout.headlines if _measured(total, n)],
        metrics=[(m, total.estimates[m.name]) for m in (*METRICS, *_others(total)) if _measured(total, m.name)],
        groups=[(key, found) for key in ("task", "model") if (found := group_rows(rows, key, seed))],
        histograms=[draw_histogram(h, names) for h in histograms(rows, total, layout)],
        gallery=[
            (title, [views[row.id] for row in chosen]) for title, chosen in (("Worst", worst), ("Best", best)) if chosen
        ],
        columns=[BY_NAME[n] for n in layout.columns if _measured(total, n)],
        shares=[BY_NAME[n] for n in layout.shares if _measured(total, n)],
        samples=samples,
        large=large,
        first=SHOWN,
        drawn=min(DRAWN, len(samples)),
        left_out=max(len(samples) - DRAWN, 0),
        normalization=_normalization(results),
        counts={v: n for v in RANK if (n := sum(sample.verdict == v for sample in samples))},
        Status=Status,
    )


def histograms(rows: Sequence[SampleRow], total: Aggregate, layout: MetricLayout) -> list[Histogram]:
    """The spread of the metrics that stand first on a page, as far as they spread."""
    found = []
    for name in dict.fromkeys((*layout.headlines, *layout.columns)):
        if _measured(total, name):
            values = [
                (verdict_of(row), number_of(row, name) if row.status is Status.OK else None)
                for row in rows
                if not isinstance(row.metrics.get(name, row.extra.get(name)), bool)
            ]
            found.append(count_values(BY_NAME[name], values, total.estimates[name]))
    return [histogram for histogram in found if histogram is not None]


def _outstanding(out: Path, rows: Sequence[SampleRow]) -> tuple[list[SampleRow], list[SampleRow]]:
    """The worst and the best samples that have a picture, as many of these as of those, none twice."""
    pictured = [row for row in rows if has_picture(out, row)]
    n = min(GALLERY, len(pictured) // 2)
    best = sorted((r for r in pictured if verdict_of(r) in GOOD), key=goodness)[:n]
    chosen = {row.id for row in best}
    return [row for row in pictured if row.id not in chosen][:n], best


def _title(results: Mapping[str, Json]) -> str:
    """The run's input, or who did what."""
    config = results.get("config")
    config = config if isinstance(config, Mapping) else {}
    if "suite" in config:
        return f"{config.get('world_model')}, suite {config['suite']} ({config.get('split')})"
    return str(config.get("source") or "Report")


def shown(value: float | None, pattern: str) -> str:
    """A number in its format; a dash where there is none."""
    return "–" if value is None else pattern.format(value)


def _others(total: Aggregate) -> list[Metric]:
    """Metrics that the page knows nothing about but their names; noise floors mean nothing apart from their track."""
    known = {*BY_NAME, "feasible"}
    names = [name for name in total.estimates if name not in known and "_floor_" not in name]
    return [Metric(name=name, label=name, pattern="{:.4g}", meaning="") for name in names]


def _measured(total: Aggregate, name: str) -> bool:
    found: Estimate | None = total.estimates.get(name)
    return found is not None and found.n > 0


def bootstrap_seed(results: Mapping[str, Json]) -> int:
    """Seed of the intervals' resampling that a run's results tell."""
    seeds = results.get("seeds")
    seed = seeds.get("bootstrap", 0) if isinstance(seeds, Mapping) else 0
    return seed if isinstance(seed, int) else 0


def read_results(out: Path) -> Mapping[str, Json]:
    """What `results.json` holds; nothing for a run that was interrupted.

    Raises:
        InputError: the file is damaged.
    """
    try:
        data = read_json(out / RESULTS)
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise InputError(f"{out / RESULTS}: not JSON ({cause(error)})") from None
    return cast(Mapping[str, Json], intern_text(data)) if isinstance(data, dict) else {}


@dataclass(frozen=True, slots=True, kw_only=True)
class NormalizedMetric:
    """A metric put on the scale that its own run spans."""

    metric: str
    low: float
    """Value that counts as 0: the run's 10th percentile."""
    high: float
    """Value that counts as 1: the run's 90th percentile."""
    mean: float
    """Mean over samples of (value - low) / (high - low), held within 0..1."""
    n: int


def _normalization(results: Mapping[str, Json]) -> list[NormalizedMetric]:
    found = results.get("normalization")
    told = []
    for name, entry in found.items() if isinstance(found, Mapping) else ():
        numbers = [entry.get(key) if isinstance(entry, Mapping) else None for key in ("low", "high", "mean", "n")]
        low, high, mean, n = (float(v) if isinstance(v, int | float) else None for v in numbers)
        if low is not None and high is not None and mean is not None and n is not None:
            told.append(NormalizedMetric(metric=name, low=low, high=high, mean=mean, n=int(n)))
    return told
