"""The depth errors as a picture: heat maps over the gripper, and one frame."""

from typing import TYPE_CHECKING, Any

import numpy as np

from kinebench_drake.drawing import new_figure
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.evaluation.depth_map import EXTENT_H, DepthErrors, ErrorMap

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_AXES = ("x", "y", "z")


def draw_depth(errors: DepthErrors, label: str) -> "Figure":
    """Mean relative error over the gripper from two sides; picture, true and estimated depth and error of one frame."""
    figure, axes = new_figure(15.0, 6.6, 2, 4)
    for ax in axes.flat:
        ax.grid(False)
    means = [100 * m.mean() for m in (errors.front, errors.side)]
    top = max(float(np.nanpercentile(np.concatenate([m.ravel() for m in means]), 98)), 0.1)
    for ax, errormap, mean, name in zip(
        axes[0, :2], (errors.front, errors.side), means, ("front", "side"), strict=True
    ):
        _heat(figure, ax, errormap, mean, top)
        ax.set_title(f"the hand from its {name}", fontsize=10)
    axes[0, 1].set_ylabel("")
    _counts(figure, axes[0, 2], errors.front)
    axes[0, 3].axis("off")
    axes[0, 3].text(
        0.0, 0.9,
        f"{label}\n\n|error| of a cell\n  median {errors.median:.2%}\n  95 %     {errors.p95:.2%}\n\n"
        f"common error of a frame\n  median {errors.level_median:.2%}",
        va="top", family="monospace", fontsize=11, transform=axes[0, 3].transAxes,
    )  # fmt: skip
    example = errors.example
    depths = np.concatenate([d[np.isfinite(d)] for d in (example.true_m, example.estimated_m)])
    low, high = float(depths.min()), float(depths.max())
    axes[1, 0].imshow(example.picture)
    axes[1, 0].set_title("close view of one frame", fontsize=10)
    for ax, depth, name in zip(axes[1, 1:3], (example.true_m, example.estimated_m), ("true", "estimated"), strict=True):
        image = ax.imshow(depth, cmap="viridis", vmin=low, vmax=high)
        ax.set_title(f"{name} depth", fontsize=10)
        figure.colorbar(image, ax=ax, label="depth [m]", shrink=0.8)
    reach = max(float(np.nanpercentile(np.abs(100 * example.error), 98)), 0.1)
    image = axes[1, 3].imshow(100 * example.error, cmap="RdBu_r", vmin=-reach, vmax=reach)
    axes[1, 3].set_title("error (red: too far)", fontsize=10)
    figure.colorbar(image, ax=axes[1, 3], label="relative error [%]", shrink=0.8)
    for ax in axes[1]:
        ax.axis("off")
    return figure


def _heat(figure: "Figure", ax: Any, errormap: ErrorMap, mean: Array, top: float) -> None:
    image = ax.imshow(mean, origin="lower", extent=_extent(errormap), cmap="magma_r", vmin=0.0, vmax=top)
    _label(ax, errormap)
    figure.colorbar(image, ax=ax, label="mean |relative error| [%]", shrink=0.8)


def _counts(figure: "Figure", ax: Any, errormap: ErrorMap) -> None:
    shown = np.where(errormap.count > 0, errormap.count, np.nan)
    image = ax.imshow(shown, origin="lower", extent=_extent(errormap), cmap="Greys", norm="log")
    _label(ax, errormap)
    ax.set_title("cells measured", fontsize=10)
    figure.colorbar(image, ax=ax, label="cells", shrink=0.8)


def _extent(errormap: ErrorMap) -> tuple[float, float, float, float]:
    (left, right), (bottom, top) = (1e3 * EXTENT_H[a] for a in errormap.axes)
    return float(left), float(right), float(bottom), float(top)


def _label(ax: Any, errormap: ErrorMap) -> None:
    across, up = (_AXES[a] for a in errormap.axes)
    ax.set(xlabel=f"{across} of panda_hand [mm]", ylabel=f"{up} of panda_hand [mm]")
    ax.set_aspect("equal")
    ax.invert_yaxis()
