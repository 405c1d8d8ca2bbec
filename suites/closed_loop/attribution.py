"""Attribution of a failed episode to one cause, with its evidence.

Causes are tested in the order in which they act: frames that were not grounded say nothing about the video, a fault of
the video is not one of the robot, and a deviation of the robot is not one of the task.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.anomaly import Anomaly, AnomalyKind
from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.grounding.video_result import GroundingResult
from kinebench_drake.metrics.executable import FailureVerdict
from kinebench_drake.metrics.following import MIN_FRAMES, PoseSeries, measure_following
from kinebench_drake.metrics.kinematic_result import KinematicResult
from kinebench_drake.report.timeline import covered
from kinebench_drake.results.row import CauseEntry
from kinebench_drake.segments import segments
from kinebench_drake.suites.closed_loop.loop import EpisodeRun, Round
from kinebench_drake.suites.worldmodels.worldmodel import ActionTrack
from kinebench_drake.track import GripperTrack

ASTRAY_M = 0.03
ASTRAY_RAD = float(np.deg2rad(15.0))
"""Deviation of the executed from the generated gripper that counts as failed execution; servos err by 5 mm at most."""
FINGERS_M = 0.02
"""Deviation of the gap between the fingers that counts as failed execution."""
LOST_FRAMES = 3
"""Number of consecutive frames without a pose, or without a gap between the fingers, that may hide the cause."""
LOST_SHARE = 0.1
"""Share of all frames without a pose from which on they may hide it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClipEvidence:
    """Generated and executed motion of one round, up to the last executed frame."""

    tracked: NDArray[np.bool_]
    """(T,) frames with a confident pose."""
    anomalies: tuple[Anomaly, ...]
    """Anomalies of the video."""
    X_BG_generated: Array
    """(T, 4, 4) panda_hand_tcp in the video [m]."""
    X_BG_executed: Array
    """(T, 4, 4) panda_hand_tcp of the robot [m]."""
    finger_width_generated_m: Array
    """(T,) gap between the finger pads in the video [m]; NaN where unknown."""
    finger_width_executed_m: Array
    """(T,) gap of the robot [m]."""
    gripping: bool
    """True if the fingers hold an object at the end, as commanded."""
    violations: tuple[tuple[str, int, int], ...] = ()
    """Infeasible parts of the motion: kind, first and last frame."""
    disobedience: str | None = None
    """What shows that the clip does not follow its actions; None if it does, if that is open, or without actions."""


def find_cause(run: EpisodeRun, results: Sequence[KinematicResult]) -> CauseEntry | None:
    """Return the cause of failure of an episode with the kinematic results of its clips; None if it succeeded."""
    if run.outcome.success:
        return None
    clips = [_evidence(done, result) for done, result in zip(run.rounds, results, strict=True)]
    return attribute(clips, run.outcome.reason)


def _evidence(done: Round, result: KinematicResult) -> ClipEvidence:
    track = done.grounding.track
    execution = done.execution
    frames = len(track.t_s) if execution is None else len(execution.snapshots)
    return ClipEvidence(
        tracked=track.tracked[:frames],
        anomalies=_unexplained(done.grounding),
        X_BG_generated=track.X_BG[:frames],
        X_BG_executed=np.full((frames, 4, 4), np.nan) if execution is None else execution.X_BG,
        finger_width_generated_m=track.finger_width_m[:frames],
        finger_width_executed_m=np.full(frames, np.nan) if execution is None else execution.finger_width_m,
        gripping=done.commands is None or done.commands.gripping,
        violations=tuple((v.kind.value, v.frame_start, v.frame_end) for v in result.violations),
        disobedience=find_disobedience(track, done.actions),
    )


def find_disobedience(track: GripperTrack, actions: ActionTrack | None) -> str | None:
    """Return what shows that the track of a clip does not follow its actions, by the measures of `follow`, or None."""
    if actions is None or min(len(track.t_s), len(actions.t_s)) < MIN_FRAMES:
        return None
    commanded = PoseSeries(t_s=actions.t_s, X=actions.X_BG, finger_width_m=actions.finger_width_m)
    following = measure_following(PoseSeries.of_track(track), commanded, np.random.default_rng(0))
    return following.reason if following.follows is False else None


def _unexplained(grounding: GroundingResult) -> tuple[Anomaly, ...]:
    """Return the anomalies without the motion of a camera that was followed: it does no harm."""
    path = grounding.measured.camera_path
    return tuple(
        a
        for a in grounding.anomalies
        if a.kind is not AnomalyKind.CAMERA or path is None or not path.followed[a.frame_start : a.frame_end + 1].all()
    )


