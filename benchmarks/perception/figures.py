"""Plots of measurements, and the contact sheet of perturbations."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.perception.clip import TruthClipFile
from benchmarks.perception.perturbation.catalogue import PerturbationKind, ladder, perturb
from benchmarks.perception.summary import Reliability, Results, pooled_errors, reliability
from benchmarks.perception.tables import by_task
from kinebench_drake.geometry import Array
from kinebench_drake.io.figure import FAINT, POSITION, ROTATION, new_figure
from kinebench_drake.io.reader import read_video
from kinebench_drake.models.panda.cad import GripperCad
from kinebench_drake.stats import IntervalEstimate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLOURS = ("#1f6fb2", "#c4622d", "#3a8f5c", "#8a5fb0", "#b5485d", "#6b7a1e", "#3b8ea5", "#946b3d", "#5b6470")
# of logarithmic axes
_FLOOR_MM = 0.05
_FLOOR_DEG = 0.02


def draw_evaluation(results: Results) -> "Figure":
    """Plot the error distributions over all frames, boxes per task, and the reliability curve."""
    figure, axes = new_figure(13.0, 8.2, 2, 2)
    position, rotation = pooled_errors(results)
    _distribution(axes[0, 0], position, rotation)
    _reliability(axes[0, 1], reliability(results))
    groups = {task: pooled_errors(group) for task, group in by_task(results).items()}
    _boxes(axes[1, 0], [g[0] for g in groups.values()], list(groups), [POSITION] * len(groups), _FLOOR_MM)
    axes[1, 0].set_ylabel("position error [mm]")
    _boxes(axes[1, 1], [g[1] for g in groups.values()], list(groups), [ROTATION] * len(groups), _FLOOR_DEG)
    axes[1, 1].set_ylabel("rotation error [degrees]")
    figure.suptitle(f"{len(results)} videos, {len(position)} tracked frames; boxes: quartiles, whiskers: 5 % and 95 %")
    return figure


def _distribution(ax: Any, position: Array, rotation: Array) -> None:
    for values, colour, label, floor in (
        (position, POSITION, "position error [mm]", _FLOOR_MM),
        (rotation, ROTATION, "rotation error [degrees]", _FLOOR_DEG),
    ):
        if values.size:
            ax.plot(np.sort(np.maximum(values, floor)), np.arange(1, len(values) + 1) / len(values), color=colour)
            middle, high = np.percentile(values, [50, 95])
            ax.plot([], [], color=colour, label=f"{label}: median {middle:.2f}, 95 % {high:.2f}")
    _logarithmic(ax.xaxis, ax.set_xscale)
    ax.set_ylim(0, 1)
    ax.set_xlabel("error, see legend")
    ax.set_ylabel("share of tracked frames below")
    ax.legend(loc="upper left", frameon=False)


def _logarithmic(axis: Any, set_scale: Callable[[str], None]) -> None:
    """Make an axis logarithmic, with plain numbers."""
    from matplotlib.ticker import LogLocator

    set_scale("log")
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter("")


def _reliability(ax: Any, curve: Reliability) -> None:
    ax.plot([0, 1], [0, 1], color=FAINT, linestyle="--")
    if curve.bins:
        x, y = np.array([(b.confidence, b.good) for b in curve.bins]).T
        bounds = np.array([(b.good - b.good_low, b.good_high - b.good) for b in curve.bins]).T
        ax.errorbar(x, y, yerr=np.maximum(bounds, 0), color=POSITION, marker="o", capsize=3)
        for b in curve.bins:
            ax.annotate(str(b.frames), (b.confidence, b.good), xytext=(5, -11), textcoords="offset points", fontsize=8)
    ax.set(xlim=(0, 1.02), ylim=(0, 1.02), xlabel="confidence (mean of the bin)")
    ax.set_ylabel("share within 10 mm and 5 degrees")
    ax.set_title(f"expected calibration error {curve.error:.3f}; frames of each bin at its point", fontsize=10)


def _boxes(ax: Any, groups: Sequence[Array], labels: Sequence[str], colours: Sequence[str], floor: float) -> None:
    """Draw boxes of quartiles with whiskers at 5 % and 95 %, on a logarithmic axis."""
    values = [np.maximum(g, floor) if g.size else np.array([np.nan]) for g in groups]
    boxes = ax.boxplot(
        values, whis=(5, 95), showfliers=False, widths=0.65, patch_artist=True, medianprops={"color": "#20262c"}
    )
    for box, colour in zip(boxes["boxes"], colours, strict=True):
        box.set(facecolor=colour, alpha=0.55, edgecolor=colour)
    _logarithmic(ax.yaxis, ax.set_yscale)
    ax.set_xticks(range(1, len(labels) + 1), labels, rotation=60, ha="right", rotation_mode="anchor", fontsize=8)
    ax.grid(False, axis="x")


def draw_comparison(
    results: Mapping[str, Results],
    figures: Mapping[str, Mapping[str, IntervalEstimate]],
    groups: Sequence[str],
    title: str,
) -> "Figure":
    """Plot both errors as boxes, and the tracked share, for each condition.

    Args:
        results: errors of the clips by condition name.
        figures: figures of the same conditions.
        groups: group of each condition, in the same order; conditions of one group have one colour.
        title: title of the figure.
    """
    names = list(results)
    shades = {group: _COLOURS[i % len(_COLOURS)] for i, group in enumerate(dict.fromkeys(groups))}
    colours = [shades[group] for group in groups]
    figure, axes = new_figure(max(8.0, 0.42 * len(names) + 3.5), 11.0, 3, 1, sharex=False)
    errors = [pooled_errors(results[name]) for name in names]
    _boxes(axes[0, 0], [e[0] for e in errors], [""] * len(names), colours, _FLOOR_MM)
    axes[0, 0].set_ylabel("position error [mm]")
    axes[0, 0].axhline(10.0, color=FAINT, linestyle="--", linewidth=1)
    _boxes(axes[1, 0], [e[1] for e in errors], [""] * len(names), colours, _FLOOR_DEG)
    axes[1, 0].set_ylabel("rotation error [degrees]")
    tracked = [figures[name]["tracked_when_seen"] for name in names]
    ax = axes[2, 0]
    values = [f.value for f in tracked]
    ax.bar(range(1, len(names) + 1), values, color=colours, alpha=0.6, width=0.65)
    bounds = np.array([(max(f.value - f.low, 0.0), max(f.high - f.value, 0.0)) for f in tracked]).T
    ax.errorbar(range(1, len(names) + 1), values, yerr=np.nan_to_num(bounds), fmt="none", ecolor="#20262c", capsize=2)
    ax.set_ylim(min(0.9, *np.nan_to_num(values, nan=0.9)) - 0.05, 1.005)
    ax.set_ylabel("tracked, of frames that show\n30 % of the gripper or more")
    ax.axhline(0.9, color=FAINT, linestyle="--", linewidth=1)
    ax.set_xticks(range(1, len(names) + 1), names, rotation=60, ha="right", rotation_mode="anchor", fontsize=8)
    ax.grid(False, axis="x")
    for row in axes[:, 0]:
        row.set_xlim(0.3, len(names) + 0.7)
    figure.suptitle(f"{title}\nboxes: quartiles, whiskers: 5 % and 95 % of tracked frames; bars: 95 % over videos")
    return figure


def draw_contact_sheet(file: TruthClipFile, kinds: Sequence[PerturbationKind], seed: int, columns: int = 4) -> "Figure":
    """Plot the frame of a clip that shows most of the gripper, unchanged and under each perturbation.

    Raises:
        UsageError: the clip's ground truth cannot be read.
        InputError: its video cannot be read.
    """
    clip = file.load()
    frames = read_video(clip.path).frames
    masks = clip.masks(GripperCad())
    chosen = int(masks.sum(axis=(1, 2)).argmax())
    images: dict[str, NDArray[np.uint8]] = {"as it is": frames[chosen]}
    for step in (p for kind in kinds for p in ladder(kind)):
        images[step.label] = perturb(step, frames, masks, seed, clip.id)[0][chosen]
    rows = -(-len(images) // columns)
    figure, axes = new_figure(2.6 * columns, 2.8 * rows, rows, columns)
    for ax in axes.flat:
        ax.axis("off")
    for ax, (name, image) in zip(axes.flat, images.items(), strict=False):
        ax.imshow(image)
        ax.set_title(name, fontsize=9)
    return figure
