"""Cameras fitted to the robot, with their uncertainty: that of any fit, and that of a camera estimated from the arm."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.camera.bundle_adjustment import ArmScene, BundleAdjustment
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.io.jsonl import Json
from kinebench_drake.models.panda.description import HAND_TO_TCP_M, RobotPart

# Set on renders of another renderer, and checked on right and wrong cameras, of which no wrong one may be accepted:
# `python -m benchmarks cameras FOLDER --out OUT --presented plain,named,mirrored,short_focal,long_focal`.
ARM_AGREEMENT = 0.64
"""Least agreement of hand and arm with an estimated camera.

No wrong camera of own renders reaches this and `bounds.BASE_AGREEMENT`."""
ALIGNED_AGREEMENT = 0.5
"""The same where lines of the surroundings run along the axes of the base.

Of 43 renders by two other programs they do so with 18 right cameras, and with one whose focal length is wrong by a
quarter (0.48 of the arm's contours)."""
ALIGNED_BASE_AGREEMENT = 0.3
"""Least agreement of the base link with such a camera."""
_ALIGNED_LEAD = 0.03
"""Least lead over another camera (`bounds.LEAD`) of an aligned one that agrees by `ARM_AGREEMENT`."""
GRIPPER_SIGMA_M = 0.02
"""Greatest standard deviation of the gripper's position in the base frame, due to its camera, of a verdict [m]."""
GRIPPER_SIGMA_RAD = float(np.deg2rad(3.0))
"""The same of its rotation [rad]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedCamera:
    """Camera fitted to cells or contours of the robot in T frames."""

    bundle: BundleAdjustment
    """Fit; joint angles are NaN where unknown."""
    frames: NDArray[np.intp]
    """(T,) numbers of the frames used."""
    part: NDArray[np.uint8]
    """(N,) values of `RobotPart` of the cells or contour points used."""

    @property
    def scene(self) -> ArmScene:
        """Lens, postures and openings in these frames."""
        return self.bundle.scene

    @property
    def camera(self) -> Camera:
        """Camera with its pose."""
        return self.scene.lens.to_camera()

    @property
    def position_sigma_m(self) -> float:
        """Standard deviation of the camera's position in the base frame: root of the sum over axes [m]."""
        return self.scene.lens.position_sigma_m(self.bundle.covariance[:6, :6])

    @property
    def rotation_sigma_rad(self) -> float:
        """Standard deviation of the camera's rotation [rad]."""
        return float(np.trace(self.bundle.covariance[:3, :3]) ** 0.5)

    @property
    def focal_sigma(self) -> float:
        """Relative standard deviation of the focal length; 0 if it was fixed."""
        return float(self.bundle.covariance[6, 6] ** 0.5)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rival:
    """Another camera that explains the robot."""

    camera: Camera
    share: float
    """Share of the contours on image edges that it is compared by."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraEstimate(FittedCamera):
    """Camera estimated from the arm, fitted to its contours."""

    gripper_sigma_m: float
    """Standard deviation of the TCP's position in the base frame due to the camera: root of the sum over axes [m]."""
    gripper_sigma_rad: float
    """Likewise of its rotation [rad]."""
    agreement: float
    """Share of the contours of hand and arm on image edges, median over the frames; less where few frames fit.

    Without the base link, unless the joint angles are known."""
    base_agreement: float = 0.0
    """Share of the contours of the base link on image edges, all frames together."""
    turns: tuple[Rival, ...] = ()
    """Cameras under which the base is turned elsewhere about joint 1, by the same share."""
    is_aligned: bool = False
    """Whether lines of the surroundings along the axes of the base were used."""
    others: tuple[Rival, ...] = ()
    """Cameras under which the arm stands elsewhere, by the mean of the two agreements."""
    residual_px: float
    """Median distance between contours and image edges [px]."""

    def to_json(self) -> dict[str, Json]:
        """Serialize into `camera_estimate` of samples.jsonl."""
        return {
            "camera": self.camera.to_json(),
            "agreement": self.agreement,
            "runner_up": self.runner_up,
            "base_agreement": self.base_agreement,
            "base_runner_up": self.base_runner_up,
            "aligned": self.is_aligned,
            "residual_px": self.residual_px,
            "position_sigma_m": self.position_sigma_m,
            "rotation_sigma_rad": self.rotation_sigma_rad,
            "focal_sigma": self.focal_sigma,
            "gripper_sigma_m": self.gripper_sigma_m,
            "gripper_sigma_rad": self.gripper_sigma_rad,
            "frames": self.frames.tolist(),
        }

    @property
    def base_runner_up(self) -> float:
        """Greatest share of the contours of the base link with the base turned elsewhere; 0 if no other turn agrees."""
        return max((rival.share for rival in self.turns), default=0.0)

    @property
    def runner_up(self) -> float:
        """Greatest mean of the agreements with a camera under which the arm stands elsewhere; 0 if there is none."""
        return max((rival.share for rival in self.others), default=0.0)

    @property
    def rivals(self) -> tuple[Camera, ...]:
        """Cameras that agree nearly as well, one of which may be right instead."""
        turned = [rival.camera for rival in self.turns if self.base_agreement < rival.share + bounds.LEAD]
        return (*turned, *(rival.camera for rival in self.others if self.support < rival.share + self._lead))

    @property
    def _lead(self) -> float:
        return _ALIGNED_LEAD if self.is_aligned and self.agreement >= ARM_AGREEMENT else bounds.LEAD

    @property
    def doubt(self) -> str | None:
        """Why the camera gives no base frame; None if it does."""
        return self.misfit or self.ambiguity

    @property
    def misfit(self) -> str | None:
        """Why neither the camera nor one of its `rivals` is right with certainty; None if one of them is."""
        least = ARM_AGREEMENT
        least_base = bounds.BASE_AGREEMENT
        if self.is_aligned:
            least = ALIGNED_AGREEMENT
            least_base = ALIGNED_BASE_AGREEMENT
        if self.agreement < least:
            return (
                f"no estimated camera agrees with the arm (best: {self.agreement:.0%} of its contours on image edges, "
                f"at least {least:.0%} are needed)"
            )
        if self.base_agreement < least_base:
            return (
                "how the base is turned about joint 1 cannot be seen (best: "
                f"{self.base_agreement:.0%} of the contours of the base link on image edges, at least "
                f"{least_base:.0%} are needed)"
            )
        if self.gripper_sigma_m > GRIPPER_SIGMA_M or self.gripper_sigma_rad > GRIPPER_SIGMA_RAD:
            return (
                "with the estimated camera the gripper's place in it is uncertain by "
                f"{1e3 * self.gripper_sigma_m:.0f} mm and {np.rad2deg(self.gripper_sigma_rad):.1f} degrees (one "
                f"sigma, at most {1e3 * GRIPPER_SIGMA_M:.0f} and {np.rad2deg(GRIPPER_SIGMA_RAD):.0f})"
            )
        return None

    @property
    def ambiguity(self) -> str | None:
        """Why one of the `rivals` may be right instead; None without any."""
        if self.base_agreement < self.base_runner_up + bounds.LEAD:
            return (
                f"two turns of the base about joint 1 explain its contours ({self.base_agreement:.0%} and "
                f"{self.base_runner_up:.0%} on image edges)"
            )
        if self.support < self.runner_up + self._lead:
            return (
                f"two different cameras explain arm and base ({self.support:.0%} and {self.runner_up:.0%} of their "
                "contours on image edges)"
            )
        return None

    @property
    def support(self) -> float:
        """Mean of the agreements of arm and base link."""
        return (self.agreement + self.base_agreement) / 2


def describe(
    bundle: BundleAdjustment, part: NDArray[np.uint8], model: ArmModel, frames: NDArray[np.intp], agreement: float
) -> CameraEstimate:
    """Return the estimate of a fit to contours of some parts (N,) in frames of these numbers (T,)."""
    covariance = bundle.covariance
    spread = []
    for q, response in zip(bundle.scene.q, bundle.response, strict=True):
        X_BP, axis, point = model.poses_and_axes(q)
        X_BH = X_BP[RobotPart.HAND]
        tcp = X_BH[:3, 3] + HAND_TO_TCP_M * X_BH[:3, 2]
        J = np.concatenate([np.cross(axis, tcp - point).T, axis.T]) @ response
        spread.append(J @ covariance @ J.T)
    traces = [(np.trace(V[:3, :3]), np.trace(V[3:, 3:])) for V in spread]
    position, rotation = (float(variance) ** 0.5 for variance in np.median(traces, axis=0))
    return CameraEstimate(
        bundle=bundle,
        frames=frames,
        part=part,
        gripper_sigma_m=position,
        gripper_sigma_rad=rotation,
        agreement=agreement,
        residual_px=float(np.median(bundle.error_px)),
    )
