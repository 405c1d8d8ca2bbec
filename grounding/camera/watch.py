"""Spot checks of a camera that stays the same for many clips."""

from dataclasses import dataclass

from kinebench_drake.grounding.pipeline import PipelineResult
from kinebench_drake.segments import finite_rows

_AGREEING_SHARE = 0.5
"""Least share of the frames that are tracked and in which hand and arm agree, of a clip that is not checked."""


@dataclass(slots=True, kw_only=True)
class CameraWatch:
    """Checks of the camera of a run: of every clip until one passes, then of one in `every`.

    A clip in which hand and arm seldom agree is always checked, as that may be due to the camera.
    """

    every: int
    _left: int = 0

    def is_due(self, measured: PipelineResult) -> bool:
        """Return whether the camera is checked with a clip."""
        agreeing = (finite_rows(measured.arm_q) & measured.track.tracked)[~measured.is_between]
        if not self._left or agreeing.mean() < _AGREEING_SHARE:
            return True
        self._left -= 1
        return False

    def note(self, *, passed: bool) -> None:
        """Note the result of a check."""
        self._left = self.every - 1 if passed else 0
