"""Errors of grounding and inverse-dynamics baseline on the same videos: unchanged, with true depth, and perturbed."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np

from benchmarks import markdown
from benchmarks.accuracy import HELDOUT, WIDTH
from benchmarks.perception.clip import find_clips
from benchmarks.perception.perturbation.catalogue import PerturbationKind
from benchmarks.perception.study import (
    CLEAN,
    LEARNED,
    TRUE_DEPTH,
    StudyOutcome,
    StudyPlan,
    robustness,
    run_study,
)
from kinebench_drake.executors.local import LocalExecutor
from kinebench_drake.grounding import bounds
from kinebench_drake.io.figure import POSITION, ROTATION, new_figure
from kinebench_drake.runs.runner import RunObserver
from kinebench_drake.stats import IntervalEstimate
from training.baseline.network import Baseline

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURE = Path("docs/robustness.png")
"""Figure of the docs, named in the section."""
_GROWTH = 1.25
_TRACKED = 0.99
"""Growth of the median position error, and share of tracked frames, beyond which a perturbation is in the table."""
_GROUNDING = "grounding"
_BASELINE = "inverse dynamics"
_STYLES = ((_GROUNDING, "", -0.15, POSITION), (_BASELINE, f", {LEARNED}", 0.15, ROTATION))
_PANELS = (("position", "mm", 1e3 * bounds.GOOD_M), ("rotation", "deg", float(np.rad2deg(bounds.GOOD_RAD))))
"""Quantity, unit, and error within which a pose is good."""
_INTRODUCTION = (
    "Errors of panda_hand in the camera frame on the same held-out videos, median / 95th percentile over frames: of "
    "the grounding those it tracks, of the network all. Medians have 95 % bootstrap intervals "
    "over videos. Tracked: of the frames in which at least 30 % of the gripper is visible. The programs that perturb "
    "these frames are not used in training, but training images of both networks are degraded in similar ways. "
    "The network is the [learned baseline](grounding-evidence.md#learned-baseline), trained on {training}. "
    "The table has the perturbations that cost the grounding 1 % of the frames or a quarter of its exactness. "
    "Rotations and all strengths: [{figure}]({figure})."
)


def measure(
    heldout: Path, weights: Path, keep: Path, limit: int | None, jobs: int, observer: RunObserver
) -> StudyOutcome:
    """Ground the videos, unchanged, with true depth and perturbed, and pass the same frames through the baseline.

    The folder is one of `suite demos --with-depth`; an earlier run is resumed from the file `keep`.

    Raises:
        UsageError: the folder cannot be used, or the baseline was trained for another camera.
        SetupError: something is missing on this machine, or a worker died. What is finished is kept.
    """
    baseline = Baseline.load(weights)
    for clip in find_clips(heldout):
        baseline.require_camera(clip.camera)
    conditions = robustness(tuple(PerturbationKind), weights)
    return run_study(conditions, StudyPlan(folder=heldout, limit=limit, keep=keep), LocalExecutor(jobs=jobs), observer)


def _required(outcome: StudyOutcome) -> list[str]:
    """Return the names of the perturbations that the grounding is required to tolerate."""
    own = [c for c in outcome.conditions if c.baseline is None]
    return [c.name for c in own if c.perturbation is not None and c.perturbation.is_required]


def figures(outcome: StudyOutcome) -> dict[str, float]:
    """Return errors and shares of failures by name; of all of them less is better."""
    names = (CLEAN.name, TRUE_DEPTH.name, *_required(outcome))
    result = {}
    for extractor, suffix, *_ in _STYLES:
        for name in names:
            if (row := outcome.figures.get(name + suffix)) is not None:
                result[f"{extractor}, {name}, position median [mm]"] = row["position_median_mm"].value
                result[f"{extractor}, {name}, rotation median [deg]"] = row["rotation_median_deg"].value
                result[f"{extractor}, {name}, not tracked"] = 1.0 - row["tracked_when_seen"].value
    return result


def section(outcome: StudyOutcome, training: str) -> str:
    """Return the section of the page, in Markdown.

    Args:
        outcome: result of `measure`.
        training: description of that training.
    """
    videos = outcome.results[CLEAN.name]
    head = ["frames"]
    for extractor, *_ in _STYLES:
        head += [f"{extractor}: tracked", "position [mm]", "off by 3 cm"]
    return markdown.section(
        "Perturbed frames, and inverse dynamics",
        wrap(_INTRODUCTION.format(training=training, figure=FIGURE.name), width=WIDTH),
        markdown.table(head, _rows(outcome)),
        "The commands:",
        [
            f"    kinebench-drake {' '.join(HELDOUT)} --out heldout",
            f"    python -m benchmarks robustness --heldout heldout --work robustness --limit {len(videos)}",
        ],
    )


def _rows(outcome: StudyOutcome) -> Iterator[list[str]]:
    for name in (CLEAN.name, TRUE_DEPTH.name):
        yield _row(name, [outcome.figures.get(name + suffix) for _, suffix, *_ in _STYLES])
    for name in filter(lambda name: _stands_out(outcome, name), _required(outcome)):
        yield _row(name, [outcome.figures[name + suffix] for _, suffix, *_ in _STYLES])


def _stands_out(outcome: StudyOutcome, name: str) -> bool:
    """Return whether a perturbation costs the grounding frames, or a quarter of its exactness."""
    clean, now = (outcome.figures[key] for key in (CLEAN.name, name))
    growth = now["position_median_mm"].value / clean["position_median_mm"].value
    return growth >= _GROWTH or now["tracked_when_seen"].value < _TRACKED


def _row(name: str, columns: Sequence[Mapping[str, IntervalEstimate] | None]) -> list[str]:
    cells = [name]
    for figures in columns:
        if figures is None:
            cells += [""] * 3
            continue
        cells.append(f"{figures['tracked_when_seen'].value:.1%}")
        median, p95 = (figures[f"position_{which}_mm"] for which in ("median", "p95"))
        cells.append(f"{median.value:.1f} [{median.low:.1f}, {median.high:.1f}] / {p95.value:.1f}")
        cells.append(f"{figures['tracked_frames_off_by_3_cm'].value:.1%}")
    return cells


def draw(outcome: StudyOutcome) -> "Figure":
    """Draw both errors, median to 95th percentile, and the tracked share with its interval, for each condition."""
    names = [c.name for c in outcome.conditions if c.baseline is None]
    figure, axes = new_figure(11.0, 0.3 * len(names) + 1.4, 1, 3, sharey=True)
    for extractor, suffix, shift, color in _STYLES:
        for row, name in enumerate(names):
            figures = outcome.figures.get(name + suffix)
            if figures is None:
                continue
            for ax, (quantity, unit, _) in zip(axes[0], _PANELS, strict=False):
                median, p95 = (figures[f"{quantity}_{which}_{unit}"].value for which in ("median", "p95"))
                ax.plot([median, p95], [row + shift] * 2, color=color, linewidth=1.2)
                ax.plot(median, row + shift, marker="o", color=color, markersize=4)
            share = figures["tracked_when_seen"]
            axes[0][2].plot([share.low, share.high], [row + shift] * 2, color=color, linewidth=1.2)
            axes[0][2].plot(share.value, row + shift, marker="o", color=color, markersize=4)
        axes[0][0].plot([], [], marker="o", color=color, markersize=4, linewidth=1.2, label=extractor)
    for ax, (quantity, unit, good) in zip(axes[0], _PANELS, strict=False):
        ax.set_xscale("log")
        ax.xaxis.set_major_formatter("{x:g}")
        ax.axvline(good, color="#5b6470", linestyle="--", linewidth=1)
        ax.set_xlabel(f"{quantity} error [{unit}]")
    axes[0][2].set_xlabel("tracked")
    required = set(_required(outcome))
    axes[0][0].set_yticks(np.arange(len(names)), [f"{name} *" if name in required else name for name in names])
    axes[0][0].set_ylim(len(names) - 0.4, -0.6)
    figure.legend(loc="outside upper center", ncols=2, frameon=False)
    return figure
