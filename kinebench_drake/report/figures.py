"""The report's figures and tables as files: png and svg to show, csv to reckon with."""

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from kinebench_drake.io.atomic import atomic_path, write_atomically
from kinebench_drake.io.figure import new_figure, plain, save
from kinebench_drake.report.frames import anomalies_of
from kinebench_drake.report.histogram import Histogram
from kinebench_drake.report.metric import layout_of
from kinebench_drake.report.page import SampleGroup, bootstrap_seed, group_rows, histograms, read_results
from kinebench_drake.report.sample import FAILURES, badness, verdict_of
from kinebench_drake.report.timeline import LEGEND, Lane, frame_count, lanes_of
from kinebench_drake.results.aggregate import aggregate
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.results.store import artifact_path, read_rows
from kinebench_drake.results.trackfile import read_track

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURES = "figures"
"""Folder of the files, in the output folder."""
TIMELINES = 40
"""Samples with faults that the picture of timelines holds, the worst first."""
_VERDICTS = {
    **{"feasible": "#1b7f4b", "success": "#1b7f4b", "infeasible": "#c2361c", "error": "#7a1f10"},
    **{"grounding": "#a3842b", "generation": "#c2361c", "execution": "#8a4fb5", "task": "#2563ab"},
    **{"unmeasurable": "#9a6700", "unjudged": "#66727f"},
}
_FAULTS = {"violation": "#c2361c", "anomaly": "#d99200", "lost": "#66727f", "unsure": "#c7a6e0"}
_COLUMNS = 3


def write_figures(out: Path) -> Path:
    """Write figures and tables of an output folder to `figures/` in it; the same folder gives the same bytes.

    Returns:
        The folder of the files.

    Raises:
        InputError: the folder's files are broken.
        SetupError: writing failed.
    """
    rows, results = sorted(read_rows(out).values(), key=badness), read_results(out)
    seed = bootstrap_seed(results)
    folder, total = out / FIGURES, aggregate(rows, seed)
    spread = histograms(rows, total, layout_of(results))
    faults = [(row, *_faults(out, row)) for row in rows]
    _write_csv(folder / "samples.csv", *_samples(rows, list(total.estimates)))
    _write_csv(folder / "metrics.csv", ("metric", *_ESTIMATE), ([n, *_cells(e)] for n, e in total.estimates.items()))
    _write_csv(folder / "faults.csv", *_fault_lines(faults))
    _write_csv(folder / "distributions.csv", *_bins(spread))
    for key in ("task", "model"):
        groups = group_rows(rows, key, seed)
        if groups:
            _write_csv(folder / f"{key}s.csv", *_group_lines(key, groups))
            _write_picture(_draw_verdicts(groups), folder / f"verdicts_by_{key}")
    if spread:
        _write_picture(_draw_distributions(spread), folder / "distributions")
    shown = [found for found in faults if found[1]][:TIMELINES]
    if shown:
        _write_picture(_draw_faults(shown), folder / "faults")
    return folder


_ESTIMATE = ("mean", "low", "high", "n", "total")


def _cells(estimate: object) -> list[object]:
    return [getattr(estimate, name) for name in _ESTIMATE]


def _write_csv(path: Path, heads: Sequence[str], lines: Iterable[Sequence[object]]) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(heads)
    writer.writerows(lines)
    write_atomically(path, text.getvalue().encode())


def _write_picture(figure: "Figure", path: Path) -> None:
    from matplotlib import rc_context

    save(figure, path.with_suffix(".png"))
    with rc_context({"svg.hashsalt": path.name}), atomic_path(path.with_suffix(".svg")) as part:
        figure.savefig(part, format="svg", metadata={"Date": None})


def _faults(out: Path, row: SampleRow) -> tuple[list[Lane], int]:
    """A sample's faults and its number of frames."""
    track = artifact_path(out, "tracks", row.id)
    file = read_track(track) if row.status is Status.OK and track.is_file() else None
    lanes = lanes_of(row, file)
    return lanes, frame_count(row, file, lanes)


def _samples(rows: Sequence[SampleRow], names: Sequence[str]) -> tuple[list[str], Iterable[list[object]]]:
    metrics = [name for name in names if name != "feasible"]
    heads = ["id", "video", "task", "model", "status", "verdict", "reason", "feasible", "violations", "anomalies"]

    def line(row: SampleRow) -> list[object]:
        kinds = [sorted({str(mark.get("kind")) for mark in marks}) for marks in (row.violations, anomalies_of(row))]
        told = [row.id, row.video, row.task, row.model, row.status.value, verdict_of(row), row.reason, row.feasible]
        return [*told, *("; ".join(k) for k in kinds), *(row.metrics.get(n, row.extra.get(n)) for n in metrics)]

    return [*heads, *metrics], map(line, rows)


