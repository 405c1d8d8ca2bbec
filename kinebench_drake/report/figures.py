"""Matplotlib figures of reports as files and as parts of pages; figures and tables of one run as files."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup, escape

from kinebench_drake.io.atomic import atomic_path, write_atomically
from kinebench_drake.io.figure import FAINT, new_figure, plain, save, shorten
from kinebench_drake.metrics.executable import FailureVerdict
from kinebench_drake.report.metric import layout_of
from kinebench_drake.report.page import SampleGroup, bootstrap_seed, count_metrics, group_rows
from kinebench_drake.report.plot import Histogram
from kinebench_drake.report.run import read_results
from kinebench_drake.report.sample import VERDICT_LABELS, badness, verdict_of
from kinebench_drake.report.table import format_csv, read_caption
from kinebench_drake.report.timeline import LEGEND, FaultLane, anomalies_of, fault_lanes, frame_count
from kinebench_drake.results.aggregate import VERDICT_SHARES, Estimate, RunStatistics
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.results.store import artifact_path, read_rows
from kinebench_drake.results.trackfile import read_track

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = ("#2f7fc1", "#d06a2a", "#2a9d7f", "#9b62c4", "#b3902f", "#cf5a8e", "#7a8794", "#4f9bd9", "#a65a5a", "#5f8f3e")
"""Colours that can be distinguished on a light and on a dark background."""
_MARKERS = "os^Dv<>PX*"
SUCCESS, NEUTRAL = "#2563ab", "#9aa5b1"
_THEME = {"#000000": "var(--ink)", "#ffffff": "var(--card)", "#e6e8ea": "var(--line)", "#b8bec4": "var(--faint)"}
"""Replacements of drawn colours on a page."""
_PX_PER_POINT = 1.5
"""Size of figures on a page [px of CSS / point]."""
_MIN_SCALE = 0.7
"""Share of that size below which a figure scrolls instead of getting smaller."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportFigure:
    """A figure with its caption."""

    name: str
    """Stem of the file names."""
    title: str
    caption: str
    """Contents, and how to read them."""
    figure: "Figure"


def make_figure(key: str, figure: "Figure", **values: object) -> ReportFigure:
    """Give a figure its name and texts in captions.toml, with `values` in their placeholders."""
    return ReportFigure(**read_caption("figures", key, **values), figure=figure)


def style(index: int) -> tuple[str, str]:
    """Return colour and marker of a model by its number."""
    return COLOURS[index % len(COLOURS)], _MARKERS[index % len(_MARKERS)]


def assign_numbers(models: Sequence[str], here: Sequence[str]) -> dict[str, int]:
    """Number the models of a panel: the same in all panels as long as there are colours for all models."""
    order = models if len(models) <= len(COLOURS) else here
    return {model: order.index(model) for model in here}


def add_legend(figure: "Figure", labels: Sequence[str]) -> None:
    """Put a legend above a figure, in as many columns as fit."""
    width = 0.45 + 0.075 * max(map(len, labels), default=0)  # inches per label with its mark
    columns = max(1, min(5, int(figure.get_figwidth() / width)))
    figure.legend(loc="outside upper center", ncols=columns, fontsize=8, frameon=False)


def draw_interval(ax: Any, value: Estimate, y: float, colour: str, marker: str) -> None:
    """Draw the mean of an estimate at height `y`, and its interval as a horizontal line."""
    if value.mean is None:
        return
    if value.low is not None and value.high is not None:
        ax.plot([value.low, value.high], [y, y], color=colour, linewidth=1.2, solid_capstyle="round")
    ax.plot([value.mean], [y], color=colour, marker=marker, markersize=4)


def draw_intervals(
    rows: Sequence[str],
    estimates: Mapping[str, Sequence[tuple[str, Estimate]]],
    numbers: Mapping[str, int],
    label: str,
    low: float = 0.0,
) -> "Figure":
    """Draw shares as points with intervals: a line per row, the models beside each other.

    Args:
        rows: labels of the lines, from bottom to top.
        estimates: rows and their shares by model.
        numbers: number of each model, see `assign_numbers`.
        label: label of the horizontal axis.
        low: its lower end; 0 is marked if it lies within.
    """
    figure, axes = new_figure(7.2, 1.3 + len(rows) * max(0.3, 0.1 + 0.1 * len(estimates)))
    ax = axes[0, 0]
    for k, (model, own) in enumerate(estimates.items()):
        colour, marker = style(numbers[model])
        offset = 0.62 * (0.5 - (k + 0.5) / len(estimates))
        for row, value in own:
            draw_interval(ax, value, rows.index(row) + offset, colour, marker)
        ax.plot([], [], color=colour, marker=marker, markersize=4, linewidth=1.2, label=plain(shorten(model)))
    if low < 0.0:
        ax.axvline(0.0, color=FAINT, linewidth=1.2, zorder=1)
    label_shares(ax, rows, label, low)
    add_legend(figure, list(estimates))
    return figure


