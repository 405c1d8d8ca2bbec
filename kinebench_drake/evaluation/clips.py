"""What kinematics says of an episode of several clips: each is judged by itself, and the findings put together.

A later clip begins where the robot was when it was asked for, which need not be where the earlier clip had imagined it:
the step between the two is nobody's motion and is not judged.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from kinebench_drake.evaluation.stages import Judgement
from kinebench_drake.geometry import Array
from kinebench_drake.types import GripperTrack, IkStatus, JointTrack, Json

_GREATEST = frozenset(
    {
        *("velocity_ratio_max", "acceleration_ratio_max", "jerk_ratio_max", "torque_ratio_max", "slowdown_min"),
        *("ik_position_error_max_m", "trajopt_position_tube_m", "condition_number_max"),
    }
)
_LEAST = frozenset(
    {
        *("joint_limit_margin_min", "manipulability_min", "manipulability_limited_min"),
        *("self_distance_min_m", "table_distance_min_m", "trajopt_feasible"),
    }
)
_TOTAL = frozenset({"manipulability_integral", "branch_jumps"})


def clip_starts(tracks: Sequence[GripperTrack]) -> list[int]:
    """Frame of the joined track at which each clip begins."""
    return [int(n) for n in np.cumsum([0, *(len(track.t_s) - 1 for track in tracks[:-1])])]


def joined_track(tracks: Sequence[GripperTrack]) -> GripperTrack:
    """The tracks of clips that follow each other, each beginning at the moment at which the one before ends.

    The first frame of a later clip shows what the last one of the clip before led to, and is left out.
    """
    ends = np.cumsum([0.0, *(track.t_s[-1] - track.t_s[0] for track in tracks)])
    parts = [track.at(np.arange(k > 0, len(track.t_s))) for k, track in enumerate(tracks)]
    return replace(
        tracks[0],
        t_s=np.concatenate([end + p.t_s - t.t_s[0] for end, p, t in zip(ends, parts, tracks, strict=False)]),
        X_CH=np.concatenate([p.X_CH for p in parts]),
        X_BG=np.concatenate([p.X_BG for p in parts]),
        tracked=np.concatenate([p.tracked for p in parts]),
        confidence=np.concatenate([p.confidence for p in parts]),
        finger_width_m=np.concatenate([p.finger_width_m for p in parts]),
    )


def combine(tracks: Sequence[GripperTrack], found: Sequence[Judgement]) -> Judgement:
    """The judgement of the joined track of some clips, frames counted through all of them.

    Of several clips the worst extremes count, integrals add up, and means are weighed by the clips' durations. A clip
    of which a metric cannot be told is left out of means; extremes and integrals cannot be told then. The episode is
    infeasible if one clip is, and feasible if all are.

    Args:
        tracks: the clips', in their order.
        found: what is said of each.
    """
    if len(found) == 1:
        return found[0]
    track, starts = joined_track(tracks), clip_starts(tracks)
    durations = [float(t.t_s[-1] - t.t_s[0]) for t in tracks]
    metrics = {name: _combined(name, [f.metrics.get(name) for f in found], durations) for name in found[0].metrics}
    details: dict[str, Json] = {name: value for name, value in found[0].details.items() if name == "limits"}
    details |= {f"clip {k}": {n: v for n, v in f.details.items() if n != "limits"} for k, f in enumerate(found, 1)}
    verdicts = [f.feasible for f in found]
    curves = {
        name: np.concatenate([f.curves[name][k > 0 :] for k, f in enumerate(found)])
        for name in found[0].curves
        if all(name in f.curves for f in found)
    }
    return Judgement(
        track=track,
        joints=_joined_joints(track.t_s, [f.joints for f in found]),
        feasible=False if False in verdicts else None if None in verdicts else True,
        metrics=metrics,
        reasons={
            name: f"clip {k}: {why}" for k, f in reversed([*enumerate(found, 1)]) for name, why in f.reasons.items()
        },
        violations=tuple(_later(v, start) for f, start in zip(found, starts, strict=True) for v in f.violations),
        details=details,
        curves=curves,
    )


def _combined(name: str, values: Sequence[Json], durations: Sequence[float]) -> Json:
    """One metric of all clips."""
    known = [(v, d) for v, d in zip(values, durations, strict=True) if isinstance(v, bool | int | float)]
    if name in _GREATEST | _LEAST | _TOTAL:
        if len(known) < len(values):
            return None
        numbers = [v for v, _ in known]
        return max(numbers) if name in _GREATEST else min(numbers) if name in _LEAST else sum(numbers)
    if not known:
        return None
    return float(np.average([float(v) for v, _ in known], weights=[d for _, d in known]))


def _joined_joints(t_s: Array, clips: Sequence[JointTrack]) -> JointTrack:
    def joined(name: str) -> Array:
        return np.concatenate([getattr(clip, name)[k > 0 :] for k, clip in enumerate(clips)])

    status: list[IkStatus] = [s for k, clip in enumerate(clips) for s in clip.status[k > 0 :]]
    return JointTrack(
        t_s=t_s,
        q=joined("q"),
        status=tuple(status),
        position_error_m=joined("position_error_m"),
        rotation_error_rad=joined("rotation_error_rad"),
    )


def _later(violation: Mapping[str, Json], start: int) -> Mapping[str, Json]:
    """A violation of a clip that begins at frame `start` of the episode."""
    frames = {name: violation.get(name) for name in ("frame_start", "frame_end")}
    return {**violation, **{name: start + f for name, f in frames.items() if isinstance(f, int)}}
