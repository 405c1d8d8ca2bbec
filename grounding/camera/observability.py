"""Observability of a calibration: errors and warnings about quantities that the video does not determine."""

import numpy as np

from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.grounding.camera.result import CalibrationMethod, CameraCalibration

FOCAL_LIMIT, FOCAL_WARNING = 0.05, 0.02
"""Relative standard deviation of the focal length that is an error, and that gives a warning."""
POSITION_LIMIT_M, POSITION_WARNING_M = 0.05, 0.02
"""Standard deviation of the camera position that is an error, and that gives a warning [m]."""
ROTATION_LIMIT_RAD, ROTATION_WARNING_RAD = np.deg2rad(3.0), np.deg2rad(1.5)
"""Standard deviation of the camera rotation that is an error, and that gives a warning [rad]."""
MISFIT_LIMIT_PX, MISFIT_WARNING_PX = 6.0, 2.5
"""Median reprojection error of the gripper, in an image 384 px wide, that is an error, or gives a warning [px]."""
MIN_MOTION_M = 0.10
"""Distance between hand positions below which the video counts as showing one posture [m]."""
MIN_DEPTH_RATIO = 1.25
"""Ratio of farthest to nearest depth of the robot below which perspective hardly determines the focal length."""
MIN_AGREEMENT = 0.45
"""Least share of the contours on image edges."""
_MIN_INLIERS = 0.5


def require_determined(calibration: CameraCalibration) -> None:
    """Check that the camera is determined and consistent with the known postures.

    Raises:
        UnmeasurableError: the postures contradict the images, or the camera is not determined; the message names the
            quantity and the reason.
    """
    unit = calibration.camera.unit_px
    misfit, agreement = calibration.part_px["gripper"], calibration.agreement
    if agreement is not None and agreement < MIN_AGREEMENT:
        raise UnmeasurableError(
            f"{calibration.basis.source}: with no camera does the robot lie on the edges of the images "
            f"({agreement:.0%} of its contours do, at least {MIN_AGREEMENT:.0%} are needed): is it a Panda with the "
            "Franka hand, is the camera static and its lens free of distortion, and do joint angles belong to these "
            "frames, in radians?"
        )
    if agreement is None and (misfit > MISFIT_LIMIT_PX * unit or calibration.inlier_share < _MIN_INLIERS):
        raise UnmeasurableError(
            f"{calibration.basis.source} contradicts the images: the gripper is {misfit:.1f} px off (median, at most "
            f"{MISFIT_LIMIT_PX * unit:.1f}), {calibration.inlier_share:.0%} of the cells agree; do the angles belong "
            "to this video and the times of its frames, in radians? Is the lens free of distortion?"
        )
    if calibration.focal_sigma > FOCAL_LIMIT:
        raise UnmeasurableError(
            f"the focal length is not determined ({calibration.focal_sigma:.1%} standard deviation, at most "
            f"{FOCAL_LIMIT:.0%}): {_why(calibration)}; give $focal_px PX or $camera FILE, or a video in which the arm "
            "moves towards the camera"
        )
    if calibration.position_sigma_m > POSITION_LIMIT_M or calibration.rotation_sigma_rad > ROTATION_LIMIT_RAD:
        sigmas = (
            f"{1e3 * calibration.position_sigma_m:.0f} mm and {np.rad2deg(calibration.rotation_sigma_rad):.1f} degrees "
            f"standard deviation, at most {1e3 * POSITION_LIMIT_M:.0f} mm and {np.rad2deg(ROTATION_LIMIT_RAD):.0f}"
        )
        raise UnmeasurableError(f"base_from_camera is not determined ({sigmas}): {_why(calibration)}")


def warnings_of(calibration: CameraCalibration) -> tuple[str, ...]:
    """Return warnings for the user, one line each."""
    warnings = []
    unit = calibration.camera.unit_px
    misfit = calibration.part_px["gripper"]
    if misfit > MISFIT_WARNING_PX * unit:
        warnings.append(
            f"the gripper is {misfit:.1f} px off (median): the joint angles may be late or early, the joints badly "
            "calibrated, or the lens distorted"
        )
    if calibration.focal_sigma > FOCAL_WARNING:
        warnings.append(f"the focal length is uncertain by {calibration.focal_sigma:.1%}: {_why(calibration)}")
    if calibration.position_sigma_m > POSITION_WARNING_M or calibration.rotation_sigma_rad > ROTATION_WARNING_RAD:
        warnings.append(
            f"base_from_camera is uncertain by {1e3 * calibration.position_sigma_m:.0f} mm and "
            f"{np.rad2deg(calibration.rotation_sigma_rad):.1f} degrees: {_why(calibration)}"
        )
    if calibration.basis.method is not CalibrationMethod.POSTURE and calibration.motion_m < MIN_MOTION_M:
        warnings.append(
            f"the hand moves by {1e3 * calibration.motion_m:.0f} mm only, less than {1e3 * MIN_MOTION_M:.0f}: errors "
            "that all frames have in common are not averaged out"
        )
    return tuple(warnings)


def _why(calibration: CameraCalibration) -> str:
    """Explain what the video lacks."""
    near, far = calibration.depth_m
    reasons = []
    if len(calibration.frames) == 1:
        reasons.append("one frame is used")
    elif calibration.motion_m < MIN_MOTION_M:
        reasons.append(f"the hand moves by {1e3 * calibration.motion_m:.0f} mm only")
    if far < MIN_DEPTH_RATIO * near:
        reasons.append(f"the visible parts of the robot are {near:.2f} to {far:.2f} m away, at nearly the same depth")
    if not reasons:
        reasons.append(f"{sum(calibration.part_cells.values())} cells show the robot, few of them with low uncertainty")
    return ", ".join(reasons)