def stack_bars(
    ax: Any, places: Sequence[int], lengths: Mapping[str, Sequence[float]], colours: Mapping[str, str], **options: Any
) -> None:
    """Draw stacked horizontal bars at `places` in the order of `colours`; `lengths` are by name of the colour."""
    left = [0.0] * len(places)
    for name, colour in colours.items():
        if any(lengths[name]):
            ax.barh(places, lengths[name], left=left, color=colour, **{"label": name, **options})
            left = [a + b for a, b in zip(left, lengths[name], strict=True)]


def label_shares(ax: Any, rows: Sequence[str], label: str, low: float = 0.0) -> None:
    """Name the rows of a chart, from bottom to top, and label its horizontal axis, from `low` to 1, in percent."""
    from matplotlib.ticker import PercentFormatter

    ax.set_yticks(range(len(rows)), [plain(row) for row in rows], fontsize=8)
    ax.set_ylim(-0.6, len(rows) - 0.4)
    ax.set_xlabel(label, fontsize=9)
    ax.set_xlim(low - 0.02, 1.02)
    ax.xaxis.set_major_formatter(PercentFormatter(xmax=1.0, decimals=0))
    ax.tick_params(axis="x", labelsize=8)


def write_figure(figure: ReportFigure, folder: Path) -> Markup:
    """Write a figure as png and svg, always the same bytes; returns it as markup for a page.

    Raises:
        SetupError: writing failed.
    """
    _save(figure.figure, folder / figure.name)
    svg = (folder / f"{figure.name}.svg").read_text(encoding="utf-8")
    return Markup(inline_svg(svg, figure.name, figure.title))


def _save(figure: "Figure", path: Path) -> None:
    """Write PATH.png and PATH.svg."""
    from matplotlib import rc_context

    save(figure, path.with_suffix(".png"))
    with rc_context({"svg.hashsalt": path.name}), atomic_path(path.with_suffix(".svg")) as part:
        figure.savefig(part, format="svg", metadata={"Date": None})


def inline_svg(svg: str, name: str, title: str) -> str:
    """Convert a drawing to a part of an html page: unique ids, the page's colours, no external addresses."""
    body, name = svg[svg.index("<svg") :], re.sub(r"[^\w.-]", "_", name)
    body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
    body = re.sub(r"<style[^>]*>.*?</style>", "", body, flags=re.DOTALL)
    body = re.sub(r"<!--.*?-->", "", body, flags=re.DOTALL)
    body = re.sub(r'(<g) id="[^"]*"', r"\1", body)
    body = re.sub(r'\bid="([^"]*)"', rf'id="{name}-\1"', body)
    body = re.sub(r'xlink:href="#([^"]*)"', rf'href="#{name}-\1"', body)
    body = re.sub(r"url\(#([^)]*)\)", rf"url(#{name}-\1)", body)
    for drawn, themed in _THEME.items():
        body = body.replace(drawn, themed)
    box = re.search(r'viewBox="0 0 ([\d.]+) [\d.]+"', body)
    width = float(box[1]) * _PX_PER_POINT if box else 0.0
    size = f'{box[0]} width="{width:.0f}" style="min-width: {_MIN_SCALE * width:.0f}px"' if box else ""
    head = f'<svg {size} role="img" aria-label="{escape(title)}">'
    return re.sub(r"<svg[^>]*>", lambda _: head, body, count=1)


_MAX_TIMELINES = 40
"""Samples with faults in the figure of timelines, the worst first."""
_VERDICT_COLOURS = {
    "executable": "#1b7f4b",
    "success": "#2563ab",
    "feasible": "#2563ab",
    "infeasible": "#c2361c",
    "error": "#7a1f10",
    FailureVerdict.GROUNDING.value: "#a3842b",
    FailureVerdict.GENERATION.value: "#c2361c",
    FailureVerdict.EXECUTION.value: "#8a4fb5",
    FailureVerdict.TASK.value: "#c04a80",
    "unmeasurable": "#9a6700",
    "unjudged": "#66727f",
    "checked": "#7fa8c9",
}
_FAULT_COLOURS = {"violation": "#c2361c", "anomaly": "#d99200", "lost": "#66727f", "unsure": "#c7a6e0"}
_COLUMNS = 3
_ESTIMATE = ("mean", "low", "high", "n", "total", "bound")
Faults = tuple[SampleRow, list[FaultLane], int]
"""A row, its faults, and its number of frames."""


