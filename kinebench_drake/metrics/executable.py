"""Whether a robot can execute a whole video: what speaks against it, and what could not be measured."""

from collections import Counter
from collections.abc import Iterable, Sequence
from enum import Enum

from kinebench_drake.anomaly import Anomaly, AnomalyKind
from kinebench_drake.errors import count_noun

INFEASIBLE = "infeasible"
"""The motion breaks a limit of the arm."""
UNDECIDED = "undecided"
"""Too few frames are measured for a verdict on the motion, or there is no base frame."""
LOST = "lost"
"""Frames without a pose that are not bridged soundly."""
OPEN = "open"
"""Kind of anomaly whose measure is nearer to its bound than its spread."""
UNCHECKED = "unchecked"
"""Kinds of limits that the robot does not state."""

_NOT_OF_THE_ROBOT = frozenset({AnomalyKind.CAMERA.value})


def judge_evidence(
    feasible: bool | None,
    lost: int,
    anomalies: Iterable[Anomaly] = (),
    unchecked: Sequence[str] = (),
    open_kinds: Iterable[str] = (),
) -> tuple[bool | None, tuple[str, ...]]:
    """Return whether the robot can execute a video, and the reasons why not, or why it is open.

    False if something speaks against the video: its motion is infeasible, or it has an anomaly that no robot can show.
    None if nothing does, but frames were not measured, limits not checked, or the verdict on the motion or on a kind of
    anomaly is open.

    Args:
        feasible: verdict on the motion.
        lost: number of frames that are neither measured nor bridged.
        anomalies: anomalies of the video.
        unchecked: kinds of limits that could not be checked.
        open_kinds: kinds of anomaly of which it is open whether they occur.
    """
    frames = Counter[str]()
    for a in anomalies:
        frames[a.kind.value] += a.frame_end - a.frame_start + 1
    against = [INFEASIBLE] if feasible is False else []
    against += [
        f"{kind}: {count_noun(frames[kind], 'frame')}" for kind in sorted(frames) if kind not in _NOT_OF_THE_ROBOT
    ]
    missing = [UNDECIDED] if feasible is None else []
    missing += [f"{LOST}: {count_noun(lost, 'frame')}"] if lost else []
    missing += [f"{OPEN}: {kind}" for kind in sorted(open_kinds) if kind not in _NOT_OF_THE_ROBOT]
    missing += [f"{UNCHECKED}: {', '.join(unchecked)}"] if unchecked else []
    return False if against else None if missing else True, (*against, *missing)


def reason_kind(reason: str) -> str:
    """Return the kind of a reason: INFEASIBLE, UNDECIDED, LOST, OPEN, UNCHECKED or a kind of anomaly, alone."""
    return reason.partition(":")[0]


class FailureVerdict(Enum):
    """Causes of failed episodes, in the order in which they are tested."""

    GROUNDING = "grounding"
    """The gripper, or the gap between its fingers, was not tracked with confidence in frames that show it."""
    GENERATION = "generation"
    """The video has an anomaly, or a motion that the robot cannot execute."""
    EXECUTION = "execution"
    """The executed gripper deviated from the generated one."""
    TASK = "task"
    """None of these, and the goal is not reached: the generated motion does not do the task."""
