"""Errors of the grounding on videos with reference poses: per kind of reference, per video, by confidence."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks.footage import TrackRecord
from benchmarks.markdown import percent, table
from benchmarks.perception.clip import TruthClip
from benchmarks.perception.summary import percentile, reliability_curve
from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.grounding import bounds
from kinebench_drake.io.jsonl import Json
from kinebench_drake.models.panda.description import hand_from_tcp

VISIBLE_PX = 400
"""Pixels of the gripper from which a frame is expected to be tracked."""
SILENT_M = 0.030
SILENT_RAD = float(np.deg2rad(15.0))
"""Error of a tracked frame from which it is a silent error."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseErrors:
    """Errors of one video, frame by frame; NaN where there is no pose."""

    id: str
    visible: NDArray[np.bool_]
    """(T,) frames that show enough of the gripper."""
    tracked: NDArray[np.bool_]
    detected: NDArray[np.bool_]
    """(T,) frames with a pose, tracked or not."""
    arm_agrees: NDArray[np.bool_]
    confidence: Array
    hand_m: Array
    """(T,) distance of panda_hand from the reference, in the camera frame [m]."""
    along_m: Array
    """(T,) its part along the line of sight [m], signed: positive is too far away."""
    across_m: Array
    """(T,) its part across the line of sight [m]."""
    tcp_m: Array
    """(T,) distance of panda_hand_tcp from the reference [m]: the same in the base frame."""
    rotation_rad: Array
    width_m: Array
    """(T,) error of the gap between the finger pads [m]."""
    frame_m: Array
    """(T,) distance of panda_hand as `hand_m`, of every detected frame by itself."""
    anomalies: Mapping[str, int]
    """Number by kind."""
    cpu_s: float

    @property
    def silent(self) -> NDArray[np.bool_]:
        """(T,) tracked frames whose TCP pose is off by `SILENT_M` or `SILENT_RAD`."""
        return np.asarray(self.tracked & ((self.tcp_m >= SILENT_M) | (self.rotation_rad >= SILENT_RAD)))

    @property
    def good(self) -> NDArray[np.bool_]:
        """(T,) frames within the bounds whose probability the confidence is."""
        return np.asarray((self.hand_m <= bounds.GOOD_M) & (self.rotation_rad <= bounds.GOOD_RAD))


def compare(video: TruthClip, track: TrackRecord) -> PoseErrors:
    """Return the errors of a track against reference poses."""
    X_HG = hand_from_tcp()
    hand_m, rotation_rad = pose_difference(video.X_CH, track.X_CH)
    tcp_m, _ = pose_difference(video.X_CH @ X_HG, track.X_CH @ X_HG)
    p_C = video.X_CH[:, :3, 3]
    offset = track.X_CH[:, :3, 3] - p_C
    along = (offset * p_C).sum(axis=1) / np.linalg.norm(p_C, axis=1)
    visible = np.ones(len(p_C), dtype=bool) if video.visible_px is None else video.visible_px >= VISIBLE_PX
    return PoseErrors(
        id=video.id,
        visible=visible,
        tracked=track.tracked,
        detected=np.asarray(np.isfinite(track.X_CH_frame).all(axis=(1, 2))),
        arm_agrees=track.arm_agrees,
        confidence=track.confidence,
        hand_m=hand_m,
        along_m=along,
        across_m=np.sqrt(np.maximum(hand_m**2 - along**2, 0.0)),
        tcp_m=tcp_m,
        rotation_rad=rotation_rad,
        width_m=np.abs(track.finger_width_m - video.finger_width_m),
        frame_m=pose_difference(video.X_CH, track.X_CH_frame)[0],
        anomalies=Counter(a.kind.value for a in track.anomalies),
        cpu_s=track.cpu_s,
    )