def _fault_lines(
    faults: Sequence[tuple[SampleRow, list[Lane], int]],
) -> tuple[Sequence[str], Iterable[Sequence[object]]]:
    return ("id", "frames", "fault", "sort", "frame_start", "frame_end", "told"), (
        (row.id, n, lane.label, LEGEND[lane.css], span.start, span.end, span.text)
        for row, lanes, n in faults
        for lane in lanes
        for span in lane.spans
    )


def _bins(spread: Sequence[Histogram]) -> tuple[Sequence[str], Iterable[Sequence[object]]]:
    return ("metric", "verdict", "low", "high", "samples"), (
        (h.metric.name, verdict, float(h.edges[k]), float(h.edges[k + 1]), n)
        for h in spread
        for verdict, counts in h.counts.items()
        for k, n in enumerate(counts)
    )


def _group_lines(key: str, groups: Sequence[SampleGroup]) -> tuple[Sequence[str], Iterable[Sequence[object]]]:
    return (key, "samples", "measured", "metric", *_ESTIMATE), (
        (g.name, g.total.total, g.total.status[Status.OK], name, *_cells(estimate))
        for g in groups
        for name, estimate in g.total.estimates.items()
    )


def _draw_verdicts(groups: Sequence[SampleGroup]) -> "Figure":
    from matplotlib.ticker import MaxNLocator

    figure, axes = new_figure(7.0, 1.2 + 0.26 * len(groups))
    ax = axes[0, 0]
    left = [0] * len(groups)
    for verdict, colour in _VERDICTS.items():
        counts = [group.verdicts.get(verdict, 0) for group in groups]
        if any(counts):
            label = FAILURES.get(verdict, verdict)
            ax.barh(range(len(groups)), counts, left=left, color=colour, label=label, height=0.7)
            left = [a + b for a, b in zip(left, counts, strict=True)]
    ax.set_yticks(range(len(groups)), [_short(group.name) for group in groups], fontsize=8)
    ax.invert_yaxis()
    ax.set_xlabel("samples")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    figure.legend(loc="outside upper center", ncols=4, fontsize=8, frameon=False)
    return figure


def _draw_distributions(spread: Sequence[Histogram]) -> "Figure":
    from matplotlib.patches import Patch
    from matplotlib.ticker import MaxNLocator

    lines = -(-len(spread) // _COLUMNS)
    figure, axes = new_figure(10.0, 0.4 + 2.1 * lines, lines, _COLUMNS)
    for ax, h in zip(axes.flat, spread, strict=False):
        below = [0] * (len(h.edges) - 1)
        for verdict, counts in h.counts.items():
            ax.bar(h.edges[:-1], counts, h.edges[1:] - h.edges[:-1], below, align="edge", color=_VERDICTS[verdict])
            below = [a + b for a, b in zip(below, counts, strict=True)]
        if h.estimate.mean is not None:
            ax.axvline(h.estimate.mean, color="black", linewidth=1.2)
        if h.estimate.low is not None and h.estimate.high is not None:
            ax.axvspan(h.estimate.low, h.estimate.high, color="black", alpha=0.12, linewidth=0.0)
        far = f", {h.below + h.above} far out at the edge" if h.below or h.above else ""
        ax.set_title(f"{h.metric.label}: {h.estimate.n} of {h.estimate.total}{far}", fontsize=8, loc="left")
        ax.set_xlim(h.edges[0], h.edges[-1])
        ax.tick_params(labelsize=7)
        ax.yaxis.set_major_locator(MaxNLocator(nbins=4, integer=True))
    for ax in axes.flat[len(spread) :]:
        ax.set_visible(False)
    handles = [
        Patch(color=colour, label=FAILURES.get(verdict, verdict))
        for verdict, colour in _VERDICTS.items()
        if any(verdict in h.counts for h in spread)
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=5, fontsize=8, frameon=False)
    return figure


def _draw_faults(faults: Sequence[tuple[SampleRow, list[Lane], int]]) -> "Figure":
    from matplotlib.patches import Patch

    figure, axes = new_figure(8.0, 1.0 + 0.24 * len(faults))
    ax = axes[0, 0]
    for k, (_, lanes, n) in enumerate(faults):
        ax.broken_barh([(0, n)], (k - 0.35, 0.7), color="#eef2f7", linewidth=0.0)
        for css in reversed(_FAULTS):
            spans = [(s.start, s.end + 1 - s.start) for lane in lanes if lane.css == css for s in lane.spans]
            ax.broken_barh(spans, (k - 0.35, 0.7), color=_FAULTS[css], linewidth=0.0)
    ax.set_yticks(range(len(faults)), [_short(row.id) for row, _, _ in faults], fontsize=7)
    ax.invert_yaxis()
    ax.set_xlabel("frames")
    handles = [Patch(color=colour, label=LEGEND[css]) for css, colour in _FAULTS.items()]
    figure.legend(handles=handles, loc="outside upper center", ncols=4, fontsize=8, frameon=False)
    return figure


def _short(name: str) -> str:
    """A name to draw, cut where it is endless."""
    return plain(name if len(name) <= 48 else f"{name[:47]}…")