def write_figures(out: Path) -> Path:
    """Write figures (png, svg) and tables (csv) of an output folder to `figures/`; the same folder, the same bytes.

    Returns:
        The folder of the files.

    Raises:
        InputError: the folder's files are broken.
        SetupError: writing failed.
    """
    rows, results = sorted(read_rows(out).values(), key=badness), read_results(out)
    statistics = RunStatistics.of(rows, bootstrap_seed(results))
    folder, total = out / "figures", statistics.total
    histograms = count_metrics(rows, total, layout_of(results))
    faults = [_find_faults(out, row) for row in rows]

    def write_csv(name: str, heads: Sequence[str], lines: Iterable[Sequence[object]]) -> None:
        write_atomically(folder / f"{name}.csv", format_csv(heads, lines).encode())

    heads, lines = _sample_lines(rows, list(total.estimates))
    write_csv("samples", heads, lines)
    _write_parquet(folder / "samples.parquet", heads, lines)
    write_csv("metrics", ("metric", *_ESTIMATE), ([n, *_estimate_cells(e)] for n, e in total.estimates.items()))
    write_csv(
        "faults",
        ("id", "frames", "fault", "category", "frame_start", "frame_end", "description"),
        (
            (row.id, n, lane.label, LEGEND[lane.css], span.start, span.end, span.text)
            for row, lanes, n in faults
            for lane in lanes
            for span in lane.spans
        ),
    )
    write_csv(
        "distributions",
        ("metric", "verdict", "low", "high", "samples"),
        (
            (h.metric.name, verdict, float(h.edges[k]), float(h.edges[k + 1]), n)
            for h in histograms
            for verdict, counts in h.counts.items()
            for k, n in enumerate(counts)
        ),
    )
    for key in ("task", "model"):
        groups = group_rows(rows, key, statistics)
        if groups:
            grouped = (
                (g.name, g.total.total, g.total.status[Status.OK], name, *_estimate_cells(estimate))
                for g in groups
                for name, estimate in g.total.estimates.items()
            )
            write_csv(f"{key}s", (key, "samples", "measured", "metric", *_ESTIMATE), grouped)
            _save(_draw_verdicts(groups), folder / f"verdicts_by_{key}")
    if histograms:
        _save(_draw_distributions(histograms), folder / "distributions")
    if any(lanes for _, lanes, _ in faults):
        _save(_draw_faults([f for f in faults if f[1]][:_MAX_TIMELINES]), folder / "faults")
    return folder


def _estimate_cells(estimate: Estimate) -> list[object]:
    return [getattr(estimate, name) for name in _ESTIMATE]


def _find_faults(out: Path, row: SampleRow) -> Faults:
    track = artifact_path(out, "tracks", row.id)
    file = read_track(track) if row.status is Status.OK and track.is_file() else None
    lanes = fault_lanes(row, file)
    return row, lanes, frame_count(row, file, lanes)


def _sample_lines(rows: Sequence[SampleRow], names: Sequence[str]) -> tuple[list[str], list[list[object]]]:
    metrics = [name for name in names if name not in VERDICT_SHARES]
    labels = ("id", "video", "task", "model", "status", "verdict", "reason", "executable", "feasible")
    heads = [*labels, "executable_reasons", "violations", "anomalies"]

    def line(row: SampleRow) -> list[object]:
        kinds = [sorted({str(mark.get("kind")) for mark in marks}) for marks in (row.violations, anomalies_of(row))]
        values = {"status": row.status.value, "verdict": verdict_of(row)}
        cells = [values.get(label) or getattr(row, label) for label in labels]
        cells.append("; ".join(row.executable_reasons))
        return [*cells, *("; ".join(k) for k in kinds), *(row.metrics.get(n, row.extra.get(n)) for n in metrics)]

    return [*heads, *metrics], [line(row) for row in rows]


