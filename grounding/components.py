"""Parts of the grounding, each loaded when it is first used."""

from collections.abc import Sequence
from functools import cached_property

from kinebench_drake.grounding.camera.check import CameraChecker
from kinebench_drake.grounding.camera.estimate import CameraEstimator
from kinebench_drake.grounding.camera.recognition import Recognition, recognize
from kinebench_drake.grounding.panels.content import list_panels
from kinebench_drake.grounding.panels.panel import Panel
from kinebench_drake.grounding.panels.split import Tile
from kinebench_drake.grounding.pipeline import GroundingPipeline
from kinebench_drake.grounding.tracking.estimator import NetworkEstimator
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.panda.description import GripperKind
from kinebench_drake.models.perception.network import ARM_WEIGHTS, load_network


class GroundingComponents:
    """Networks and fits behind the grounding, each loaded when it is first used."""

    def __init__(self) -> None:
        self._arms: dict[GripperKind, GroundingPipeline] = {}

    @cached_property
    def _estimator(self) -> NetworkEstimator:
        return NetworkEstimator(load_network())

    @cached_property
    def _arm_estimator(self) -> NetworkEstimator:
        return NetworkEstimator(load_network(ARM_WEIGHTS))

    @cached_property
    def hand(self) -> GroundingPipeline:
        """Tracking of the Franka hand.

        Raises:
            SetupError: weights or libraries are missing; so do the others.
        """
        return GroundingPipeline.create(self._estimator)

    def arm(self, gripper: GripperKind) -> GroundingPipeline:
        """Return the tracking of the flange by the arm, and by another gripper than Franka's."""
        if gripper not in self._arms:
            self._arms[gripper] = GroundingPipeline.create(self._arm_estimator, gripper)
        return self._arms[gripper]

    def panels(self, frames: Frames, tiles: Sequence[Tile]) -> tuple[Panel, ...]:
        """Return the panels of frames (T, H, W, 3), with what each shows."""
        return list_panels(frames, tiles, self._arm_estimator)

    @cached_property
    def cameras(self) -> CameraEstimator:
        """Estimation of cameras."""
        return CameraEstimator(self._estimator)

    def recognize(self, frames: Frames) -> Recognition | None:
        """Return the camera of frames (T, H, W, 3) among those known by name; None if the arm confirms none."""
        return recognize(frames, self.checker)

    @cached_property
    def checker(self) -> CameraChecker:
        """Checks of cameras."""
        return CameraChecker(self.cameras.estimator, self.cameras.fitter)
