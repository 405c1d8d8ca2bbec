"""Fingers that open and close as no Panda's can."""

from dataclasses import replace

import numpy as np

from kinebench_drake.errors import InputError
from kinebench_drake.products import AnomalyKind
from kinebench_drake.suites.clip import Clip, film
from kinebench_drake.suites.faults.fault import Form, PlantedFault
from kinebench_drake.suites.faults.take import Take

MAX_WIDTH_M = 0.08
"""Widest gap between the pads."""
FLUTTER_FRAMES = 8
"""Frames of a flutter."""
_MIN_AFTER = 4  # frames that must follow a jump


def plant_fingers(take: Take, size_m: float, form: Form) -> tuple[Clip, PlantedFault]:
    """The clip with fingers drawn elsewhere: to and fro with each frame, or off at once to the end of the clip.

    Args:
        take: what to alter.
        size_m: change of the gap between the pads.
        form: flutter or jump.

    Raises:
        InputError: fingers cannot open so far from where they are, or are never in view long enough.
    """
    if size_m > MAX_WIDTH_M:
        raise InputError(f"fingers cannot open by {size_m} m, only by {MAX_WIDTH_M} m")
    if form is Form.FLUTTER:
        start = take.stretches(FLUTTER_FRAMES)[0]
        width = np.clip(take.clip.finger_width_m, size_m / 2, MAX_WIDTH_M - size_m / 2)[start : start + FLUTTER_FRAMES]
        width = width + size_m / 2 * (-1.0) ** np.arange(FLUTTER_FRAMES)
    else:
        start, change = _jump(take, size_m)
        width = np.clip(take.clip.finger_width_m[start:] + change, 0.0, MAX_WIDTH_M)
    snapshots = take.performance.snapshots[start : start + len(width)]
    drawn = [replace(s, fingers_m=np.full(2, w / 2)) for s, w in zip(snapshots, width, strict=True)]
    fault = PlantedFault(
        kind=AnomalyKind.FINGERS, frame_start=start, frame_end=start + len(width) - 1, size=size_m, form=form
    )
    return take.spliced(film(take.stage, drawn, first_frame=start), start), fault


def _jump(take: Take, size_m: float) -> tuple[int, float]:
    """Frame nearest to the middle of the clip from which the gap can change by so much, and the change [m]."""
    n = len(take)
    for start in sorted(take.stretches(_MIN_AFTER), key=lambda i: (abs(i - n // 2), i)):
        here = take.clip.finger_width_m[start - 2 : start + _MIN_AFTER]
        if np.ptp(here) > 0.002:
            continue
        if here.max() + size_m <= MAX_WIDTH_M + 1e-3:
            return start, size_m
        if here.min() - size_m >= -1e-3:
            return start, -size_m
    raise InputError(f"nowhere in this clip fingers can open or close by {size_m} m; take another seed")