def figures(errors: Sequence[PoseErrors]) -> dict[str, Json]:
    """Return the figures of a group of videos, frames pooled; NaN where there is nothing to measure."""
    pooled = {
        name: np.concatenate([getattr(e, name) for e in errors])
        for name in ("visible", "tracked", "detected", "arm_agrees", "silent", "good", "confidence", "frame_m")
    }
    tracked = pooled["tracked"]
    visible = pooled["visible"]
    detected = pooled["detected"]
    result: dict[str, Json] = {
        "videos": len(errors),
        "frames": len(tracked),
        "visible_frames": int(visible.sum()),
        "tracked": _mean(tracked[visible]),
        "detected": _mean(detected[visible]),
        "arm_agrees": _mean(pooled["arm_agrees"][visible]),
        "silent": _mean(pooled["silent"][tracked]),
        "good": _mean(pooled["good"][tracked]),
    }
    for name, unit in (("hand", 1e3), ("along", 1e3), ("across", 1e3), ("tcp", 1e3), ("width", 1e3)):
        _spread(
            result, f"{name}_mm", unit * np.concatenate([np.abs(getattr(e, f"{name}_m"))[e.tracked] for e in errors])
        )
    _spread(result, "rotation_deg", np.rad2deg(np.concatenate([e.rotation_rad[e.tracked] for e in errors])))
    _spread(result, "frame_mm", 1e3 * pooled["frame_m"][detected])
    signed = np.concatenate([e.along_m[e.tracked] for e in errors])
    result["along_mean_mm"] = 1e3 * _mean(signed[np.isfinite(signed)])
    curve = reliability_curve(pooled["confidence"][tracked], pooled["good"][tracked])
    result["confidence_mean"] = _mean(pooled["confidence"][tracked])
    result["calibration_error"] = curve.error
    result["reliability"] = [b.to_json() for b in curve.bins]
    result["anomalies"] = dict(sum((Counter(e.anomalies) for e in errors), Counter()))
    result["cpu_s_per_frame"] = sum(e.cpu_s for e in errors) / max(len(tracked), 1)
    return result


def _mean(values: Array) -> float:
    return float(np.mean(values)) if len(values) else float("nan")


def _spread(result: dict[str, Json], name: str, values: Array) -> None:
    finite = values[np.isfinite(values)]
    result[f"{name}_median"] = percentile(finite, 50)
    result[f"{name}_p95"] = percentile(finite, 95)


_HEAD = (
    *("", "frames", "tracked", "detected", "arm agrees", "hand [mm]", "across / along [mm]", "TCP [mm]"),
    *("rotation [deg]", "silent errors", "good / confidence", "anomalies"),
)


def error_table(groups: Mapping[str, Mapping[str, Json]]) -> list[str]:
    """Return the lines of a Markdown table of `figures` by name; errors are median / 95th percentile."""
    return table(_HEAD, (_row(name, group) for name, group in groups.items()))


def _row(name: str, f: Mapping[str, Json]) -> list[str]:
    pair = partial(_pair, f)
    anomalies = f["anomalies"]
    kinds = ", ".join(f"{n} {kind}" for kind, n in sorted(anomalies.items())) if isinstance(anomalies, dict) else ""
    return [
        name,
        f"{f['visible_frames']} of {f['frames']}",
        *(percent(f[key]) for key in ("tracked", "detected", "arm_agrees")),
        pair("hand_mm"),
        f"{_number(f['across_mm_median'])} / {_number(f['along_mm_median'])} (mean {_number(f['along_mean_mm'])})",
        pair("tcp_mm"),
        pair("rotation_deg"),
        percent(f["silent"]),
        f"{percent(f['good'])} / {percent(f['confidence_mean'])}",
        kinds,
    ]


def reliability_table(groups: Mapping[str, Mapping[str, Json]]) -> list[str]:
    """Return the lines of a Markdown table of the share of good frames by confidence."""
    rows: list[list[str]] = []
    for name, group in groups.items():
        bins = group["reliability"]
        for b in bins if isinstance(bins, list) else ():
            share = f"{b['good']:.2f} ({b['good_low']:.2f} to {b['good_high']:.2f})"
            rows.append([name, f"{b['low']:.1f} to {b['high']:.1f}", str(b["frames"]), f"{b['confidence']:.2f}", share])
    return table(("", "confidence", "tracked frames", "mean", "within 10 mm and 5 degrees"), rows)


def _number(value: Json) -> str:
    return f"{value:.1f}" if isinstance(value, int | float) and np.isfinite(value) else "-"


def _pair(f: Mapping[str, Json], key: str) -> str:
    return f"{_number(f[f'{key}_median'])} / {_number(f[f'{key}_p95'])}"