def attribute(clips: Sequence[ClipEvidence], goal: str) -> CauseEntry:
    """Return the first cause that applies to a failed episode; `goal` describes the conditions that are not met."""
    for verdict, find in _TESTS:
        for number, clip in enumerate(clips):
            for run, text, value, limit in find(clip):
                return CauseEntry(
                    verdict=verdict.value,
                    round=number,
                    frame_start=run.start,
                    frame_end=run.stop - 1,
                    value=value,
                    limit=limit,
                    text=text,
                )
    return CauseEntry(
        verdict=FailureVerdict.TASK.value,
        round=None,
        frame_start=None,
        frame_end=None,
        value=None,
        limit=None,
        text=f"{goal or 'the goal is not met'} (grounded, feasible and executed as generated)",
    )


_Evidence: TypeAlias = Iterator[tuple[slice, str, float | None, float | None]]
"""Frames of a clip, description, measured value and its limit."""


def _lost_poses(clip: ClipEvidence) -> _Evidence:
    lost = ~clip.tracked & ~_faulty(clip)
    longest = max(segments(lost), key=_length, default=None)
    if longest is not None and (_length(longest) >= LOST_FRAMES or lost.mean() > LOST_SHARE):
        text = f"no pose in {int(lost.sum())} of {len(lost)} frames, {_length(longest)} of them in a row"
        value = float(_length(longest))
        limit = float(LOST_FRAMES - 1)
        if value <= limit:
            value = float(lost.mean())
            limit = LOST_SHARE
        yield longest, text, value, limit


def _video_faults(clip: ClipEvidence) -> _Evidence:
    frames = len(clip.tracked)
    faults = [(a.frame_start, a.frame_end, f"an anomaly, {a.kind.value}") for a in clip.anomalies]
    faults += [(start, end, f"a motion that no Panda can execute, {kind}") for kind, start, end in clip.violations]
    for start, end, name in sorted(faults):
        if start < frames:
            yield slice(start, min(end + 1, frames)), f"the video has {name.replace('_', ' ')}", None, None


def _disobedience(clip: ClipEvidence) -> _Evidence:
    if clip.disobedience is not None:
        yield slice(0, len(clip.tracked)), f"the video did not follow its actions: {clip.disobedience}", None, None


def _deviations(clip: ClipEvidence) -> _Evidence:
    distance, angle = pose_difference(clip.X_BG_generated, clip.X_BG_executed)
    gap = np.abs(clip.finger_width_generated_m - clip.finger_width_executed_m)
    for values, limit, factor, unit, what in (
        (distance, ASTRAY_M, 1000.0, "mm", "gripper"),
        (angle, ASTRAY_RAD, float(np.rad2deg(1.0)), "degrees", "gripper"),
        (gap, FINGERS_M, 1000.0, "mm", "gap between the fingers"),
    ):
        for run in segments(np.nan_to_num(values) > limit):
            if _length(run) >= 2:  # number of consecutive frames with a deviation that counts
                worst = float(values[run].max())
                yield run, f"the executed {what} is off by up to {worst * factor:.0f} {unit}", worst, limit


def _lost_fingers(clip: ClipEvidence) -> _Evidence:
    longest = max(_hidden_moves(clip), key=_length, default=None)
    if longest is not None:
        frames = _length(longest)
        text = f"the gap between the fingers is unknown in {frames} frames in a row, and may change there"
        yield longest, text, float(frames), float(LOST_FRAMES - 1)


_TESTS = (
    (FailureVerdict.GROUNDING, _lost_poses),
    (FailureVerdict.GENERATION, _video_faults),
    (FailureVerdict.GENERATION, _disobedience),
    (FailureVerdict.EXECUTION, _deviations),
    (FailureVerdict.GROUNDING, _lost_fingers),  # last, as most unknown gaps do no harm
)


def _hidden_moves(clip: ClipEvidence) -> Iterator[slice]:
    """Yield stretches with poses but unknown gaps, unless the gap is the same before and after.

    Up to the end of the clip, fingers that were closed and hold nothing hide no move either: nothing can be let go.
    """
    gap = clip.finger_width_generated_m
    for run in segments(clip.tracked & ~_faulty(clip) & np.isnan(gap)):
        before = gap[: run.start]
        after = gap[run.stop :]
        before = before[np.isfinite(before)]
        after = after[np.isfinite(after)]
        if len(after):
            harmless = len(before) > 0 and abs(after[0] - before[-1]) <= FINGERS_M
        else:
            harmless = len(before) > 0 and before[-1] <= FINGERS_M and not clip.gripping
        if _length(run) >= LOST_FRAMES and not harmless:
            yield run


def _faulty(clip: ClipEvidence) -> NDArray[np.bool_]:
    """Return the frames (T,) within one frame of an anomaly."""
    return covered(clip.anomalies, len(clip.tracked), margin=1)


def _length(run: slice) -> int:
    return int(run.stop - run.start)
