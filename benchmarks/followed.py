"""Following in footage of others: recordings with their joint angles, and tiles of real rows above generated ones."""

import json
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.markdown import table
from benchmarks.pair_labels import PairLabels
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.displacement import Displacement, measure_displacement
from kinebench_drake.grounding.panels.panel import name_places, sort_panels
from kinebench_drake.grounding.panels.split import split_frames
from kinebench_drake.io.reader import read_video
from kinebench_drake.metrics.following import find_onset, worst_median
from kinebench_drake.models.panda.description import GripperKind
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.store import read_rows
from kinebench_drake.runs.config import FollowConfig
from kinebench_drake.runs.follow import DRIFT_SHARE, follow_videos
from kinebench_drake.stats import PERCENTILES, paired_mean_difference, resampled_indices

SHIFT = 4
"""Places by which episodes are exchanged: neighbours may be of one task."""
_WINDOW = 7
"""Side of the windows of structural similarity [px]."""
_RANGE = 255.0
"""Range of the values of pixels."""
VIEWS = {"ext1": "left", "ext2": "middle"}
"""Columns of a tile by the view of the labels; the right one is that of the hand."""


def write_manifests(folder: Path, work: Path) -> dict[str, Path]:
    """Write the joint angles of a folder as actions, and a manifest with the own and one with exchanged ones.

    Args:
        folder: NAME.json with `joints_rad_and_gripper` (T, 8) and `frame_period_s`, and videos NAME_VIEW.mp4 that show
            the robot from outside, or as VIEW `wrist`, which is left out.
        work: output folder.
    """
    episodes = sorted(folder.glob("*.json"))
    data: list[Any] = [json.loads(path.read_text()) for path in episodes]
    manifests = {}
    for kind, shift in (("own", 0), ("other", SHIFT)):
        home = work / kind
        home.mkdir(parents=True, exist_ok=True)
        lines = []
        for k, path in enumerate(episodes):
            q = np.array(data[k]["joints_rad_and_gripper"], np.float64)[:, :7]
            np.savez(home / f"{path.stem}.npz", q=q, t_s=data[k]["frame_period_s"] * np.arange(len(q)))
            actions = f"{episodes[(k + shift) % len(episodes)].stem}.npz"
            for video in sorted(folder.glob(f"{path.stem}_*.mp4")):
                if "wrist" not in video.stem:
                    shutil.copyfile(video, home / video.name)
                    line = {"video": video.name, "actions": actions, "frame_period_s": data[k]["frame_period_s"]}
                    lines.append(json.dumps(line))
        manifests[kind] = home / "manifest.jsonl"
        manifests[kind].write_text("\n".join(lines) + "\n")
    return manifests


def measure_joints(folder: Path, work: Path, gripper: GripperKind, limit: int | None) -> Iterator[str]:
    """Compare recordings with their own joint angles and with those of other episodes; yield a table of both."""
    rows: dict[str, Mapping[str, SampleRow]] = {}
    for kind, manifest in write_manifests(folder, work).items():
        out = work / f"{kind}-out"
        follow_videos(FollowConfig(source=manifest, out=out, gripper=gripper, limit=limit, replays=None))
        rows[kind] = read_rows(out)
    lines = []
    for id, own in rows["own"].items():
        cells = (*(_verdict(row) for row in (own, rows["other"][id])), _number(own.lag_frames), _links(own))
        lines.append((id, *cells, (own.reason or own.follow_reason or "")[:80]))
    yield from table(("view", "own joints", "others", "lag [frames]", "links: own, most of controls", "reason"), lines)
    yield ""
    for kind, of_kind in rows.items():
        count = sum(row.follows is True for row in of_kind.values())
        yield f"{kind}: {count} of {len(of_kind)} follow"


def _verdict(row: SampleRow) -> str:
    return str(row.follows).lower() if row.status.value == "ok" else row.status.value


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:g}"


def _links(row: SampleRow) -> str:
    if row.link_agreement is None:
        return "-"
    shares = {name: float(str(value)) for name, value in row.link_agreement.items()}
    return f"{shares.pop('own'):.0%}, {max(shares.values()):.0%}"


@dataclass(frozen=True, slots=True, kw_only=True)
class PairedView:
    """One exterior view of a clip in both rows."""

    clip: str
    view: str
    displacement: Displacement
    ssim: Array
    """(T,) structural similarity of the grey frames."""
    width_px: int

    @property
    def model(self) -> str:
        """Checkpoint of the clip."""
        return self.clip.partition("_")[0]

    @property
    def key(self) -> str:
        """What the views of all checkpoints have in common."""
        return f"{self.clip.partition('_')[2]} {self.view}"

    @property
    def median_px(self) -> float:
        """Median deviation, frames without counterpart worse than any."""
        value = worst_median(self.displacement.distance_px)
        return np.inf if value is None else value

    @property
    def onset(self) -> float:
        """Frame from which on the view has drifted; infinite if it does not."""
        first = find_onset(self.displacement.distance_px <= DRIFT_SHARE * self.width_px)
        return np.inf if first is None else float(self.displacement.frames[first])


def measure_pairs(folder: Path) -> list[PairedView]:
    """Compare the generated row of each tile with the real one above it, view by view."""
    views = []
    for path in sorted(folder.glob("*.mp4")):
        frames = read_video(path).frames
        parts = sort_panels([tile.rectangle for tile in split_frames(frames)])
        named = dict(zip(name_places(parts), parts, strict=True))
        for view, column in VIEWS.items():
            suffix = "" if column == "middle" and f"top-{column}" not in named else f"-{column}"
            real, clip = (np.ascontiguousarray(named[f"{row}{suffix}"].crop(frames)) for row in ("top", "bottom"))
            views.append(
                PairedView(
                    clip=path.stem,
                    view=view,
                    displacement=measure_displacement(clip, real),
                    ssim=np.array([structural_similarity(*map(_grey, pair)) for pair in zip(clip, real, strict=True)]),
                    width_px=real.shape[2],
                )
            )
    return views


