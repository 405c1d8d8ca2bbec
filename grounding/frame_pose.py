"""What was measured of the gripper in one frame."""

from dataclasses import dataclass

from kinebench_drake.geometry import Array
from kinebench_drake.grounding.registration.arm_fit import ArmFit
from kinebench_drake.grounding.registration.fit import Fit
from kinebench_drake.grounding.view import GripperView


@dataclass(frozen=True, slots=True, kw_only=True)
class FramePose:
    """The gripper in one frame, with what its confidence rests on."""

    X_CH: Array
    """(4, 4) pose of panda_hand in the camera frame [m]."""
    finger_m: float
    """Opening of each finger [m]; NaN when no finger was seen."""
    finger_sigma_m: float
    """Its standard deviation [m]."""
    fit: Fit
    """The hand by itself, without its arm."""
    by_cells: Fit
    """The same without its outline, which would draw it along where the gripper is deformed."""
    arm: ArmFit | None
    """The arm that goes with it; None where too little is seen of it."""
    view: GripperView
    """The close view."""
    overlap: float
    """Intersection over union of the seen and the rendered gripper."""
    given: bool = False
    """Whether the pose was known beforehand."""

    @property
    def covariance(self) -> Array:
        """(6, 6) of rotation about the camera's axes [rad] and position [m], by the cells' own sigmas."""
        return self.arm.covariance if self.arm is not None and self.arm.agrees else self.fit.covariance
