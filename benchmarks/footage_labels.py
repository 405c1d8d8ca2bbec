"""Points of the gripper labelled by eye on enlarged frames, and their distance from the tracked gripper.

`footage_labels.json` lists clean videos (a Panda hand in view throughout, nothing edited or generated, so every anomaly
is false) and, by video and frame, named points in pixels of the video as stored, pixel centres at half-integers.
`"unsure": true` marks points that are partly hidden or blurred; they count like the others. Points come in pairs, left
and right in the image:

- `corner_left`, `corner_right`: ends of the lower edge of the wide face turned to the camera, in the middle of the
  rounding: `CORNER_H`;
- `end_left`, `end_right`: lower corners of the narrow end turned to the camera: `END_H`;
- `tip_left`, `tip_right`: middle of the end face of each finger: `TIP_H`, moved by half the gap between the pads.

The hand looks the same after a half turn, and which of a pair is left may be a matter of a pixel: each pair is matched
in the order with the smaller error.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.footage import TrackRecord
from benchmarks.markdown import percent, table
from benchmarks.perception.clip import TruthClipFile
from benchmarks.perception.summary import percentile
from kinebench_drake.camera import Camera
from kinebench_drake.errors import UsageError, cause
from kinebench_drake.geometry import Array, invert, transform_points
from kinebench_drake.io.jsonl import Json, read_json

LABELS = Path(__file__).with_name("footage_labels.json")
CORNER_H = np.array([0.0155, 0.0935, 0.0637])
"""(3,) corner of the hand's CAD body in panda_hand, up to the signs of x and y: outermost towards (1, 1, 1) [m]."""
END_H = np.array([0.0168, 0.0880, 0.0642])
"""(3,) the corner's outermost point towards (1, 0, 1), the outline seen along y [m]."""
TIP_H = np.array([0.0, 0.0072, 0.1123])
"""(3,) middle of the end face of the left finger, closed [m]; of the right finger with -y."""
HAND_LENGTH_M = 0.1123
"""Length of the gripper from the flange to the finger tips [m]."""
SILENT_SHARE = 0.2
"""Reprojection error over the hand's length, beyond which a tracked frame is a silent error."""
_PAIRS = ("corner", "end", "tip")
_SIDES = ("left", "right")
HALF_OPEN_M = 0.04
"""Gap between the finger pads that is assumed where it is unknown [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelledFrame:
    """Labelled points of one frame."""

    frame: int
    points_px: Mapping[str, Array]
    """(2,) pixel by name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FootageLabels:
    """Content of footage_labels.json."""

    clean: tuple[str, ...]
    """Ids of videos without an anomaly."""
    videos: Mapping[str, tuple[LabelledFrame, ...]]
    """Labelled frames by id of the video."""