def _write_parquet(path: Path, heads: Sequence[str], lines: Sequence[Sequence[object]]) -> None:
    """Write a table as parquet: columns of texts, of truth values, or of numbers."""
    import pyarrow
    from pyarrow import parquet

    def column(values: Sequence[object]) -> Any:
        if any(isinstance(value, str) for value in values):
            return pyarrow.array([None if value is None else str(value) for value in values], pyarrow.string())
        if all(value is None or isinstance(value, bool) for value in values):
            return pyarrow.array(values, pyarrow.bool_())
        numbers = [float(value) if isinstance(value, bool | int | float) else None for value in values]
        return pyarrow.array(numbers, pyarrow.float64())

    table = pyarrow.table({head: column([line[k] for line in lines]) for k, head in enumerate(heads)})
    with atomic_path(path) as part:
        parquet.write_table(table, part)


def _draw_verdicts(groups: Sequence[SampleGroup]) -> "Figure":
    from matplotlib.ticker import MaxNLocator

    figure, axes = new_figure(7.0, 1.2 + 0.26 * len(groups))
    ax = axes[0, 0]
    counts = {verdict: [group.verdicts.get(verdict, 0) for group in groups] for verdict in _VERDICT_COLOURS}
    named = {VERDICT_LABELS[verdict]: own for verdict, own in counts.items()}
    colours = {VERDICT_LABELS[verdict]: colour for verdict, colour in _VERDICT_COLOURS.items()}
    stack_bars(ax, range(len(groups)), named, colours, height=0.7)
    ax.set_yticks(range(len(groups)), [plain(shorten(group.name)) for group in groups], fontsize=8)
    ax.invert_yaxis()
    ax.set_xlabel("samples")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    figure.legend(loc="outside upper center", ncols=4, fontsize=8, frameon=False)
    return figure


def _draw_distributions(histograms: Sequence[Histogram]) -> "Figure":
    from matplotlib.patches import Patch
    from matplotlib.ticker import MaxNLocator

    lines = -(-len(histograms) // _COLUMNS)
    figure, axes = new_figure(10.0, 0.4 + 2.1 * lines, lines, _COLUMNS)
    for ax, h in zip(axes.flat, histograms, strict=False):
        below = [0] * (len(h.edges) - 1)
        for verdict, counts in h.counts.items():
            widths, colour = h.edges[1:] - h.edges[:-1], _VERDICT_COLOURS[verdict]
            ax.bar(h.edges[:-1], counts, widths, below, align="edge", color=colour)
            below = [a + b for a, b in zip(below, counts, strict=True)]
        if h.estimate.mean is not None:
            ax.axvline(h.estimate.mean, color="black", linewidth=1.2)
        if h.estimate.low is not None and h.estimate.high is not None:
            ax.axvspan(h.estimate.low, h.estimate.high, color="black", alpha=0.12, linewidth=0.0)
        outliers = f", {h.outliers} outliers in the outermost bins" if h.outliers else ""
        ax.set_title(f"{h.metric.label}: {h.estimate.n} of {h.estimate.total}{outliers}", fontsize=8, loc="left")
        ax.set_xlim(h.edges[0], h.edges[-1])
        ax.tick_params(labelsize=7)
        ax.yaxis.set_major_locator(MaxNLocator(nbins=4, integer=True))
    for ax in axes.flat[len(histograms) :]:
        ax.set_visible(False)
    handles = [
        Patch(color=colour, label=VERDICT_LABELS[verdict])
        for verdict, colour in _VERDICT_COLOURS.items()
        if any(verdict in h.counts for h in histograms)
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=5, fontsize=8, frameon=False)
    return figure


def _draw_faults(faults: Sequence[Faults]) -> "Figure":
    from matplotlib.patches import Patch

    figure, axes = new_figure(8.0, 1.0 + 0.24 * len(faults))
    ax = axes[0, 0]
    for k, (_, lanes, n) in enumerate(faults):
        ax.broken_barh([(0, n)], (k - 0.35, 0.7), color="#eef2f7", linewidth=0.0)
        for css in reversed(_FAULT_COLOURS):
            spans = [(s.start, s.end + 1 - s.start) for lane in lanes if lane.css == css for s in lane.spans]
            ax.broken_barh(spans, (k - 0.35, 0.7), color=_FAULT_COLOURS[css], linewidth=0.0)
    ax.set_yticks(range(len(faults)), [plain(shorten(row.id)) for row, _, _ in faults], fontsize=7)
    ax.invert_yaxis()
    ax.set_xlabel("frames")
    handles = [Patch(color=colour, label=LEGEND[css]) for css, colour in _FAULT_COLOURS.items()]
    figure.legend(handles=handles, loc="outside upper center", ncols=4, fontsize=8, frameon=False)
    return figure
