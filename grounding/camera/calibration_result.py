"""Result of a camera calibration, its description, and errors and warnings about what the video does not determine."""

from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.camera.camera_estimate import GRIPPER_SIGMA_RAD, FittedCamera
from kinebench_drake.io.jsonl import Json
from kinebench_drake.models.panda.description import ARM, GRIPPER, RobotPart

# Chosen by hand; checked by `python -m benchmarks calibration FOLDER`.
_FOCAL_LIMIT = 0.05
"""Relative standard deviation of the focal length that is an error."""
_POSITION_LIMIT_M = 0.05
"""Standard deviation of the camera's place that is an error [m]."""
_ROTATION_LIMIT_RAD = GRIPPER_SIGMA_RAD
"""Standard deviation of the camera's turn that is an error [rad]."""
_MISFIT_LIMIT_PX = 6.0
"""Median error of the gripper in a fit to cells that is an error [px of an image 384 px wide]."""
_INLIER_SHARE = 0.5
"""Least share of the cells that agree with a fit to cells."""
_WARNING_SHARE = 0.4
"""Share of these limits from which on there is a warning."""
_MIN_MOTION_M = 0.1
"""Distance between hand positions below which a video shows one posture [m]."""
_MIN_DEPTH_RATIO = 1.25
"""Ratio of farthest to nearest depth below which perspective hardly determines the focal length."""
_GROUPS = {"gripper": GRIPPER, "arm": ARM[1:], "base": ARM[:1]}


class CalibrationMethod(Enum):
    """Source of the robot's postures."""

    JOINTS = "joint angles of the frames"
    POSES = "poses of the gripper in the frames"
    POSTURE = "posture of one frame"
    ESTIMATE = "no postures"


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationBasis:
    """Prior information of a calibration."""

    method: CalibrationMethod
    source: str
    """Source of the postures."""
    focal_free: bool
    """True if the focal length was estimated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraCalibration(FittedCamera):
    """Calibrated camera with its uncertainty."""

    basis: CalibrationBasis
    X_BP: Array
    """(T, PARTS, 4, 4) frames of the parts' CAD coordinates in B [m]; NaN where unknown."""
    residual_px: float
    """Of a fit to cells the root mean square of the reprojection error, weighted by the certainty of each cell; of one
    to contours the median distance from edges [px]."""
    inlier_share: float
    """Share of the cells within four standard deviations, or of the contour points on edges."""
    depth_m: tuple[float, float]
    """Depths of the nearest and farthest visible parts of the robot, 5th and 95th percentile [m]."""
    agreement: float | None = None
    """Share of the contours of hand and arm on image edges; None if the camera was fitted to cells alone."""
    warnings: tuple[str, ...] = ()
    """Warnings for the user."""
    image: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 0, 3), np.uint8))
    """(H, W, 3) middle one of the frames used; empty until it is set."""

    @property
    def part_px(self) -> dict[str, float]:
        """Median error [px] of the cells or contour points of gripper, arm and base; NaN without any."""
        errors = {name: self.bundle.error_px[np.isin(self.part, parts)] for name, parts in _GROUPS.items()}
        return {name: float(np.median(own)) if len(own) else float("nan") for name, own in errors.items()}

    @property
    def part_cells(self) -> dict[str, int]:
        """Number of cells or contour points of gripper, arm and base."""
        return {name: int(np.isin(self.part, parts).sum()) for name, parts in _GROUPS.items()}

    @property
    def motion_m(self) -> float:
        """Greatest distance between hand positions in the frames [m]."""
        hands_B = self.X_BP[:, RobotPart.HAND, :3, 3]
        return float(np.nanmax(np.linalg.norm(hands_B[:, None] - hands_B[None], axis=-1), initial=0.0))

    @property
    def fitted_to(self) -> str:
        """Measurements of the fit: "cells" or "contours"."""
        return "cells" if self.agreement is None else "contours"

    def to_json(self) -> dict[str, Json]:
        """Serialize all results; the camera as in `camera.json`."""
        return {
            "camera": self.camera.to_json(),
            "method": self.basis.method.value,
            "source": self.basis.source,
            "frames": self.frames.tolist(),
            "focal_length": "estimated" if self.basis.focal_free else "fixed",
            "sigma": {
                "position_mm": 1e3 * self.position_sigma_m,
                "rotation_deg": float(np.rad2deg(self.rotation_sigma_rad)),
                "focal_percent": 100 * self.focal_sigma,
            },
            "fitted_to": self.fitted_to,
            "residual_px": self.residual_px,
            "part_median_px": {name: px if np.isfinite(px) else None for name, px in self.part_px.items()},
            "part_cells": dict(self.part_cells),
            "inlier_share": self.inlier_share,
            "agreement": self.agreement,
            "depth_m": list(self.depth_m),
            "hand_motion_m": self.motion_m,
            "warnings": list(self.warnings),
        }