def structural_similarity(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
    """Return the mean structural similarity of two grey images (H, W) over all windows of 7 x 7 px in them.

    Z. Wang, A. Bovik, H. Sheikh, E. Simoncelli, "Image quality assessment: from error visibility to structural
    similarity", IEEE TIP 13, 2004.
    """
    n = _WINDOW**2
    edge = _WINDOW // 2
    x = a.astype(np.float64)
    y = b.astype(np.float64)

    def mean(image: Array) -> Array:
        return np.asarray(cv2.boxFilter(image, -1, (_WINDOW, _WINDOW)))[edge:-edge, edge:-edge]

    mean_x = mean(x)
    mean_y = mean(y)
    product = mean_x * mean_y
    squares = mean_x**2 + mean_y**2
    covariance = n / (n - 1) * (mean(x * y) - product)
    variances = n / (n - 1) * (mean(x * x + y * y) - squares)
    c_1 = (0.01 * _RANGE) ** 2
    c_2 = (0.03 * _RANGE) ** 2
    return float(((2.0 * product + c_1) * (2.0 * covariance + c_2) / ((squares + c_1) * (variances + c_2))).mean())


def _grey(image: np.ndarray[Any, np.dtype[np.uint8]]) -> np.ndarray[Any, np.dtype[np.uint8]]:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)


def compare_labels(views: list[PairedView], labels: PairLabels) -> Iterator[str]:
    """Yield a table of the measured deviation by what both passes of the labels say of a frame."""
    groups: dict[str, list[tuple[float, float, float]]] = {
        name: [] for name in ("differs, both passes", "differs, one pass", "alike, both passes", "not comparable")
    }
    for view in views:
        own = [one[f"{view.clip} {view.view}"] for one in labels.passes]
        for frame, px in zip(view.displacement.frames.tolist(), view.displacement.distance_px.tolist(), strict=True):
            marks = sum(frame in one.differs for one in own)
            group = ("alike, both passes", "differs, one pass", "differs, both passes")[marks]
            if any(frame in one.not_comparable for one in own):
                group = "not comparable"
            groups[group].append((px, view.displacement.error_px, DRIFT_SHARE * view.width_px))
    rows = []
    for name, values in groups.items():
        px, error, far = np.array(values).reshape(-1, 3).T
        lost = np.isnan(px)
        counts = (len(px), int(lost.sum()), int((lost | (px > 3.0 * error)).sum()), int((lost | (px > far)).sum()))
        rows.append((name, *map(str, counts), f"{np.nanmedian(px):.1f}" if not lost.all() else "-"))
    head = ("frames", "number", "without counterpart", "these or beyond 3 errors", "these or beyond 3 % of the width")
    yield from table((*head, "median [px]"), rows)
    errors = [view.displacement.error_px for view in views]
    yield ""
    yield f"error by a second coding: median {np.median(errors):.2f} px, at most {max(errors):.2f} px"


def compare_models(views: list[PairedView]) -> Iterator[str]:
    """Yield a table of the checkpoints, and one of their paired differences."""
    models = {model: [v for v in views if v.model == model] for model in sorted({v.model for v in views})}
    rows = []
    for model, own in models.items():
        onsets = np.array([view.onset for view in own])
        rows.append(
            (
                model,
                str(len(own)),
                _median(np.array([view.median_px for view in own]), ".1f"),
                f"{int(np.isfinite(onsets).sum())}",
                _median(onsets, ".0f"),
                _median(np.array([view.ssim.mean() for view in own]), ".3f"),
            )
        )
    yield from table(("model", "views", "deviation [px]", "drift", "half drift by frame", "SSIM"), rows)
    yield ""
    lines = []
    for first, second in combinations(models, 2):
        pairs = [(a, b) for a in models[first] for b in models[second] if a.key == b.key]
        cells = []
        for name, value in (
            ("deviation", lambda view: view.median_px),
            ("ssim", lambda view: float(view.ssim.mean())),
        ):
            both = np.array([(value(a), value(b)) for a, b in pairs])
            both = both[np.isfinite(both).all(axis=1)]
            difference = paired_mean_difference(both[:, 0], both[:, 1], np.random.default_rng(0))
            digits = 1 if name == "deviation" else 3
            ends = f"{difference.low:.{digits}f} to {difference.high:.{digits}f}"
            cells.append(f"{difference.value:.{digits}f} ({ends}), {len(both)} views")
        lines.append((f"{first} - {second}", *cells))
    yield from table(("difference of means", "deviation [px]", "SSIM"), lines)


def _median(values: Array, pattern: str) -> str:
    """Format a median with its 95 % bootstrap interval; infinite values count as the greatest."""
    drawn = resampled_indices(len(values), np.random.default_rng(0))
    medians = np.concatenate([np.quantile(values[part], 0.5, axis=1, method="higher") for part in drawn])
    low, high = np.percentile(medians, PERCENTILES, method="nearest")
    middle = np.quantile(values, 0.5, method="higher")
    text = [format(value, pattern) if np.isfinite(value) else "none" for value in (middle, low, high)]
    return f"{text[0]} ({text[1]} to {text[2]})"
