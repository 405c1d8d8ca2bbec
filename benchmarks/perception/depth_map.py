"""Errors of the estimated depth as maps over the gripper, and in one example frame."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.perception.clip import TruthClipFile
from kinebench_drake.geometry import Array, invert, transform_points
from kinebench_drake.grounding.priors import ExternalDepth
from kinebench_drake.grounding.tracking.view import Crop, DenseEstimator, GripperView, replace_depth, replace_mask
from kinebench_drake.io.figure import new_figure
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.reader import read_video

if TYPE_CHECKING:
    from matplotlib.figure import Figure


EVERY = 4
"""Interval between measured frames."""
CELL_M = 0.005
"""Width of the cells of a map [m]."""
EXTENT_H = np.array([[-0.06, 0.06], [-0.11, 0.11], [-0.03, 0.13]])
"""Bounds of the maps along x, y, z of panda_hand [m]."""
_CROP_PX = 128
_MARGIN = 1.3


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthExample:
    """Crop of one frame around the gripper."""

    image: NDArray[np.uint8]
    """(S, S, 3)."""
    true_m: Array
    """(h, w) true depth along the optical axis of the crop [m]; NaN off the gripper."""
    estimated_m: Array
    """(h, w) estimated depth [m]; NaN likewise."""

    @property
    def error(self) -> Array:
        """(h, w) relative error, positive if the estimate is too far; NaN off the gripper."""
        return np.asarray(self.estimated_m / self.true_m - 1.0)


@dataclass(slots=True)
class ErrorMap:
    """Mean absolute relative depth error, projected on one plane of panda_hand."""

    axes: tuple[int, int]
    """Axes of panda_hand that point right and up in the map."""
    total: Array = field(init=False)
    count: Array = field(init=False)

    def __post_init__(self) -> None:
        """Create an empty map."""
        across, up = (round(float(np.ptp(EXTENT_H[a])) / CELL_M) for a in self.axes)
        self.total = np.zeros((up, across))
        self.count = np.zeros((up, across))

    def add(self, p_H: Array, error: Array) -> None:
        """Add errors (n,) at points (n, 3) of panda_hand."""
        cells = [np.floor((p_H[:, a] - EXTENT_H[a, 0]) / CELL_M).astype(int) for a in self.axes]
        inside = np.all([(c >= 0) & (c < n) for c, n in zip(cells, self.total.shape[::-1], strict=True)], axis=0)
        u, v = (c[inside] for c in cells)
        np.add.at(self.total, (v, u), np.abs(error[inside]))
        np.add.at(self.count, (v, u), 1.0)

    def mean(self) -> Array:
        """Return the mean of each cell; NaN for fewer than three measurements."""
        return np.where(self.count >= 3, self.total / np.maximum(self.count, 1.0), np.nan)

    def to_json(self) -> dict[str, Any]:
        """Return the JSON object: axes, bounds [mm] (left, right, bottom, top), mean of each cell or None."""
        mean = [[round(v, 5) if np.isfinite(v) else None for v in row] for row in self.mean().tolist()]
        bounds = [round(1e3 * float(end), 3) for a in self.axes for end in EXTENT_H[a]]
        return {"axes": "".join("xyz"[a] for a in self.axes), "bounds_mm": bounds, "mean": mean}


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthErrors:
    """Depth errors of an estimator over clips."""

    front: ErrorMap
    """Projection along the x axis of panda_hand: the fingers open sideways."""
    side: ErrorMap
    """Projection along the y axis of panda_hand."""
    median: float
    """Median absolute relative error over all cells."""
    p95: float
    """95th percentile of the same."""
    level_median: float
    """Median over frames of the absolute median error of a frame: the error common to its cells."""
    example: DepthExample


def measure_depth(clips: Sequence[TruthClipFile], estimator: DenseEstimator) -> DepthErrors | None:
    """Compare the depth of an estimator with the true depth on visible gripper pixels; None if there are none.

    Crops are placed by the true poses, so that only errors of the depth count. In the maps the fingers are closed.

    Raises:
        UsageError: a clip's truth holds no depth.
    """
    front = ErrorMap(axes=(1, 2))
    side = ErrorMap(axes=(0, 2))
    errors: list[Array] = []
    example: DepthExample | None = None
    largest = 0
    for file in clips:
        for image, view, true, X_HV, finger_m in _views(file, estimator):
            both = np.isfinite(true.depth_m) & true.gripper & view.gripper
            if not both.any():
                continue
            error = view.depth_m[both] / true.depth_m[both] - 1.0
            p_H = transform_points(X_HV, true.rays()[both] * true.depth_m[both][:, None])
            p_H[:, 1] -= finger_m * true.opening_sign[both]
            front.add(p_H, error)
            side.add(p_H, error)
            errors.append(error)
            if file is clips[0] and both.sum() > largest:
                largest = int(both.sum())
                blank = np.where(both, 1.0, np.nan)
                example = DepthExample(image=image, true_m=true.depth_m * blank, estimated_m=view.depth_m * blank)
    if not errors or example is None:
        return None
    pooled = np.abs(np.concatenate(errors))
    return DepthErrors(
        front=front,
        side=side,
        median=float(np.median(pooled)),
        p95=float(np.percentile(pooled, 95)),
        level_median=float(np.median([abs(float(np.median(e))) for e in errors])),
        example=example,
    )


def _views(
    file: TruthClipFile, estimator: DenseEstimator
) -> Iterable[tuple[NDArray[np.uint8], GripperView, GripperView, Array, float]]:
    """Yield for every fourth frame: cropped image, estimated view, true view, X_HV, displacement of a finger [m]."""
    clip = file.load(with_depth=True)
    frames: Frames = read_video(clip.path).frames
    if clip.depth_m is None or clip.mask is None:
        return
    numbers = [i for i in range(0, len(frames), EVERY) if np.isfinite(clip.X_CH[i]).all() and clip.X_CH[i, 2, 3] > 0.1]
    depth = ExternalDepth(depth_m=clip.depth_m, exact=True)
    crops = {i: Crop.of_gripper(clip.X_CH[i], _MARGIN, _CROP_PX) for i in numbers}
    for i, view in estimator.estimate(frames, clip.camera, crops):
        true = replace_depth(replace_mask(view, clip.mask[i], clip.camera), depth, i, clip.camera)
        image = np.asarray(view.crop.warp(frames[i], clip.camera), dtype=np.uint8)
        yield image, view, true, invert(clip.X_CH[i]) @ view.crop.X_CV, float(clip.finger_width_m[i]) / 2


def draw_depth(errors: DepthErrors, label: str) -> "Figure":
    """Plot the error maps from two sides, and image, true depth, estimated depth and error of one frame."""
    figure, axes = new_figure(15.0, 6.6, 2, 4)
    for ax in axes.flat:
        ax.grid(False)
    means = [100 * m.mean() for m in (errors.front, errors.side)]
    top = max(float(np.nanpercentile(np.concatenate([m.ravel() for m in means]), 98)), 0.1)
    maps = (errors.front, errors.side)
    for ax, errormap, mean, name in zip(axes[0, :2], maps, means, ("front", "side"), strict=True):
        image = _draw_map(ax, errormap, mean, f"the hand from its {name}", cmap="magma_r", vmin=0.0, vmax=top)
        figure.colorbar(image, ax=ax, label="mean |relative error| [%]", shrink=0.8)
    axes[0, 1].set_ylabel("")
    counts = np.where(errors.front.count > 0, errors.front.count, np.nan)
    image = _draw_map(axes[0, 2], errors.front, counts, "cells measured", cmap="Greys", norm="log")
    figure.colorbar(image, ax=axes[0, 2], label="cells", shrink=0.8)
    axes[0, 3].axis("off")
    axes[0, 3].text(
        0.0, 0.9,
        f"{label}\n\n|error| of a cell\n  median {errors.median:.2%}\n  95 %     {errors.p95:.2%}\n\n"
        f"common error of a frame\n  median {errors.level_median:.2%}",
        va="top", family="monospace", fontsize=11, transform=axes[0, 3].transAxes,
    )  # fmt: skip
    example = errors.example
    depths = np.concatenate([d[np.isfinite(d)] for d in (example.true_m, example.estimated_m)])
    low = float(depths.min())
    high = float(depths.max())
    axes[1, 0].imshow(example.image)
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


def _draw_map(ax: Any, errormap: ErrorMap, values: Array, title: str, **style: Any) -> Any:
    """Draw `values` on the plane of an error map; return the image."""
    (left, right), (bottom, top) = (1e3 * EXTENT_H[a] for a in errormap.axes)
    image = ax.imshow(values, origin="lower", extent=(left, right, bottom, top), **style)
    across, up = ("xyz"[a] for a in errormap.axes)
    ax.set(xlabel=f"{across} of panda_hand [mm]", ylabel=f"{up} of panda_hand [mm]")
    ax.set_title(title, fontsize=10)
    ax.set_aspect("equal")
    ax.invert_yaxis()
    return image
