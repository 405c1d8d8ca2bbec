"""Errors of the grounding on videos with reference poses: per kind of reference, per video, by confidence."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.footage import TrackRecord
from benchmarks.markdown import percent, table
from benchmarks.perception.clip import TruthClip
from benchmarks.perception.summary import percentile
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
    confidence: Array
    hand_m: Array
    """(T,) distance of panda_hand from the reference, in the camera frame [m]."""
    tcp_m: Array
    """(T,) distance of panda_hand_tcp from the reference [m]: the same in the base frame."""
    rotation_rad: Array
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
    visible = np.ones(len(hand_m), dtype=bool) if video.visible_px is None else video.visible_px >= VISIBLE_PX
    return PoseErrors(
        id=video.id,
        visible=visible,
        tracked=track.tracked,
        confidence=track.confidence,
        hand_m=hand_m,
        tcp_m=tcp_m,
        rotation_rad=rotation_rad,
        anomalies=Counter(a.kind.value for a in track.anomalies),
        cpu_s=track.cpu_s,
    )


def figures(errors: Sequence[PoseErrors]) -> dict[str, Json]:
    """Return the figures of a group of videos, frames pooled; NaN where there is nothing to measure."""
    pooled = {
        name: np.concatenate([getattr(e, name) for e in errors])
        for name in ("visible", "tracked", "silent", "good", "confidence", "hand_m", "tcp_m", "rotation_rad")
    }
    tracked = pooled["tracked"]
    visible = pooled["visible"]
    result: dict[str, Json] = {
        "videos": len(errors),
        "frames": len(tracked),
        "visible_frames": int(visible.sum()),
        "tracked": _mean(tracked[visible]),
        "silent": _mean(pooled["silent"][tracked]),
        "good": _mean(pooled["good"][tracked]),
        "confidence_mean": _mean(pooled["confidence"][tracked]),
        "anomalies": dict(sum((Counter(e.anomalies) for e in errors), Counter())),
        "cpu_s_per_frame": sum(e.cpu_s for e in errors) / max(len(tracked), 1),
    }
    for name, values in (
        ("hand_mm", 1e3 * pooled["hand_m"]),
        ("tcp_mm", 1e3 * pooled["tcp_m"]),
        ("rotation_deg", np.rad2deg(pooled["rotation_rad"])),
    ):
        finite = values[tracked & np.isfinite(values)]
        result[f"{name}_median"] = percentile(finite, 50)
        result[f"{name}_p95"] = percentile(finite, 95)
    return result


def _mean(values: Array) -> float:
    return float(np.mean(values)) if len(values) else float("nan")


_HEAD = (
    *("", "frames", "tracked", "hand [mm]", "TCP [mm]", "rotation [deg]", "silent errors"),
    *("good / confidence", "anomalies"),
)


def error_table(groups: Mapping[str, Mapping[str, Json]]) -> list[str]:
    """Return the lines of a Markdown table of `figures` by name; errors are median / 95th percentile."""
    return table(_HEAD, (_row(name, group) for name, group in groups.items()))


def _row(name: str, f: Mapping[str, Json]) -> list[str]:
    anomalies = f["anomalies"]
    kinds = ", ".join(f"{n} {kind}" for kind, n in sorted(anomalies.items())) if isinstance(anomalies, dict) else ""
    return [
        name,
        f"{f['visible_frames']} of {f['frames']}",
        percent(f["tracked"]),
        *(
            f"{_number(f[f'{key}_median'])} / {_number(f[f'{key}_p95'])}"
            for key in ("hand_mm", "tcp_mm", "rotation_deg")
        ),
        percent(f["silent"]),
        f"{percent(f['good'])} / {percent(f['confidence_mean'])}",
        kinds,
    ]


def _number(value: Json) -> str:
    return f"{value:.1f}" if isinstance(value, int | float) and np.isfinite(value) else "-"