def read_labels(path: Path = LABELS) -> FootageLabels:
    """Read labels.

    Raises:
        UsageError: the file is not one of labels.
    """
    try:
        data: Any = read_json(path)
        videos = {name: tuple(map(read_frame, frames)) for name, frames in data["videos"].items()}
        return FootageLabels(clean=tuple(data["clean"]), videos=videos)
    except (OSError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise UsageError(f"{path.name}: not a file of labels ({cause(error)})") from None


def read_frame(data: Mapping[str, Any]) -> LabelledFrame:
    """Read the points of one frame.

    Raises:
        ValueError: the object has no points, or unknown ones.
    """
    points = data["points"]
    names = [f"{pair}_{side}" for pair in _PAIRS for side in _SIDES]
    unknown = sorted(set(points) - set(names))
    if unknown or not points:
        raise ValueError(f"frame {data['frame']} has the points {sorted(points)}, expected some of {', '.join(names)}")
    return LabelledFrame(
        frame=int(data["frame"]),
        points_px={name: np.array(point["px"], dtype=np.float64).reshape(2) for name, point in points.items()},
    )


def pair_points(X_CH: Array, width_m: float) -> dict[str, Array]:
    """Return both points (2, 3) of each pair in the camera frame [m].

    Args:
        X_CH: (4, 4) pose of panda_hand in the camera frame [m].
        width_m: gap between the finger pads [m]; 4 cm if NaN.
    """
    face, end = (np.where(invert(X_CH)[:2, 3] < 0, -1.0, 1.0)).tolist()
    opening = np.array([0.0, (width_m if np.isfinite(width_m) else HALF_OPEN_M) / 2, 0.0])
    signs = {
        "corner": np.array([[face, 1.0, 1.0], [face, -1.0, 1.0]]),
        "end": np.array([[1.0, end, 1.0], [-1.0, end, 1.0]]),
        "tip": np.array([[1.0, 1.0, 1.0], [1.0, -1.0, 1.0]]),
    }
    points = {"corner": CORNER_H, "end": END_H, "tip": TIP_H + opening}
    return {pair: transform_points(X_CH, signs[pair] * points[pair]) for pair in _PAIRS}


def reprojection_px(frame: LabelledFrame, camera: Camera, X_CH: Array, width_m: float) -> float:
    """Return the mean distance of the labelled points from those of a gripper at `X_CH` (4, 4) [px].

    NaN if the gripper's pose is unknown or a point of it is behind the camera.
    """
    if not np.isfinite(X_CH).all():
        return float("nan")
    errors: list[float] = []
    for pair, p_C in pair_points(X_CH, width_m).items():
        if (p_C[:, 2] <= 0).any():
            return float("nan")
        drawn = camera.project(p_C)
        labels = [
            (k, frame.points_px[f"{pair}_{side}"])
            for k, side in enumerate(_SIDES)
            if f"{pair}_{side}" in frame.points_px
        ]
        orders = [[float(np.linalg.norm(drawn[k ^ swap] - px)) for k, px in labels] for swap in (0, 1)]
        errors += min(orders, key=sum)
    return float(np.mean(errors))


def hand_lengths_px(frames: Sequence[LabelledFrame]) -> Array:
    """Return the length (n,) of the hand in each frame, if it were parallel to the image [px], from the labels alone.

    Scales come from frames with both corners and both tips; in between they are interpolated. Videos without such
    frames take the distance of two points of the body, else that of a corner and its finger tip at half opening.
    """
    for estimate in (_affine_scale, _body_scale, _finger_scale):
        scales = np.array([estimate(frame.points_px) for frame in frames])
        finite = np.isfinite(scales)
        if finite.any():
            numbers = np.array([frame.frame for frame in frames], dtype=np.float64)
            return np.asarray(HAND_LENGTH_M * np.interp(numbers, numbers[finite], scales[finite]))
    return np.full(len(frames), np.nan)


def _affine_scale(px: Mapping[str, Array]) -> float:
    """Return pixels a metre in the direction that is not foreshortened; NaN unless both corners and tips are labelled.

    Far from the camera a plane is imaged by an affine map, whose larger singular value is the scale: some direction of
    the plane is parallel to the image (Huttenlocher and Ullman, IJCV 5, 1990). The plane is that of the hand's y and z
    axes; that the corners lie 15 mm in front of it is neglected.
    """
    if not {f"{pair}_{side}" for pair in ("corner", "tip") for side in _SIDES} <= px.keys():
        return float("nan")
    y = (px["corner_right"] - px["corner_left"]) / (2 * CORNER_H[1])
    middles = [(px[f"{pair}_left"] + px[f"{pair}_right"]) / 2 for pair in ("corner", "tip")]
    z = (middles[1] - middles[0]) / (TIP_H[2] - CORNER_H[2])
    return float(np.linalg.svd(np.stack([y, z]), compute_uv=False)[0])


def _body_scale(px: Mapping[str, Array]) -> float:
    """Return pixels a metre from two points of the body, foreshortened; NaN without them."""
    pairs = (("corner", 2 * CORNER_H[1]), ("end", 2 * END_H[0]))
    ratios = [
        float(np.linalg.norm(px[f"{pair}_right"] - px[f"{pair}_left"])) / length_m
        for pair, length_m in pairs
        if f"{pair}_left" in px and f"{pair}_right" in px
    ]
    return max(ratios, default=float("nan"))


def _finger_scale(px: Mapping[str, Array]) -> float:
    """Return pixels a metre from a corner and its finger tip, foreshortened; NaN without them."""
    length_m = float(np.linalg.norm(CORNER_H - TIP_H - [0.0, HALF_OPEN_M / 2, 0.0]))
    sides = [side for side in _SIDES if {f"corner_{side}", f"tip_{side}"} <= px.keys()]
    ratios = [float(np.linalg.norm(px[f"corner_{side}"] - px[f"tip_{side}"])) / length_m for side in sides]
    return max(ratios, default=float("nan"))


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelErrors:
    """Reprojection errors of one video at its labelled frames."""

    id: str
    tracked: NDArray[np.bool_]
    """(n,)."""
    share: Array
    """(n,) mean reprojection error of the tracked pose over the hand's length; NaN where there is none."""


def compare_labels(video: TruthClipFile, track: TrackRecord, frames: Sequence[LabelledFrame]) -> LabelErrors:
    """Return the reprojection errors of a track.

    Raises:
        UsageError: a labelled frame is not in the video.
    """
    rows = [frame.frame for frame in frames]
    if max(rows) >= len(track.tracked):
        raise UsageError(f"{video.id}: frame {max(rows)} is labelled, the video has {len(track.tracked)} frames")
    length = hand_lengths_px(frames)
    px = [reprojection_px(f, video.camera, track.X_CH[f.frame], float(track.finger_width_m[f.frame])) for f in frames]
    return LabelErrors(id=video.id, tracked=track.tracked[rows], share=np.array(px) / length)


def label_figures(errors: Sequence[LabelErrors]) -> dict[str, Json]:
    """Return the figures of a group of videos, frames pooled; NaN where there is nothing to measure."""
    tracked = np.concatenate([e.tracked for e in errors])
    share = np.concatenate([e.share for e in errors])[tracked]
    return {
        "frames": len(tracked),
        "tracked": float(tracked.mean()),
        "error_median": percentile(share, 50),
        "error_p95": percentile(share, 95),
        "silent": float((~(share <= SILENT_SHARE)).mean()) if len(share) else float("nan"),
    }


def label_table(groups: Mapping[str, Mapping[str, Json]]) -> list[str]:
    """Return the lines of a Markdown table of `label_figures` by name."""
    head = ("", "labelled frames", "tracked", "error / hand length, median", "95 %", "silent errors")
    keys = ("tracked", "error_median", "error_p95", "silent")
    return table(head, ([name, str(f["frames"]), *(percent(f[key]) for key in keys)] for name, f in groups.items()))
