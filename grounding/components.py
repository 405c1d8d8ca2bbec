"""Parts of the grounding, each loaded when it is first used."""

from collections.abc import Sequence
from functools import cached_property

from kinebench_drake.grounding.camera.check import CameraChecker
from kinebench_drake.grounding.camera.estimate import CameraEstimator
from kinebench_drake.grounding.camera.recognition import Recognition, recognize
from kinebench_drake.grounding.panels.content import list_panels
from kinebench_drake.grounding.panels.panel import Panel
from kinebench_drake.grounding.panels.split import Tile
from kinebench_drake.grounding.pipeline import GRIPPERS, GroundingPipeline
from kinebench_drake.grounding.tracking.estimator import NetworkEstimator
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.panda.description import GripperKind
from kinebench_drake.models.perception.network import WEIGHTS_OF, load_network


class GripperComponents:
    """Network, tracking and camera estimation of a Panda with one gripper."""

    def __init__(self, gripper: GripperKind) -> None:
        self._gripper = gripper

    @cached_property
    def estimator(self) -> NetworkEstimator:
        """Network.

        Raises:
            SetupError: weights or libraries are missing; so do the others.
        """
        return NetworkEstimator(load_network(WEIGHTS_OF[self._gripper]))

    @cached_property
    def pipeline(self) -> GroundingPipeline:
        """Tracking of the gripper, or of the flange without any."""
        return GroundingPipeline.create(self.estimator, self._gripper)

    @cached_property
    def cameras(self) -> CameraEstimator:
        """Estimation of cameras; of grippers of known shape alone."""
        return CameraEstimator(self.estimator, GRIPPERS[self._gripper]())


class GroundingComponents:
    """Networks and fits behind the grounding."""

    def __init__(self) -> None:
        self._of = {kind: GripperComponents(kind) for kind in WEIGHTS_OF}

    def of(self, gripper: GripperKind) -> GripperComponents:
        """Return the components of a Panda with a gripper."""
        return self._of[gripper]

    def panels(self, frames: Frames, tiles: Sequence[Tile]) -> tuple[Panel, ...]:
        """Return the panels of frames (T, H, W, 3), with what each shows."""
        return list_panels(frames, tiles, self.of(GripperKind.NONE).estimator)

    def recognize(self, frames: Frames) -> Recognition | None:
        """Return the camera of frames (T, H, W, 3) among those known by name; None if the arm confirms none."""
        return recognize(frames, self.checker)

    @cached_property
    def checker(self) -> CameraChecker:
        """Checks of cameras, by the Franka hand."""
        cameras = self.of(GripperKind.FRANKA).cameras
        return CameraChecker(cameras.estimator, cameras.fitter)
