"""Pose of the gripper in one frame, with the fits behind it."""

from dataclasses import dataclass, replace

from kinebench_drake.geometry import Array
from kinebench_drake.grounding.registration.arm_fit import ArmFit
from kinebench_drake.grounding.registration.fit import HandFit
from kinebench_drake.grounding.registration.hand_contour import HandShape
from kinebench_drake.grounding.registration.icp import FusedPose
from kinebench_drake.grounding.tracking.view import GripperView


@dataclass(frozen=True, slots=True, kw_only=True)
class FramePose:
    """Pose of the gripper in one frame, with the fits that its confidence is computed from."""

    X_CH: Array
    """(4, 4) pose of panda_hand in the camera frame [m]."""
    finger_m: float = float("nan")
    """Travel of each finger [m]; NaN if no finger was visible."""
    finger_sigma_m: float = float("nan")
    """Standard deviation of the travel [m]."""
    hand: HandFit
    """Fit of the hand alone, without the arm."""
    hand_without_silhouette: HandFit
    """Fit to the cells alone: the silhouette would bias it where the gripper is deformed."""
    arm: ArmFit | None
    """Fit of the arm; None if too little of it is visible."""
    view: GripperView
    """View of the crop around the gripper."""
    overlap: float
    """Intersection over union of the segmented and the rendered gripper; of the arm alone `ArmFit.edge_agreement`."""
    from_prior: bool = False
    """True if the pose was taken from priors."""
    shape: HandShape | None = None
    """Shape of the hand's contour, in unfamiliar videos; None where its arm does not agree or it is not measured."""
    gap_log_likelihood: Array | None = None
    """(G,) log-likelihood of `GAPS_M` by the edges of the image, in unfamiliar videos where the arm agrees."""
    icp: FusedPose | None = None
    """Combination of the fit with the registration of the depth; None before it, or if too few points match."""

    @property
    def covariance(self) -> Array:
        """(6, 6) covariance of rotation about the camera's axes [rad] and position [m], from cells and ICP."""
        if self.icp is not None:
            return self.icp.covariance
        return self.arm.covariance if self.arm is not None and self.arm.agrees else self.hand.covariance

    @property
    def arm_agrees(self) -> bool:
        """True if one posture explains both links and hand."""
        return self.arm is not None and self.arm.agrees

    def with_arm(self, arm: ArmFit, overlap: float) -> "FramePose":
        """Return the pose with another fit of the arm in place of its own, and its overlap."""
        return replace(
            self,
            X_CH=arm.X_CH,
            finger_m=arm.finger_m,
            finger_sigma_m=arm.finger_sigma_m,
            arm=arm,
            overlap=overlap,
            icp=None,
        )