def format_lines(calibration: CameraCalibration) -> list[str]:
    """Format the calibration as lines of text."""
    c = calibration
    camera = calibration.camera
    place = ", ".join(f"{1e3 * x:.0f}" for x in camera.X_BC[:3, 3])
    fov = np.rad2deg(2 * np.arctan(camera.width / 2 / camera.fx))
    sure = f" +- {100 * c.focal_sigma:.1f} %" if c.basis.focal_free else ", fixed"
    report = [
        f"from: {c.basis.source}; {len(c.frames)} frames, {len(c.part)} points of the robot's {c.fitted_to} "
        f"(gripper {c.part_cells['gripper']}, arm {c.part_cells['arm']}, base {c.part_cells['base']})",
        f"camera in the base frame: {place} mm, +- {1e3 * c.position_sigma_m:.0f} mm, "
        f"{np.rad2deg(c.rotation_sigma_rad):.2f} degrees",
        f"focal length: {camera.fx:.1f} px{sure} (field of view {fov:.1f} degrees across {camera.width} px)",
        f"residual: {c.residual_px:.2f} px {'rms' if c.agreement is None else 'median'}; medians "
        + ", ".join(f"{name} {px:.1f}" for name, px in c.part_px.items() if np.isfinite(px)),
    ]
    if c.agreement is not None:
        report.append(f"contours of hand and arm on image edges: {c.agreement:.0%}")
    report.append(
        f"depth of the robot: {c.depth_m[0]:.2f} to {c.depth_m[1]:.2f} m; the hand moves {1e3 * c.motion_m:.0f} mm"
    )
    return [*report, *(f"warning: {warning}" for warning in c.warnings)]


def require_determined(calibration: CameraCalibration) -> None:
    """Check that the camera is determined and consistent with the known postures.

    Raises:
        UnmeasurableError: the postures contradict the images, or the camera is not determined; the message names the
            quantity and the reason.
    """
    unit = calibration.camera.unit_px
    misfit = calibration.part_px["gripper"]
    agreement = calibration.agreement
    if agreement is not None and agreement < bounds.AGREEMENT:
        raise UnmeasurableError(
            f"{calibration.basis.source}: with no camera does the robot lie on the edges of the images "
            f"({agreement:.0%} of its contours do, at least {bounds.AGREEMENT:.0%} are needed): is it a Panda with the "
            "Franka hand, is the camera static and its lens free of distortion, and do joint angles belong to these "
            "frames, in radians?"
        )
    if agreement is None and (misfit > _MISFIT_LIMIT_PX * unit or calibration.inlier_share < _INLIER_SHARE):
        raise UnmeasurableError(
            f"{calibration.basis.source} contradicts the images: the gripper is {misfit:.1f} px off (median, at most "
            f"{_MISFIT_LIMIT_PX * unit:.1f}), {calibration.inlier_share:.0%} of the cells agree; do the angles "
            "belong to this video and the times of its frames, in radians? Is the lens free of distortion?"
        )
    if calibration.focal_sigma > _FOCAL_LIMIT:
        raise UnmeasurableError(
            f"the focal length is not determined ({calibration.focal_sigma:.1%} standard deviation, at most "
            f"{_FOCAL_LIMIT:.0%}): {_why(calibration)}; give $focal_px PX or $camera FILE, or a video in which "
            "the arm moves towards the camera"
        )
    if calibration.position_sigma_m > _POSITION_LIMIT_M or calibration.rotation_sigma_rad > _ROTATION_LIMIT_RAD:
        sigmas = (
            f"{1e3 * calibration.position_sigma_m:.0f} mm and {np.rad2deg(calibration.rotation_sigma_rad):.1f} degrees "
            f"standard deviation, at most {1e3 * _POSITION_LIMIT_M:.0f} mm and "
            f"{np.rad2deg(_ROTATION_LIMIT_RAD):.0f}"
        )
        raise UnmeasurableError(f"base_from_camera is not determined ({sigmas}): {_why(calibration)}")


def warnings_of(calibration: CameraCalibration) -> tuple[str, ...]:
    """Return warnings for the user, one line each."""
    warnings = []
    unit = calibration.camera.unit_px
    misfit = calibration.part_px["gripper"]
    if misfit > _WARNING_SHARE * _MISFIT_LIMIT_PX * unit:
        warnings.append(
            f"the gripper is {misfit:.1f} px off (median): the joint angles may be late or early, the joints badly "
            "calibrated, or the lens distorted"
        )
    if calibration.focal_sigma > _WARNING_SHARE * _FOCAL_LIMIT:
        warnings.append(f"the focal length is uncertain by {calibration.focal_sigma:.1%}: {_why(calibration)}")
    if (
        calibration.position_sigma_m > _WARNING_SHARE * _POSITION_LIMIT_M
        or calibration.rotation_sigma_rad > _WARNING_SHARE * _ROTATION_LIMIT_RAD
    ):
        warnings.append(
            f"base_from_camera is uncertain by {1e3 * calibration.position_sigma_m:.0f} mm and "
            f"{np.rad2deg(calibration.rotation_sigma_rad):.1f} degrees: {_why(calibration)}"
        )
    if calibration.basis.method is not CalibrationMethod.POSTURE and calibration.motion_m < _MIN_MOTION_M:
        warnings.append(
            f"the hand moves by {1e3 * calibration.motion_m:.0f} mm only, less than {1e3 * _MIN_MOTION_M:.0f}: "
            "errors that all frames have in common are not averaged out"
        )
    return tuple(warnings)


def _why(calibration: CameraCalibration) -> str:
    """Explain what the video lacks."""
    near, far = calibration.depth_m
    reasons = []
    if len(calibration.frames) == 1:
        reasons.append("one frame is used")
    elif calibration.motion_m < _MIN_MOTION_M:
        reasons.append(f"the hand moves by {1e3 * calibration.motion_m:.0f} mm only")
    if far < _MIN_DEPTH_RATIO * near:
        reasons.append(f"the visible parts of the robot are {near:.2f} to {far:.2f} m away, at nearly the same depth")
    if not reasons:
        reasons.append(f"{sum(calibration.part_cells.values())} cells show the robot, few of them with low uncertainty")
    return ", ".join(reasons)
