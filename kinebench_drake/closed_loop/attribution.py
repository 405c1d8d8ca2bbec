"""Why an episode failed: one verdict, with what shows it.

The causes are looked at in the order in which they act: what was not read cannot be blamed on the video, what the video
has wrong not on the robot, and what the robot did otherwise not on the task.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.closed_loop.loop import EpisodeRun
from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.metrics.result import KinematicResult
from kinebench_drake.segments import segments
from kinebench_drake.types import Anomaly

LOST_FRAMES = 3
"""So many frames in a row without a pose, though nothing is wrong with the video there, and the reading has failed."""
LOST_SHARE = 0.1
"""The same for this share of all frames."""
ASTRAY_M, ASTRAY_RAD = 0.03, float(np.deg2rad(15.0))
"""From here on the executed gripper is somewhere else than the imagined one; servos alone err by 5 mm at most."""
FINGERS_M = 0.02
"""The executed gap is another one from here on."""
ASTRAY_FRAMES = 2
"""For so many frames in a row."""


class FailureVerdict(Enum):
    """Causes of failure, in the order in which they are looked for."""

    GROUNDING = "grounding"
    """The gripper, or what its fingers do, was not read with confidence in frames that show it."""
    GENERATION = "generation"
    """The video shows what no real gripper does, or a motion that the robot cannot do."""
    EXECUTION = "execution"
    """The executed gripper was not where it had been imagined."""
    TASK = "task"
    """All of that is fine, and the goal is not met: what was imagined does not do the task."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """A verdict with its evidence."""

    verdict: FailureVerdict
    round: int | None
    """The clip that shows it; None for the episode as a whole."""
    frame_start: int | None
    """First frame of that clip that shows it (0-based)."""
    frame_end: int | None
    """Last one, inclusive."""
    value: float | None
    """What was measured, in the unit that `text` gives."""
    limit: float | None
    """What it should not exceed."""
    text: str
    """The same in words."""


def cause_json(cause: Cause) -> dict[str, str | int | float | None]:
    """A cause as plain values."""
    return {**asdict(cause), "verdict": cause.verdict.value}


@dataclass(frozen=True, slots=True, kw_only=True)
class ClipEvidence:
    """What one round left behind, for the frames that were executed."""

    tracked: NDArray[np.bool_]
    """(T,) frames whose pose was read with confidence."""
    anomalies: tuple[Anomaly, ...]
    """What is wrong with the video."""
    X_BG_imagined: Array
    """(T, 4, 4) panda_hand_tcp as read from the video [m]."""
    X_BG_executed: Array
    """(T, 4, 4) panda_hand_tcp as it was [m]."""
    finger_width_imagined_m: Array
    """(T,) gap between the pads as read from the video [m]; NaN where unknown."""
    finger_width_executed_m: Array
    """(T,) gap as it was [m]."""
    violations: tuple[tuple[str, int, int], ...] = ()
    """What of the motion no Panda can do: kind, first and last frame."""


def attribute(clips: Sequence[ClipEvidence], goal: str) -> Cause:
    """The first cause that holds of a failed episode.

    Args:
        clips: its rounds, in their order.
        goal: which of the task's conditions were not met, in words.
    """
    for look in (_grounding, _generation, _execution, _fingers):
        for number, clip in enumerate(clips):
            for cause in look(number, clip):
                return cause
    return Cause(
        verdict=FailureVerdict.TASK,
        round=None,
        frame_start=None,
        frame_end=None,
        value=None,
        limit=None,
        text=f"read, feasible and executed as imagined, yet {goal or 'the goal is not met'}",
    )


def _grounding(number: int, clip: ClipEvidence) -> Iterator[Cause]:
    lost = ~clip.tracked & ~_faulty(clip)
    longest = max(segments(lost), key=_length, default=None)
    if longest is not None and (_length(longest) >= LOST_FRAMES or lost.mean() > LOST_SHARE):
        yield Cause(
            verdict=FailureVerdict.GROUNDING,
            round=number,
            frame_start=longest.start,
            frame_end=longest.stop - 1,
            value=float(lost.sum()),
            limit=float(LOST_FRAMES - 1),
            text=f"no pose in {int(lost.sum())} of {len(lost)} frames, {_length(longest)} of them in a row",
        )


def _fingers(number: int, clip: ClipEvidence) -> Iterator[Cause]:
    """Fingers that move unseen: looked at last, for most of what is hidden does no harm."""
    hidden = max(_hidden_moves(clip), key=_length, default=None)
    if hidden is not None:
        yield Cause(
            verdict=FailureVerdict.GROUNDING,
            round=number,
            frame_start=hidden.start,
            frame_end=hidden.stop - 1,
            value=float(_length(hidden)),
            limit=float(LOST_FRAMES - 1),
            text=f"the gap between the fingers is unknown in {_length(hidden)} frames in a row, and may change there",
        )


def _hidden_moves(clip: ClipEvidence) -> Iterator[slice]:
    """Stretches whose poses are known and gaps are not, unless the gap is the same before and after."""
    gap = clip.finger_width_imagined_m
    for run in segments(clip.tracked & ~_faulty(clip) & np.isnan(gap)):
        before, after = gap[: run.start], gap[run.stop :]
        before, after = before[np.isfinite(before)], after[np.isfinite(after)]
        same = len(before) and len(after) and abs(after[0] - before[-1]) <= FINGERS_M
        if _length(run) >= LOST_FRAMES and not same:
            yield run


def _faulty(clip: ClipEvidence) -> NDArray[np.bool_]:
    """Frames (T,) in which something is wrong with the video itself."""
    faulty = np.zeros(len(clip.tracked), dtype=bool)
    for anomaly in clip.anomalies:
        faulty[max(anomaly.frame_start - 1, 0) : anomaly.frame_end + 2] = True
    return faulty


def _generation(number: int, clip: ClipEvidence) -> Iterator[Cause]:
    frames = len(clip.tracked)
    found = [(a.frame_start, a.frame_end, f"an anomaly, {a.kind.value}") for a in clip.anomalies]
    found += [(start, end, f"a motion that no Panda can do, {kind}") for kind, start, end in clip.violations]
    for start, end, name in sorted(found):
        if start < frames:
            yield Cause(
                verdict=FailureVerdict.GENERATION,
                round=number,
                frame_start=start,
                frame_end=min(end, frames - 1),
                value=None,
                limit=None,
                text=f"the video has {name.replace('_', ' ')}",
            )


def _execution(number: int, clip: ClipEvidence) -> Iterator[Cause]:
    distance, angle = pose_difference(clip.X_BG_imagined, clip.X_BG_executed)
    gap = np.abs(clip.finger_width_imagined_m - clip.finger_width_executed_m)
    for values, limit, factor, unit, what in (
        (distance, ASTRAY_M, 1000.0, "mm", "gripper"),
        (angle, ASTRAY_RAD, float(np.rad2deg(1.0)), "degrees", "gripper"),
        (gap, FINGERS_M, 1000.0, "mm", "gap between the fingers"),
    ):
        for run in segments(np.nan_to_num(values) > limit):
            if _length(run) >= ASTRAY_FRAMES:
                worst = float(values[run].max())
                yield Cause(
                    verdict=FailureVerdict.EXECUTION,
                    round=number,
                    frame_start=run.start,
                    frame_end=run.stop - 1,
                    value=worst,
                    limit=limit,
                    text=f"the executed {what} is off by up to {worst * factor:.0f} {unit}",
                )


def _length(run: slice) -> int:
    return int(run.stop - run.start)


def find_cause(run: EpisodeRun, judgements: Sequence[KinematicResult]) -> Cause | None:
    """Why an episode failed; None of one that succeeded.

    Args:
        run: the episode.
        judgements: what kinematics says of each clip.
    """
    return None if run.outcome.success else attribute(_evidence(run, judgements), run.outcome.reason)


def _evidence(run: EpisodeRun, judgements: Sequence[KinematicResult]) -> list[ClipEvidence]:
    """What the rounds left behind, each up to the last executed frame."""
    found = []
    for done, judgement in zip(run.rounds, judgements, strict=True):
        track, execution = done.grounded.track, done.execution
        frames = len(track.t_s) if execution is None else len(execution.snapshots)
        found.append(
            ClipEvidence(
                tracked=track.tracked[:frames],
                anomalies=done.grounded.anomalies,
                X_BG_imagined=track.X_BG[:frames],
                X_BG_executed=np.full((frames, 4, 4), np.nan) if execution is None else execution.X_BG,
                finger_width_imagined_m=track.finger_width_m[:frames],
                finger_width_executed_m=np.full(frames, np.nan) if execution is None else execution.finger_width_m,
                violations=tuple((v.kind.value, v.frame_start, v.frame_end) for v in judgement.violations),
            )
        )
    return found
