"""The comparison as lines of text and as an object for a file."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

from kinebench_drake.grounding.baseline.comparison import (
    ClipComparison,
    Figure,
    Group,
    Method,
    Quantity,
    compare,
    groups,
)
from kinebench_drake.grounding.baseline.demonstration import load_demonstrations
from kinebench_drake.grounding.baseline.predictor import Baseline
from kinebench_drake.grounding.pipeline import GroundingPipeline
from kinebench_drake.storage import write_atomically

_NAME, _CELL = 24, 22


def _told(figure: Figure) -> str:
    interval = f" [{figure.low:.3g}, {figure.high:.3g}]" if figure.low == figure.low else ""
    return f"{figure.value:.3g}{interval}"


def table(found: Sequence[Group]) -> Iterator[str]:
    """Two lines a task, three where tasks are pooled: medians and 95th percentiles with their intervals."""
    columns = [f"{q.value} {share}" for q in Quantity for share in ("median", "95 %")]
    yield " ".join([f"{'':{_NAME}}", f"{'videos':>6}", f"{'tracked':>8}", *(f"{c:>{_CELL + 3}}" for c in columns)])
    for g in found:
        for method in Method:
            if method is Method.BASELINE_WHERE_TRACKED and not g.pooled:
                continue
            tracked = "" if method is Method.BASELINE else f"{100 * g.tracked_fraction:.1f} %"
            cells = [_told(values[method, q]) for q in Quantity for values in (g.medians, g.p95s)]
            if method is Method.BASELINE:
                yield g.name
            start = [f"  {method.value:{_NAME - 2}}", f"{g.videos:>6}", f"{tracked:>8}"]
            yield " ".join([*start, *(f"{c:>{_CELL + 3}}" for c in cells)])


def as_json(found: Sequence[Group]) -> list[dict[str, object]]:
    """The same, for programs."""
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
                    for share, f in (("median", g.medians[m, q]), ("p95", g.p95s[m, q]))
                }
                for m in Method
            },
        }
        for g in found
    ]


def comparison_lines(
    folders: Sequence[Path], weights: Path, grounding_weights: Path | None, limit: int | None, out: Path
) -> Iterator[str]:
    """Run both on the videos of `folders`, a line each, then tell of all; writes a table, its numbers and a figure.

    Args:
        folders: of demonstrations.
        weights: the baseline's.
        grounding_weights: the grounding's; None for those shipped.
        limit: measure the first so many videos of each task of each folder only.
        out: folder for baseline.txt, baseline.json, baseline.png.

    Raises:
        UsageError: a folder cannot be used, or another camera took its videos.
        SetupError: weights are missing.
    """
    from kinebench_drake.grounding.baseline.figure import draw
    from kinebench_drake.grounding.confidence import Confidence
    from kinebench_drake.grounding.estimator import NetworkEstimator
    from kinebench_drake.grounding.tracker import CadTracker
    from kinebench_drake.models.perception.weights import WEIGHTS, load_network

    baseline, sources = Baseline.load(weights), [load_demonstrations(folder) for folder in folders]
    for source in sources:
        baseline.require_camera(source.camera)
    estimator = NetworkEstimator(load_network(grounding_weights or WEIGHTS))
    pipeline = GroundingPipeline(CadTracker(estimator), Confidence.load())
    compared: list[ClipComparison] = []
    for source in sources:
        for task in source.tasks:
            for clip in [c for c in source.clips if c.task == task][:limit]:
                compared.append(compare(clip, source.camera, baseline, pipeline))
                yield _line(compared[-1])
    found = list(groups(compared))
    lines = list(table(found))
    yield from lines
    write_atomically(out / "baseline.txt", ("\n".join(lines) + "\n").encode())
    write_atomically(out / "baseline.json", (json.dumps(as_json(found), indent=1) + "\n").encode())
    draw(found, out / "baseline.png")


def _line(clip: ClipComparison) -> str:
    import numpy as np

    medians = [
        f"{method.value} {np.nanmedian(clip.errors[method].told(Quantity.POSITION)):.1f} mm "
        f"{np.nanmedian(clip.errors[method].told(Quantity.ROTATION)):.1f} degrees"
        for method in (Method.BASELINE, Method.GROUNDING)
        if np.isfinite(clip.errors[method].position_m).any()
    ]
    return f"{clip.id:34s} tracked {clip.tracked_fraction:.3f}  {'  '.join(medians)}"
