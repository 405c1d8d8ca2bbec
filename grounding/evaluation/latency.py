"""How soon a lost gripper is told lost, and how soon it is found again."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.grounding.evaluation.errors import ClipErrors
from kinebench_drake.products import AnomalyKind


@dataclass(frozen=True, slots=True, kw_only=True)
class Latency:
    """Reaction to one stretch of frames without a gripper."""

    loss: int
    """Frames still called tracked from the first one without a gripper on; all of them if the loss goes unnoticed."""
    recovery: int | None
    """Frames not tracked from the first one with the gripper back on; None where the clip ends before."""
    phantoms: int
    """Frames called tracked although there is no gripper."""


def vanish_latencies(errors: ClipErrors) -> list[Latency]:
    """The reaction to each planted vanishing of a clip."""
    return [
        latency(errors.tracked, fault.frame_start, fault.frame_end)
        for fault in errors.planted
        if fault.kind is AnomalyKind.VANISH
    ]


def latency(tracked: NDArray[np.bool_], start: int, end: int) -> Latency:
    """The reaction of a track (T,) to a gripper gone from frame `start` to `end`, inclusive."""
    gone, back = tracked[start : end + 1], tracked[end + 1 :]
    return Latency(
        loss=len(gone) if gone.all() else int(np.argmin(gone)),
        recovery=int(np.argmax(back)) if back.any() else (len(back) if len(back) else None),
        phantoms=int(gone.sum()),
    )
