"""Results of an episode of several clips: each clip is judged alone, and the results are combined.

A later clip begins where the robot was when the clip was requested, which need not be where the earlier clip ended.
The step between the two is not a motion of any clip and is not judged.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.io.jsonl import Json
from kinebench_drake.metrics.coverage import COST_MAX
from kinebench_drake.metrics.kinematic_result import KinematicResult, Value
from kinebench_drake.results.direction import BOUND
from kinebench_drake.results.row import MetricValue
from kinebench_drake.runs.score import mean_confidence
from kinebench_drake.track import Domain, GripperTrack, JointTrack

if TYPE_CHECKING:  # loads ManiSkill
    from kinebench_drake.suites.closed_loop.loop import EpisodeRun

_GREATEST = frozenset(
    {
        *("velocity_ratio_max", "acceleration_ratio_max", "jerk_ratio_max", "torque_ratio_max", "slowdown_min"),
        "feasible_from_period_s",
        *("ik_position_error_max_m", "trajopt_position_tube_m"),
    }
)
_LEAST = frozenset(
    {
        *("joint_limit_margin_min", "manipulability_min"),
        *("self_distance_min_m", "table_distance_min_m", "trajopt_feasible", "motionless"),
    }
)
_TOTAL = frozenset({"manipulability_integral", "path_length_m"})
_UNREACHED: Mapping[str, float] = {
    "ik_success_rate": 0.0,
    "manipulability_cost_mean": COST_MAX,
    **dict.fromkeys(("manipulability_mean", "manipulability_min", "manipulability_integral"), 0.0),
}
"""Values of a clip in which no frame is reached, if there are other clips."""


def clip_starts(tracks: Sequence[GripperTrack]) -> list[int]:
    """Return the frame of the joined track at which each clip begins."""
    return [int(n) for n in np.cumsum([0, *(len(track.t_s) - 1 for track in tracks[:-1])])]


def join_tracks(tracks: Sequence[GripperTrack]) -> GripperTrack:
    """Join the tracks of consecutive clips, each beginning at the time at which the one before ends.

    The first frame of a later clip shows the result of the last frame of the clip before, and is left out.
    """
    ends = np.cumsum([0.0, *(track.t_s[-1] - track.t_s[0] for track in tracks)])
    parts = [track.at(np.arange(k > 0, len(track.t_s))) for k, track in enumerate(tracks)]
    names = ("X_CH", "X_BG", "tracked", "confidence", "finger_width_m")
    arrays: dict[str, Any] = {name: np.concatenate([getattr(p, name) for p in parts]) for name in names}
    return replace(
        tracks[0],
        t_s=np.concatenate([end + p.t_s - t.t_s[0] for end, p, t in zip(ends, parts, tracks, strict=False)]),
        **arrays,
    )


def join_curves(clips: Sequence[Mapping[str, Array]]) -> dict[str, Array]:
    """Join the curves that all clips have, like `join_tracks`."""
    names = [name for name in clips[0] if all(name in clip for clip in clips)]
    return {name: np.concatenate([clip[name][k > 0 :] for k, clip in enumerate(clips)]) for name in names}


def combine(tracks: Sequence[GripperTrack], results: Sequence[KinematicResult]) -> KinematicResult:
    """Combine the results of consecutive clips into one of the joined track, frames counted through all clips.

    Extremes are those of the worst clip, integrals add up, and means are weighted by the clips' durations. If a clip
    has no value, nor has the episode, unless the clip's worst value is known. The episode is infeasible if one clip is,
    and feasible if all are.
    """
    if len(results) == 1:
        return results[0]
    track = join_tracks(tracks)
    starts = clip_starts(tracks)
    durations = [float(t.t_s[-1] - t.t_s[0]) for t in tracks]
    first = results[0]
    details: dict[str, Json] = {name: value for name, value in first.details.items() if name == "limits"}
    details |= {f"clip {k}": {n: v for n, v in r.details.items() if n != "limits"} for k, r in enumerate(results, 1)}
    verdicts = [r.feasible for r in results]
    names = [name for name in first.metrics if not name.endswith(BOUND)]
    values = {name: _combine_metric(name, [r.metrics.get(name) for r in results], durations) for name in names}
    bounds = {
        name + BOUND: _combine_metric(
            name, [r.metrics.get(name + BOUND, r.metrics.get(name)) for r in results], durations
        )
        for name in names
        if any(name + BOUND in r.metrics for r in results)
    }
    return KinematicResult(
        track=track,
        joints=_join_joints(track.t_s, [r.joints for r in results]),
        feasible=False if False in verdicts else None if None in verdicts else True,
        violations=tuple(
            sorted(
                (
                    replace(v, frame_start=start + v.frame_start, frame_end=start + v.frame_end)
                    for result, start in zip(results, starts, strict=True)
                    for v in result.violations
                ),
                key=lambda v: v.rank,
            )
        ),
        metrics={**values, **bounds},
        reasons={
            name: f"clip {k}: {why}" for k, r in reversed([*enumerate(results, 1)]) for name, why in r.reasons.items()
        },
        details=details,
        curves=join_curves([r.curves for r in results]),
    )


def _combine_metric(name: str, values: Sequence[Value], durations: Sequence[float]) -> Value:
    """Combine the values of one metric over all clips."""
    if any(v is False for v in values):
        return False
    if any(v is not None for v in values):
        values = [_UNREACHED.get(name) if v is None else v for v in values]
    numbers = [v for v in values if v is not None]
    if len(numbers) < len(values):
        return None
    if name in _GREATEST | _LEAST | _TOTAL:
        return max(numbers) if name in _GREATEST else min(numbers) if name in _LEAST else sum(numbers)
    return float(np.average(numbers, weights=durations))


def _join_joints(t_s: Array, clips: Sequence[JointTrack]) -> JointTrack:
    arrays = ("q", "position_error_m", "rotation_error_rad")
    return JointTrack(
        t_s=t_s,
        status=tuple(s for k, clip in enumerate(clips) for s in clip.status[k > 0 :]),
        **{name: np.concatenate([getattr(c, name)[k > 0 :] for k, c in enumerate(clips)]) for name in arrays},
    )


def visual_metrics(run: "EpisodeRun", track: GripperTrack) -> dict[str, MetricValue]:
    """Return the visual metrics over all clips, frames counted through all of them."""
    groundings = [r.grounding.measured for r in run.rounds]
    motions = [np.nan if g.camera_motion_px is None else g.camera_motion_px for g in groundings]
    distances = [g.arm_consistency_px for g in groundings if g.arm_consistency_px is not None]
    return {
        "tracked_fraction": float(track.tracked.mean()),
        "confidence_mean": mean_confidence(track),
        "camera_motion_px": None if np.isnan(motions).any() else max(motions),  # unknown in one clip: in all
        "arm_consistency_px": float(np.median(distances)) if distances else None,
        "anomalies": tuple(
            anomaly.after(start)
            for start, g in zip(clip_starts([g.track for g in groundings]), groundings, strict=True)
            for anomaly in g.anomalies
        ),
    }


def open_anomalies(run: "EpisodeRun") -> list[Json]:
    """Return the kinds of anomaly that are open in some clip."""
    return list(sorted({kind.value for r in run.rounds for kind in r.grounding.measured.anomalies_open}))


def camera_paths(run: "EpisodeRun") -> dict[str, Json]:
    """Return how the view of each clip changes, null where it does not; no key if it never does."""
    paths = [r.grounding.measured.camera_path for r in run.rounds]
    entries = [None if path is None else path.to_json() for path in paths]
    return {"camera_paths": entries} if any(entries) else {}


def domain(run: "EpisodeRun") -> Domain:
    """Return whether all clips are familiar."""
    familiar = all(r.grounding.measured.domain is Domain.FAMILIAR for r in run.rounds)
    return Domain.FAMILIAR if familiar else Domain.UNFAMILIAR


def rejections(run: "EpisodeRun") -> list[Json]:
    """Return what was not commanded as generated, round by round."""
    listed = list[Json]()
    for number, done in enumerate(run.rounds):
        if done.rejection is not None:
            listed.append({"round": number, "reason": "nothing_to_execute", "text": done.rejection})
        for rejected in done.commands.rejections if done.commands else ():
            frames: dict[str, Json] = {"frame_start": rejected.frame_start, "frame_end": rejected.frame_end}
            listed.append({"round": number, "reason": rejected.reason.value, **frames})
    return listed
