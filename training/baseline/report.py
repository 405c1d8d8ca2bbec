"""Report of the comparison of baseline and grounding: table, JSON and figure."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from kinebench_drake.grounding.pipeline import GroundingPipeline
from kinebench_drake.io.atomic import atomic_path, write_atomically
from kinebench_drake.stats import IntervalEstimate
from training.baseline.comparison import (
    ClipComparison,
    ComparisonGroup,
    Extractor,
    Quantity,
    compare,
    groups,
)
from training.baseline.fitting import load_demonstrations
from training.baseline.network import Baseline

_NAME = 24
_CELL = 22


def _format(figure: IntervalEstimate) -> str:
    interval = f" [{figure.low:.3g}, {figure.high:.3g}]" if figure.low == figure.low else ""
    return f"{figure.value:.3g}{interval}"


def table(compared: Sequence[ComparisonGroup]) -> Iterator[str]:
    """Yield the lines of the table: medians and 95th percentiles with their intervals, for each method."""
    columns = [f"{q.value} {share}" for q in Quantity for share in ("median", "95 %")]
    yield " ".join([f"{'':{_NAME}}", f"{'videos':>6}", f"{'tracked':>8}", *(f"{c:>{_CELL + 3}}" for c in columns)])
    for g in compared:
        for method in Extractor:
            if method is Extractor.BASELINE_WHERE_TRACKED and not g.pooled:
                continue
            tracked = "" if method is Extractor.BASELINE else f"{100 * g.tracked_fraction:.1f} %"
            cells = [_format(figure) for q in Quantity for figure in g.figures[method, q]]
            if method is Extractor.BASELINE:
                yield g.name
            start = [f"  {method.value:{_NAME - 2}}", f"{g.videos:>6}", f"{tracked:>8}"]
            yield " ".join([*start, *(f"{c:>{_CELL + 3}}" for c in cells)])


def as_json(compared: Sequence[ComparisonGroup]) -> list[dict[str, object]]:
    """Return the table as a JSON array."""
    return [
        {
            "group": g.name,
            "trained": g.trained,
            "videos": g.videos,
            "tracked_fraction": g.tracked_fraction,
            "errors": {
                m.value: {
                    f"{q.name.lower()}_{share}": [f.value, f.low, f.high]
                    for q in Quantity
                    for share, f in zip(("median", "p95"), g.figures[m, q], strict=True)
                }
                for m in Extractor
            },
            "video_medians": {
                m.value: {q.name.lower(): [v if v == v else None for v in g.medians[m, q]] for q in Quantity}
                for m in Extractor
            },
            "pooled": g.pooled,
        }
        for g in compared
    ]


def comparison_lines(
    folders: Sequence[Path], weights: Path, grounding_weights: Path | None, limit: int | None, out: Path
) -> Iterator[str]:
    """Run both methods on the videos of `folders`, yield a line per video and the table, and write the report.

    Args:
        folders: folders of demonstrations.
        weights: weights of the baseline.
        grounding_weights: weights of the grounding; None for those shipped.
        limit: number of videos of each task of each folder; all if None.
        out: folder for baseline.txt, baseline.json, baseline.png.

    Raises:
        UsageError: a folder cannot be used, or its camera is not the one of the training.
        SetupError: weights are missing.
    """
    baseline = Baseline.load(weights)
    sources = [load_demonstrations(folder) for folder in folders]
    for source in sources:
        baseline.require_camera(source.camera)
    pipeline = GroundingPipeline.create(weights=grounding_weights)
    clips: list[ClipComparison] = []
    for source in sources:
        for task in source.tasks:
            for clip in [c for c in source.clips if c.task == task][:limit]:
                clips.append(compare(clip, source.camera, baseline, pipeline))
                yield _line(clips[-1])
    compared = list(groups(clips))
    lines = list(table(compared))
    yield from lines
    write_atomically(out / "baseline.txt", ("\n".join(lines) + "\n").encode())
    write_atomically(out / "baseline.json", (json.dumps(as_json(compared), indent=1) + "\n").encode())
    draw(compared, out / "baseline.png")


def _line(clip: ClipComparison) -> str:
    medians = [
        f"{method.value} {np.nanmedian(clip.errors[method][Quantity.POSITION]):.1f} mm "
        f"{np.nanmedian(clip.errors[method][Quantity.ROTATION]):.1f} degrees"
        for method in (Extractor.BASELINE, Extractor.GROUNDING)
        if np.isfinite(clip.errors[method][Quantity.POSITION]).any()
    ]
    return f"{clip.id:34s} tracked {clip.tracked_fraction:.3f}  {'  '.join(medians)}"


_STYLE = {
    Extractor.BASELINE: ("inverse-dynamics baseline", "#c44e52", "o", -0.16),
    Extractor.GROUNDING: ("grounding", "#2f6db3", "s", 0.16),
}


def draw(compared: Sequence[ComparisonGroup], path: Path) -> None:
    """Plot medians with their intervals and 95th percentiles, for all tasks, to a png.

    Raises:
        SetupError: writing failed.
    """
    from matplotlib.figure import Figure as Canvas

    canvas = Canvas(figsize=(2.5 + 0.62 * len(compared), 9.5), layout="constrained")
    panels = canvas.subplots(len(Quantity), 1, sharex=True)
    x = np.arange(len(compared))
    for panel, quantity in zip(panels, Quantity, strict=True):
        for method, (label, colour, marker, shift) in _STYLE.items():
            figures = [g.figures[method, quantity] for g in compared]
            value, low, high = np.array([(median.value, median.low, median.high) for median, _ in figures]).T
            top = np.array([p95.value for _, p95 in figures])
            panel.vlines(x + shift, value, top, color=colour, lw=1.2, alpha=0.6)
            panel.plot(x + shift, top, "_", color=colour, ms=7, alpha=0.6)
            panel.vlines(x + shift, low, high, color=colour, lw=5, alpha=0.35)
            panel.plot(x + shift, value, marker, color=colour, ms=6, label=label)
        panel.set_yscale("log")
        panel.yaxis.set_major_formatter("{x:g}")
        panel.set_ylabel(f"error of {quantity.value}")
        panel.grid(axis="y", which="both", color="0.9", lw=0.6)
        panel.set_axisbelow(True)
        for i, g in enumerate(compared):
            if not g.trained:
                panel.axvspan(i - 0.5, i + 0.5, color="#f6ead2", lw=0, zorder=-2)
            if g.pooled:
                panel.axvspan(i - 0.5, i + 0.5, color="0.5", alpha=0.12, lw=0, zorder=-1)
    panels[0].set_xlim(-0.5, len(compared) - 0.5)
    panels[0].legend(loc="upper left", ncols=2, frameon=False)
    panels[0].set_title(
        "Markers: median over frames, thick bars: its 95 % interval over videos, thin bars: to the 95th percentile.\n"
        "Amber: tasks that the baseline was not trained on; grey: several tasks together.",
        fontsize=9,
        loc="left",
    )
    panels[-1].set_xticks(x, [g.name for g in compared], rotation=40, ha="right")
    for tick, g in zip(panels[-1].get_xticklabels(), compared, strict=True):
        tick.set_fontweight("bold" if g.pooled else "normal")
    with atomic_path(path) as part:
        canvas.savefig(part, dpi=120, format="png")
